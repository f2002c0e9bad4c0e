// Draws plots by uPlot. Charts.show(place, data) draws them into the figures of an element, and its `update(data)` other
// curves in the same plots; `end()` takes them away. On a page with the JSON in #report-data it is called with that. The data:
// {tables: [{file, time, columns: [{name, unit, values}], modes: [{colour, begin, end}]}],
//  charts: [{label, floor, curves: [{table, column, name, colour, dashed, held}]}]};
// times and values are {type: "f4" or "f8", base64}, NaN where there is a gap. Where a floor is not 0, the axis is logarithmic,
// and smaller values are drawn on its lower edge. A figure with data-chart="0" gets the first
// chart, when it is unfolded; a button with data-download="0" writes the first table as CSV.
const Charts = (() => {
  "use strict";

  const HEIGHT = 260; // of a plot [CSS px]
  const AXIS = 64; // room for the numbers beside it, at least [CSS px]
  const STRIP = 6; // height of the controller's modes where there are several runs [CSS px]
  const PRINTED = 680; // width on paper [CSS px]
  const root = document.documentElement;

  // --- data ---------------------------------------------------------------------------------------------------------

  function decoded({ type, base64 }) {
    const { buffer } = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
    return Array.from(type === "f8" ? new Float64Array(buffer) : new Float32Array(buffer));
  }

  function number(value, digits = 4) { // with a true minus sign
    return String(Number(value.toPrecision(digits))).replace("-", "\u2212");
  }

  function show(element, data) {
    let tables, charts, first, last;

    function take(data) {
      ({ tables, charts } = data);
      for (const table of tables) table.time = decoded(table.time);
      first = Math.min(...tables.map(({ time }) => time[0]));
      last = Math.max(...tables.map(({ time }) => time[time.length - 1]));
    }

    function valuesOf({ table, column }) {
      const of = tables[table].columns[column];
      if (!Array.isArray(of.values)) of.values = decoded(of.values);
      return of.values;
    }

    function joined({ curves, floor }) { // one list of times, and the values of each curve there, 0 for those below the floor
      const logarithmic = (v) => (v >= floor ? v : v >= 0 ? 0 : null);
      const drawn = (values) => values.map((v) => (!Number.isFinite(v) ? null : floor ? logarithmic(v) : v));
      const single = curves.map((curve) => [tables[curve.table].time, drawn(valuesOf(curve))]);
      return single.length > 1 ? uPlot.join(single) : single[0];
    }

    take(data);

    // --- plots --------------------------------------------------------------------------------------------------------

    const plots = []; // {uplot, index, chart, buttons, outputs, place}
    const hidden = new Set(); // names of curves that are switched off
    let range = [first, last];

    const ink = () => Colours.variable("ink");
    const soft = () => Colours.variable("line");

    function shadeModes(u, { curves }) { // the modes of one run behind the curve, of several as strips at the bottom
      const shown = [...new Set(curves.map(({ table }) => table))].map((k) => tables[k].modes).filter((modes) => modes.length);
      const { left, top, width, height } = u.bbox;
      const { ctx } = u;
      const strip = STRIP * uPlot.pxRatio;
      ctx.save();
      ctx.beginPath();
      ctx.rect(left, top, width, height);
      ctx.clip();
      shown.forEach((modes, row) => {
        const [y, h] = shown.length > 1 ? [top + height - strip * (shown.length - row), strip] : [top, height];
        ctx.globalAlpha = Number(Colours.variable(shown.length > 1 ? "strip" : "shade"));
        for (const { colour, begin, end } of modes) {
          ctx.fillStyle = colour;
          const x = u.valToPos(begin, "x", true);
          ctx.fillRect(x, y, u.valToPos(end, "x", true) - x, h);
        }
      });
      ctx.restore();
    }

    const below = () => 0.06 + (tables.length > 1 ? (STRIP * tables.length) / HEIGHT : 0); // room there, for the strips too

    function around(_u, low, high) { // limits of a linear axis
      if (low === null || high === null) return [-1, 1];
      const size = low === high ? Math.abs(low) || 1 : high - low;
      return [low - below() * size, high + 0.06 * size];
    }

    function wider(plot) { // limits of a logarithmic axis, of what is above the floor
      return (_u, low, high) => {
        const { floor } = plot.chart;
        if (!(low > 0) || !(high >= low) || high === Infinity) return [floor, 10 * floor];
        const size = low === high ? 2 : high / low;
        return [low / size ** below(), high * size ** 0.06];
      };
    }

    // Where a logarithmic axis has numbers: at powers of ten, over few of them at 1, 2 and 5 times these, else evenly.
    function places(_u, _axis, low, high) {
      const decades = Math.log10(high / low);
      const found = [];
      if (decades < 1) {
        const power = 10 ** Math.floor(Math.log10((high - low) / 3));
        const step = power * [5, 2, 1].find((factor) => factor * power <= (high - low) / 3);
        for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(Number((k * step).toPrecision(12)));
        return found;
      }
      const every = Math.ceil(decades / 8);
      for (let k = Math.ceil(Math.log10(low)) - 1; k <= Math.log10(high); k++) {
        const factors = decades < 3 ? [1, 2, 5] : k % every === 0 ? [1] : [];
        found.push(...factors.map((factor) => Number(`${factor}e${k}`)).filter((v) => v >= low && v <= high));
      }
      return found;
    }

    // A line that ends before a gap however narrow that is; uPlot's own joins what falls on one column of pixels.
    function broken(u, series, from, to) {
      const stroke = new Path2D();
      let drawing = false;
      for (let k = from; k <= to; k++) {
        const value = u.data[series][k];
        if (value === undefined) continue;
        if (value !== null) {
          const at = [u.valToPos(u.data[0][k], "x", true), u.valToPos(value, "y", true)];
          if (drawing) stroke.lineTo(...at);
          else stroke.moveTo(...at);
        }
        drawing = value !== null;
      }
      return { stroke, fill: null, clip: null };
    }

    function nearest(u, series, index) { // the row of a joined table in which this curve has a value
      const values = u.data[series];
      for (let k = 0; k < values.length; k++) {
        if (values[index - k] !== undefined && index - k >= 0) return index - k;
        if (values[index + k] !== undefined && index + k < values.length) return index + k;
      }
      return index;
    }

    function room(u, numbers, side, cycle) { // for the numbers beside an axis
      if (!numbers) return AXIS;
      const { font, gap, ticks, _size: before } = u.axes[side];
      if (cycle > 1) return before;
      u.ctx.font = font[0];
      const widths = numbers.map((text) => u.ctx.measureText(text).width / uPlot.pxRatio);
      return Math.max(AXIS, Math.ceil(Math.max(0, ...widths) + 2 * gap + ticks.size));
    }

    function options(plot, width) {
      const { chart } = plot;
      const lines = { stroke: soft, width: 1 };
      const numbers = (_u, splits) => splits.map((v) => number(v, 8));
      const axis = { stroke: ink, grid: lines, ticks: lines, labelSize: 22, labelGap: 0, values: numbers };
      const powers = {
        splits: places,
        filter: (_u, splits) => splits, // all of them
        values: (_u, splits) => splits.map((v) => (v < 1e-3 ? v.toExponential().replace("-", "\u2212") : number(v, 8))),
      };
      const held = uPlot.paths.stepped({ align: -1 });
      return {
        width,
        height: HEIGHT,
        padding: [10, 14, 0, 0],
        legend: { show: false },
        scales: {
          x: { time: false, range: () => range },
          y: chart.floor ? { distr: 3, range: wider(plot), clamp: (_u, _v, low) => low } : { range: around },
        },
        axes: [
          { ...axis, label: "time [s]", size: 34 },
          { ...axis, label: chart.label, size: room, ...(chart.floor ? powers : {}) },
        ],
        series: [
          {},
          ...chart.curves.map((curve) => ({
            show: !hidden.has(curve.name),
            stroke: () => Colours.shown(curve.colour),
            width: 1.4,
            dash: curve.dashed ? [6, 5] : undefined,
            paths: curve.held ? held : broken,
            points: { show: false },
          })),
        ],
        cursor: {
          sync: { key: "report", filters: { pub: (kind) => kind === "mousemove" || kind === "mouseleave" } },
          drag: { x: true, y: false, setScale: false },
          dataIdx: nearest,
          bind: { dblclick: () => () => zoom(first, last) },
        },
        hooks: {
          drawClear: [(u) => shadeModes(u, plot.chart)],
          setSelect: [(u) => {
            if (u.select.width < 5) return;
            zoom(timeAt(u, u.select.left), timeAt(u, u.select.left + u.select.width));
            u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          }],
          setCursor: [readOut],
        },
      };
    }

    function readOut(u) {
      const plot = plots.find(({ uplot }) => uplot === u);
      if (!plot) return;
      const { idx, idxs } = u.cursor;
      plot.outputs.forEach((output, k) => {
        const at = idx === null || idx === undefined ? null : u.data[k + 1][idxs[k + 1] ?? idx];
        const under = at === 0 && plot.chart.floor; // on the edge
        output.textContent = at === null || at === undefined ? "" : under ? ` < ${number(under)}` : ` ${number(at)}`;
      });
      if (idx !== null && idx !== undefined) moment.textContent = `t = ${number(u.data[0][idx])} s`;
    }

    function line({ colour, dashed }) { // what the curve looks like, for the button that switches it
      const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
      svg.setAttribute("viewBox", "0 0 16 6");
      svg.setAttribute("aria-hidden", "true");
      const stroke = document.createElementNS("http://www.w3.org/2000/svg", "path");
      stroke.setAttribute("d", "M0 3H16");
      stroke.setAttribute("stroke-width", "2.5");
      if (dashed) stroke.setAttribute("stroke-dasharray", "4 2");
      stroke.dataset.colour = colour;
      svg.append(stroke);
      return svg;
    }

    function colourLines() {
      for (const stroke of element.querySelectorAll("[data-colour]")) {
        stroke.setAttribute("stroke", Colours.shown(stroke.dataset.colour));
      }
    }

    const sizes = new ResizeObserver(() => {
      if (root.classList.contains("printing")) return;
      for (const { uplot, place } of plots) resize(uplot, place.clientWidth);
    });

    function build(figure) {
      const index = Number(figure.dataset.chart);
      const chart = charts[index];
      const legend = figure.querySelector(".legend");
      const place = figure.querySelector(".plot");
      const outputs = [];
      const buttons = chart.curves.map((curve) => {
        const item = document.createElement("li");
        const button = document.createElement("button");
        button.type = "button";
        button.title = "show or hide";
        button.setAttribute("aria-pressed", String(!hidden.has(curve.name)));
        const output = document.createElement("output");
        button.append(line(curve), curve.name, output);
        button.addEventListener("click", () => toggle(curve.name));
        outputs.push(output);
        item.append(button);
        legend.append(item);
        return button;
      });
      colourLines();
      const plot = { index, chart, buttons, outputs, place };
      plot.uplot = new uPlot(options(plot, place.clientWidth), joined(chart), place);
      plots.push(plot);
      fingers(plot.uplot);
      sizes.observe(place);
    }

    function resize(uplot, width) {
      if (width > 0 && width !== uplot.width) uplot.setSize({ width, height: HEIGHT });
    }

    function toggle(name) { // in all plots: the runs of a comparison have one name everywhere
      if (!hidden.delete(name)) hidden.add(name);
      for (const { uplot, chart, buttons } of plots) {
        chart.curves.forEach((curve, k) => {
          if (curve.name !== name) return;
          uplot.setSeries(k + 1, { show: !hidden.has(name) });
          buttons[k].setAttribute("aria-pressed", String(!hidden.has(name)));
        });
      }
    }

    function zoom(begin, end) { // all plots together
      const width = Math.min(Math.max(end - begin, 1e-6 * (last - first)), last - first);
      const from = Math.min(Math.max(begin, first), last - width);
      range = [from, from + width];
      for (const { uplot } of plots) uplot.setScale("x", { min: range[0], max: range[1] });
      shown.textContent = `shown: ${number(range[0])} to ${number(range[1])} s`;
    }

    function timeAt(u, left) { // also where a plot has yet to be drawn in the new range
      return range[0] + (left / u.over.clientWidth) * (range[1] - range[0]);
    }

    function zoomBy(factor) {
      const [middle, half] = [(range[0] + range[1]) / 2, (factor * (range[1] - range[0])) / 2];
      zoom(middle - half, middle + half);
    }

    function moveBy(part) {
      const shift = part * (range[1] - range[0]);
      zoom(range[0] + shift, range[1] + shift);
    }

    // Two fingers zoom and move: what lay under them stays there. One finger reads out.
    function fingers(u) {
      const down = new Map();
      let under = null;
      const valuesUnder = () => [...down.values()].map((left) => timeAt(u, left));
      const place = (event) => event.clientX - u.over.getBoundingClientRect().left;
      u.over.addEventListener("pointerdown", (event) => {
        if (event.pointerType !== "touch") return;
        down.set(event.pointerId, place(event));
        under = down.size === 2 ? valuesUnder() : null;
      });
      u.over.addEventListener("pointermove", (event) => {
        if (!down.has(event.pointerId)) return;
        down.set(event.pointerId, place(event));
        if (down.size === 1) u.setCursor({ left: place(event), top: event.offsetY });
        if (!under) return;
        const [a, b] = [...down.values()];
        if (Math.abs(b - a) < 10) return;
        const slope = (under[1] - under[0]) / (b - a);
        const from = under[0] - slope * a;
        zoom(from, from + slope * u.over.clientWidth);
      });
      const up = ({ pointerId }) => {
        down.delete(pointerId);
        under = null;
      };
      for (const end of ["pointerup", "pointercancel", "pointerleave"]) u.over.addEventListener(end, up);
    }

    // --- page ---------------------------------------------------------------------------------------------------------

    const moment = document.createElement("output");
    const shown = document.createElement("output");
    for (const toolbar of element.querySelectorAll(".toolbar")) {
      const actions = {
        "zoom in": () => zoomBy(0.5),
        "zoom out": () => zoomBy(2),
        "earlier": () => moveBy(-0.5),
        "later": () => moveBy(0.5),
        "whole run": () => zoom(first, last),
      };
      for (const [name, action] of Object.entries(actions)) {
        const button = document.createElement("button");
        button.type = "button";
        button.textContent = name;
        button.addEventListener("click", action);
        toolbar.append(button);
      }
      toolbar.append(shown, moment);
    }

    function download({ file, time, columns }, index) {
      const quoted = (name) => (/[",\r\n]/.test(name) ? `"${name.replaceAll('"', '""')}"` : name);
      const digits = (value) => (Number.isFinite(value) ? String(Number(value.toPrecision(8))) : "");
      const values = columns.map((_, column) => valuesOf({ table: index, column }));
      const rows = time.map((t, k) => [digits(t), ...values.map((of) => digits(of[k]))].join(","));
      const text = [["time", ...columns.map(({ name }) => quoted(name))].join(","), ...rows, ""].join("\n");
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
      link.download = file;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    }

    for (const button of element.querySelectorAll("[data-download]")) {
      const index = Number(button.dataset.download);
      button.hidden = false;
      button.addEventListener("click", () => download(tables[index], index));
    }

    const figures = [...element.querySelectorAll("[data-chart]")];

    function buildVisible() { // a folded part has no width yet
      for (const figure of figures) {
        if (figure.clientWidth > 0 && !figure.querySelector(".uplot")) build(figure);
      }
    }

    buildVisible();
    for (const part of element.querySelectorAll("details")) part.addEventListener("toggle", buildVisible);

    function recolour() {
      colourLines();
      for (const { uplot } of plots) uplot.redraw(false, true);
    }

    const listening = new AbortController();
    const listen = (target, kind, act) => target.addEventListener(kind, act, { signal: listening.signal });
    listen(matchMedia("(prefers-color-scheme: dark)"), "change", recolour);
    listen(window, "beforeprint", () => {
      root.classList.add("printing");
      for (const { uplot } of plots) resize(uplot, PRINTED);
      recolour();
    });
    listen(window, "afterprint", () => {
      root.classList.remove("printing");
      for (const { uplot, place } of plots) resize(uplot, place.clientWidth);
      recolour();
    });

    function update(data) { // other curves of the same names; the part of the time that is shown stays
      const whole = range[0] === first && range[1] === last;
      take(data);
      for (const plot of plots) plot.chart = charts[plot.index];
      if (whole) range = [first, last];
      else zoom(...range);
      for (const plot of plots) plot.uplot.setData(joined(plot.chart));
    }

    function end() {
      listening.abort();
      sizes.disconnect();
      for (const { uplot } of plots) uplot.destroy();
    }

    return { update, end };
  }

  const source = document.getElementById("report-data");
  if (source) show(document, JSON.parse(source.textContent));
  return { show };
})();

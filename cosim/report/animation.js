// Animates runs in #animation from the JSON in #animation-data. Bodies in a plane:
// {step [s], frames, bodies: [{shape, size [m]}], runs: [{name, colour, bodies: [[x [m], z [m], direction [rad]], ...]}]}, a
// list of numbers each, or one where nothing moves; the direction is anticlockwise from that of x. The rotary pendulum:
// {step [s], runs: [{name, colour, theta [rad], delta [rad], voltage [V], mode}], voltage_limit [V]}.
// theta turns the arm about the vertical axis, anticlockwise from above; delta is 0 upright, pi hanging. With e the
// direction in which a positive theta moves the arm's tip, the pendulum points along up cos(delta) - e sin(delta).
(() => {
  "use strict";

  const ARM = 0.085; // [m]
  const PENDULUM = 0.129; // [m]
  const BOX = 0.051; // half an edge of the cube [m]
  const TURNING_HEIGHT = 0.14; // of the arm above the ground [m]
  const HUB = 0.012; // radius of what the arm turns on [m]
  const GROUND = 0.14; // radius of the disc below [m]
  const TRACE = 0.6; // how long the tip's trace is [s]
  const LOWEST = 1e-3, HIGHEST = 5; // ends of the chart's axis of |q| [rad]
  const SPEEDS = [0.1, 0.25, 0.5, 1, 2];
  const MODES = { 1: "idle", 2: "swing-up", 3: "stabilizing", 4: "fault" };
  const CAMERA = { azimuth: -0.5, elevation: 0.32, distance: 1.2 }; // [rad], [rad], [m] from the axis at the arm

  const root = document.getElementById("animation");
  if (!root) return;

  let data = null;
  try {
    data = JSON.parse(document.getElementById("animation-data").textContent);
  } catch { /* no such element, or not JSON: refused below */ }
  const refusal = refuse(data);
  if (refusal) {
    root.textContent = `There is nothing to animate: ${refusal}.`;
    return;
  }

  const { step, runs, bodies, voltage_limit: voltageLimit } = data;
  const frames = bodies ? data.frames : runs[0].theta.length;
  const duration = step * (frames - 1);
  if (!bodies) {
    for (const run of runs) run.q = run.theta.map((theta, k) => Math.hypot(theta, wrap(run.delta[k])));
  }

  // --- data ---------------------------------------------------------------------------------------------------------

  function refuse(data) {
    const positive = (value) => Number.isFinite(value) && value > 0;
    if (!data || !Array.isArray(data.runs) || data.runs.length === 0) return "the page holds no runs";
    if (data.bodies) return positive(data.step) && data.frames > 1 ? "" : "there are no two samples";
    if (!positive(data.step) || !positive(data.voltage_limit)) return "the step or the voltage limit is not positive";
    const length = data.runs[0]?.theta?.length;
    for (const run of data.runs) {
      for (const name of ["theta", "delta", "voltage", "mode"]) {
        const values = run?.[name];
        if (!Array.isArray(values) || values.length < 2) return `a run has no ${name}`;
        if (values.length !== length) return "the runs' lengths differ";
        if (!values.every(Number.isFinite)) return `a run's ${name} is not all numbers`;
      }
    }
    return "";
  }

  function wrap(angle) { // into (-pi, pi]
    return angle - 2 * Math.PI * Math.ceil((angle - Math.PI) / (2 * Math.PI));
  }

  function sample(run, t) {
    const k = Math.min(Math.floor(t / step + 1e-9), frames - 2);
    const part = t / step - k;
    const between = (values) => (Array.isArray(values) ? values[k] + part * (values[k + 1] - values[k]) : values);
    if (bodies) return run.bodies.map((place) => place.map(between));
    const mode = run.mode[part > 1 - 1e-9 ? k + 1 : k];
    return { theta: between(run.theta), delta: between(run.delta), voltage: between(run.voltage), mode };
  }

  function number(value, digits) { // with a true minus sign, and none before a zero
    const text = value.toFixed(digits);
    return Number(text) === 0 ? (0).toFixed(digits) : text.replace("-", "\u2212");
  }

  // --- page ---------------------------------------------------------------------------------------------------------

  function add(parent, tag, className, text = "") {
    const element = document.createElement(tag);
    if (className) element.className = className;
    element.textContent = text;
    parent.append(element);
    return element;
  }

  function addFact(list, label) {
    const row = add(list, "div");
    add(row, "dt", "", label);
    return add(row, "dd");
  }

  function addRun(parent, run) {
    const name = String(run.name);
    const figure = add(parent, "figure", "run");
    const head = add(figure, "figcaption");
    add(head, "span", "name", name);
    const canvas = add(figure, "canvas", "view");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", bodies ? `${name} in motion` : `Rotary pendulum under ${name}`);
    if (bodies) return { run, figure, canvas };
    const mode = add(head, "span", "mode");
    const facts = add(figure, "dl", "facts");
    const theta = addFact(facts, "arm θ");
    const delta = addFact(facts, "pendulum δ");
    const voltage = addFact(facts, "voltage");
    const bar = add(figure, "div", "bar");
    bar.setAttribute("aria-hidden", "true");
    add(bar, "span", "", `\u2212${voltageLimit} V`);
    const fill = add(add(bar, "div", "track"), "i");
    add(bar, "span", "", `+${voltageLimit} V`);
    return { run, figure, mode, canvas, theta, delta, voltage, fill };
  }

  root.textContent = "";
  root.tabIndex = 0;
  root.setAttribute("role", "group");
  root.setAttribute("aria-label", "Animation; Space plays and pauses");

  const row = add(root, "div", "runs");
  const views = runs.map((run) => addRun(row, run));

  const controls = add(root, "div", "controls");
  const button = add(controls, "button", "play");
  button.type = "button";
  const slider = add(controls, "input", "time");
  Object.assign(slider, { type: "range", min: 0, max: duration, step: "any", value: 0 });
  slider.setAttribute("aria-label", "time in seconds");
  const readout = add(controls, "output", "readout");
  const speedLabel = add(controls, "label", "speed", "speed ");
  const speedSelect = add(speedLabel, "select");
  for (const speed of SPEEDS) add(speedSelect, "option", "", `${speed}×`).value = speed;
  speedSelect.value = 1;

  const chart = add(root, "canvas", "chart"); // of the pendulum
  chart.hidden = Boolean(bodies);
  chart.setAttribute("role", "img");
  chart.setAttribute("aria-label", "Size of the angles |q| over time, logarithmic; click to go to a time");
  const hint = add(root, "p", "hint", `Press Play or Space${bodies ? "" : "; click or drag in the chart to go to a moment"}.`);

  // --- colours ------------------------------------------------------------------------------------------------------

  let colours = {};

  function readColours() {
    const read = (name) => Colours.variable(name, root);
    colours = { font: getComputedStyle(root).fontFamily };
    for (const name of ["ink", "soft", "line", "ground", "shadow", "box-top", "box-front", "box-side", "box-edge", "metal",
      "metal-edge", "shine", "mode-1", "mode-2", "mode-3", "mode-4"]) colours[name] = read(name);
    for (const view of views) {
      view.colour = Colours.shown(view.run.colour);
      view.figure.style.setProperty("--colour", view.colour);
    }
  }

  // --- projection ---------------------------------------------------------------------------------------------------

  const { azimuth, elevation, distance } = CAMERA;

  function project([x, y, z]) { // to the right, up, and the size of 1 m there
    const right = y * Math.cos(azimuth) - x * Math.sin(azimuth);
    const near = x * Math.cos(azimuth) + y * Math.sin(azimuth);
    const up = z - TURNING_HEIGHT;
    const depth = distance - near * Math.cos(elevation) - up * Math.sin(elevation);
    return [right / depth, (up * Math.cos(elevation) - near * Math.sin(elevation)) / depth, 1 / depth];
  }

  function circle(radius, z) {
    return Array.from({ length: 73 }, (_, i) => {
      const angle = (i * Math.PI) / 36;
      return [radius * Math.cos(angle), radius * Math.sin(angle), z];
    });
  }

  function armTip(theta) {
    return [ARM * Math.cos(theta), ARM * Math.sin(theta), TURNING_HEIGHT];
  }

  function pendulumTip(theta, delta) {
    const [x, y, z] = armTip(theta);
    const along = -PENDULUM * Math.sin(delta); // along e, see above
    return [x - along * Math.sin(theta), y + along * Math.cos(theta), z + PENDULUM * Math.cos(delta)];
  }

  // The pendulum stays in the vertical plane through the arm's tip, which no other part reaches: it is before all of them
  // where the camera is on the plane's outer side, else behind.
  function isBefore(theta) {
    return distance * Math.cos(elevation) * Math.cos(theta - azimuth) > ARM;
  }

  const bounds = (() => { // of all that can be drawn, projected
    const points = circle(GROUND, 0).map(project);
    for (let i = 0; i < 48; i++) {
      for (let j = 0; j < 48; j++) points.push(project(pendulumTip((i * Math.PI) / 24, (j * Math.PI) / 24)));
    }
    const [rights, ups] = [points.map((p) => p[0]), points.map((p) => p[1])];
    return { left: Math.min(...rights), right: Math.max(...rights), low: Math.min(...ups), high: Math.max(...ups) };
  })();

  // --- bodies in a plane --------------------------------------------------------------------------------------------

  const CART = 0.5; // height of a cart over its width
  const plane = bodies ? reached() : null;

  function ends([x, z, direction], { shape, size }) { // where a body begins and ends
    const [dx, dz] = [Math.cos(direction), Math.sin(direction)];
    if (shape === "rod") return [[x, z], [x + size * dx, z + size * dz]];
    if (shape === "beam") return [-0.5, 0.5].map((part) => [x + part * size * dx, z + part * size * dz]);
    return [-1, 1].map((part) => [x + part * size, z + part * size]);
  }

  function reached() { // by all bodies of all runs
    const points = [];
    for (const run of runs) {
      for (let k = 0; k < frames; k++) {
        sample(run, k * step).forEach((place, i) => points.push(...ends(place, bodies[i])));
      }
    }
    const extent = (values) => values.reduce(([low, high], v) => [Math.min(low, v), Math.max(high, v)], [Infinity, -Infinity]);
    const [[left, right], [low, high]] = [0, 1].map((axis) => extent(points.map((point) => point[axis])));
    return { left, right, low, high, size: Math.max(right - left, high - low) };
  }

  function drawBodies(view, t) {
    const { context, width, height } = prepare(view.canvas);
    if (width === 0 || height === 0) return;
    const margin = 18;
    const scale = Math.min(
      (width - 2 * margin) / (plane.right - plane.left), (height - 2 * margin) / (plane.high - plane.low));
    const at = ([x, z]) => [width / 2 + scale * (x - (plane.left + plane.right) / 2),
      height / 2 - scale * (z - (plane.low + plane.high) / 2)];
    const line = (points, stroke, thickness) => {
      context.beginPath();
      for (const point of points) context.lineTo(...at(point));
      context.strokeStyle = stroke;
      context.lineWidth = thickness;
      context.stroke();
    };
    const disc = (centre, radius, fill, stroke) => {
      context.beginPath();
      context.arc(...at(centre), radius, 0, 2 * Math.PI);
      context.fillStyle = fill;
      context.fill();
      context.strokeStyle = stroke;
      context.lineWidth = 1.5;
      context.stroke();
    };
    const thick = Math.min(Math.max(0.02 * scale * plane.size, 4), 9);
    const draw = {
      cart: ([x, z], { size }) => {
        line([[plane.left, z], [plane.right, z]], colours.soft, 1.5); // its rail
        const [left, top] = at([x - size / 2, z + (CART * size) / 2]);
        context.fillStyle = view.colour;
        context.fillRect(left, top, scale * size, scale * CART * size);
        disc([x, z], 3, colours.metal, colours["metal-edge"]);
      },
      rod: (place, body) => {
        const [from, to] = ends(place, body);
        line([from, to], colours["metal-edge"], thick + 2);
        line([from, to], view.colour, thick);
        disc(from, 0.45 * thick, colours.metal, colours["metal-edge"]);
        disc(to, 0.6 * thick, view.colour, colours["metal-edge"]);
      },
      beam: (place, body) => {
        const both = ends(place, body);
        line(both, colours["metal-edge"], thick + 2);
        line(both, view.colour, thick);
        for (const end of both) disc(end, 0.7 * thick, colours.metal, colours["metal-edge"]);
      },
      wheel: ([x, z, direction], { size }) => {
        disc([x, z], scale * size, colours.ground, view.colour);
        line([[x, z], [x + size * Math.cos(direction), z + size * Math.sin(direction)]], view.colour, thick);
      },
    };
    sample(view.run, t).forEach((place, i) => draw[bodies[i].shape](place, bodies[i]));
  }

  // --- one run ------------------------------------------------------------------------------------------------------

  // A context in CSS pixels, cleared; the canvas has as many pixels as the screen.
  function prepare(canvas) {
    const { clientWidth: width, clientHeight: height } = canvas;
    const ratio = window.devicePixelRatio || 1;
    const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.lineCap = context.lineJoin = "round";
    return { context, width, height };
  }

  function drawRun(view, t) {
    const { context, width, height } = prepare(view.canvas);
    if (width === 0 || height === 0) return;
    const margin = 10;
    const scale = Math.min(
      (width - 2 * margin) / (bounds.right - bounds.left), (height - 2 * margin) / (bounds.high - bounds.low));
    const toScreen = (point) => {
      const [right, up, size] = project(point);
      return [width / 2 + scale * (right - (bounds.left + bounds.right) / 2),
        height / 2 - scale * (up - (bounds.low + bounds.high) / 2), scale * size];
    };
    const path = (points) => {
      context.beginPath();
      for (const point of points) context.lineTo(...toScreen(point).slice(0, 2));
    };
    const polygon = (points, fill) => {
      path(points);
      context.closePath();
      context.fillStyle = fill;
      context.fill();
    };
    const line = (points, stroke, thickness) => { // the thickness in m
      path(points);
      context.strokeStyle = stroke;
      context.lineWidth = Math.max(1, thickness * toScreen(points[0])[2]);
      context.stroke();
    };
    const rod = (from, to, colour, edge, thickness) => {
      line([from, to], edge, thickness + 0.003);
      line([from, to], colour, thickness);
      line([from, to], colours.shine, 0.25 * thickness);
    };

    const { theta, delta, mode } = sample(view.run, t);
    const joint = armTip(theta);
    const tip = pendulumTip(theta, delta);

    const drawGround = () => {
      polygon(circle(GROUND, 0), colours.ground);
      const b = BOX + 0.006;
      polygon([[-b, -b, 0], [b, -b, 0], [b, b, 0], [-b, b, 0]], colours.shadow);
      line([[joint[0], joint[1], 0], [tip[0], tip[1], 0]], colours.shadow, 0.01);
    };
    const drawBox = () => {
      const [b, top] = [BOX, 2 * BOX];
      const front = [[b, -b, 0], [b, b, 0], [b, b, top], [b, -b, top]];
      const side = [[-b, -b, 0], [b, -b, 0], [b, -b, top], [-b, -b, top]];
      const lid = [[-b, -b, top], [b, -b, top], [b, b, top], [-b, b, top]];
      for (const face of [front, side, lid]) line([...face, face[0]], colours["box-edge"], 0.006); // rounds the edges
      polygon(front, colours["box-front"]);
      polygon(side, colours["box-side"]);
      polygon(lid, colours["box-top"]);
      line([[b, -0.6 * b, 0.35 * b], [b, 0.6 * b, 0.35 * b]], colours[`mode-${mode}`] || colours.soft, 0.005); // lamp
    };
    const drawDial = () => { // the arm tip's circle, and where theta is 0
      line(circle(ARM, TURNING_HEIGHT), colours.line, 0);
      line([[ARM - 0.006, 0, TURNING_HEIGHT], [ARM + 0.006, 0, TURNING_HEIGHT]], colours.soft, 0.002);
    };
    const drawHub = () => {
      const [low, high] = [2 * BOX, TURNING_HEIGHT + 0.007];
      const [x, y] = [-HUB * Math.sin(azimuth), HUB * Math.cos(azimuth)]; // its right edge as seen
      polygon(circle(HUB, low), colours["metal-edge"]);
      polygon([[-x, -y, low], [x, y, low], [x, y, high], [-x, -y, high]], colours["metal-edge"]);
      polygon(circle(HUB, high), colours.metal);
    };
    const drawArm = () => {
      const inner = joint.map((value, i) => (i < 2 ? (value * HUB) / ARM : value));
      rod(inner, joint, colours.metal, colours["metal-edge"], 0.008);
    };
    const drawHubAndArm = () => {
      const towardsViewer = Math.cos(theta - azimuth) > 0;
      for (const draw of towardsViewer ? [drawHub, drawArm] : [drawArm, drawHub]) draw();
    };
    const drawTrace = (before) => {
      const pieces = 90;
      context.lineCap = "butt"; // the pieces are translucent and must not overlap
      for (let i = 0; i < pieces; i++) {
        const [from, to] = [i, i + 1].map((k) => t - TRACE * (1 - k / pieces));
        if (from < 0) continue;
        const [a, b] = [sample(view.run, from), sample(view.run, to)];
        if (isBefore(b.theta) !== before) continue;
        context.globalAlpha = 0.55 * ((i + 1) / pieces) ** 1.5;
        line([pendulumTip(a.theta, a.delta), pendulumTip(b.theta, b.delta)], view.colour, 0.004);
      }
      context.globalAlpha = 1;
      context.lineCap = "round";
    };
    const drawPendulum = () => {
      context.setLineDash([2, 5]);
      line([joint, pendulumTip(theta, 0)], colours.soft, 0); // where delta is 0
      context.setLineDash([]);
      const pin = joint.map((value, i) => (i < 2 ? 1.07 * value : value)); // the arm's end, through the pendulum
      const parts = [
        () => rod(joint, tip, view.colour, colours["box-edge"], 0.009),
        () => rod(joint, pin, colours.metal, colours["metal-edge"], 0.004),
      ];
      for (const draw of isBefore(theta) ? parts : parts.reverse()) draw();
    };

    drawGround();
    drawTrace(false);
    if (!isBefore(theta)) drawPendulum();
    drawBox();
    drawDial();
    drawHubAndArm();
    drawTrace(true);
    if (isBefore(theta)) drawPendulum();
  }

  function writeRun(view, t) {
    const { theta, delta, voltage, mode } = sample(view.run, t);
    const degrees = 180 / Math.PI;
    view.mode.textContent = MODES[mode] || `mode ${mode}`;
    view.mode.dataset.mode = mode;
    view.theta.textContent = `${number(theta * degrees, 1)}°`;
    view.delta.textContent = `${number(wrap(delta) * degrees, 1)}°`;
    view.voltage.textContent = `${number(voltage, 2)} V`;
    const half = 50 * Math.min(Math.abs(voltage) / voltageLimit, 1); // [%]
    view.fill.style.left = `${voltage < 0 ? 50 - half : 50}%`;
    view.fill.style.width = `${half}%`;
  }

  // --- chart --------------------------------------------------------------------------------------------------------

  const MARGIN = { left: 46, right: 14, top: 30, bottom: 40 };
  const LINE = 18; // height of a line of text
  const LABEL = "|q| = √(θ² + δ²) [rad]";

  function drawChart(t) {
    const { context, width, height } = prepare(chart);
    context.font = `12px ${colours.font}`;
    const wide = (text) => context.measureText(text).width;
    const legend = views.reduce((sum, view) => sum + wide(String(view.run.name)) + 38, 0);
    const above = wide(LABEL) + legend + MARGIN.left + MARGIN.right > width ? LINE : 0; // the legend has its own line
    const [left, right, top, bottom] = [MARGIN.left, width - MARGIN.right, MARGIN.top + above, height - MARGIN.bottom];
    if (right <= left || bottom <= top) return;
    const x = (time) => left + ((right - left) * time) / duration;
    const y = (q) => bottom - ((bottom - top) * Math.log(Math.max(q, 1e-9) / LOWEST)) / Math.log(HIGHEST / LOWEST);
    const line = (points, stroke, thickness) => {
      context.beginPath();
      for (const point of points) context.lineTo(...point);
      context.strokeStyle = stroke;
      context.lineWidth = thickness;
      context.stroke();
    };
    const write = (text, at, align, baseline, colour) => {
      [context.textAlign, context.textBaseline, context.fillStyle] = [align, baseline, colour];
      context.fillText(text, ...at);
    };

    for (const [q, label] of [[1e-3, "10⁻³"], [1e-2, "10⁻²"], [1e-1, "10⁻¹"], [1, "1"]]) {
      line([[left, y(q)], [right, y(q)]], colours.line, 1);
      write(label, [left - 7, y(q)], "right", "middle", colours.soft);
      for (let i = 2; i < 10 && i * q <= HIGHEST; i++) line([[left - 3, y(i * q)], [left, y(i * q)]], colours.line, 1);
    }
    const gap = tickGap((60 * duration) / (right - left));
    for (let i = 0; i * gap <= duration * (1 + 1e-9); i++) {
      line([[x(i * gap), top], [x(i * gap), bottom]], colours.line, 1);
      write(String(Number((i * gap).toPrecision(6))), [x(i * gap), bottom + 6], "center", "top", colours.soft);
    }
    write("t [s]", [(left + right) / 2, height - 4], "center", "bottom", colours.ink);
    write(LABEL, [left, top - 10], "left", "bottom", colours.ink);

    let end = right; // the legend, from the right
    for (const view of [...views].reverse()) {
      const name = String(view.run.name);
      write(name, [end, top - 10 - above], "right", "bottom", colours.ink);
      end -= wide(name) + 6;
      line([[end - 16, top - 16 - above], [end, top - 16 - above]], view.colour, 2.5);
      end -= 32;
    }

    context.save();
    context.beginPath();
    context.rect(left, top, right - left, bottom - top);
    context.clip();
    for (const view of views) {
      const points = view.run.q.map((q, k) => [x(k * step), y(q)]);
      context.globalAlpha = 0.45;
      line(points, view.colour, 1.5);
      context.globalAlpha = 1;
      line(points.slice(0, Math.floor(t / step + 1e-9) + 1), view.colour, 1.8); // what has passed
    }
    context.restore();

    line([[x(t), top], [x(t), bottom]], colours.ink, 1);
    views.forEach((view, i) => {
      const { theta, delta } = sample(view.run, t);
      const q = Math.hypot(theta, wrap(delta));
      const radius = 4 + 1.5 * (views.length - 1 - i); // equal values show as rings
      context.beginPath();
      context.arc(x(t), Math.min(Math.max(y(q), top), bottom), radius, 0, 2 * Math.PI);
      context.fillStyle = view.colour;
      context.fill();
    });
  }

  function tickGap(least) { // 1, 2 or 5 times a power of ten
    const power = 10 ** Math.floor(Math.log10(least));
    return power * [1, 2, 5, 10].find((factor) => factor * power >= least * (1 - 1e-9));
  }

  // --- time ---------------------------------------------------------------------------------------------------------

  let time = 0;
  let playing = false;
  let previous = null; // when the last frame was drawn [ms]

  function draw() {
    for (const view of views) {
      if (bodies) {
        drawBodies(view, time);
        continue;
      }
      drawRun(view, time);
      writeRun(view, time);
    }
    if (!bodies) drawChart(time);
    readout.textContent = `t = ${time.toFixed(2)} s of ${duration.toFixed(2)} s`;
    slider.value = time;
    slider.setAttribute("aria-valuetext", `${time.toFixed(2)} seconds`);
    root.dataset.time = time.toFixed(3);
  }

  function setPlaying(value) {
    playing = value;
    root.dataset.state = playing ? "playing" : "paused";
    button.textContent = playing ? "Pause" : "Play";
    button.setAttribute("aria-label", playing ? "Pause the animation" : "Play the animation");
  }

  function seek(t) {
    hint.classList.add("done");
    time = Math.min(Math.max(t, 0), duration);
    draw();
  }

  function toggle() {
    if (playing) {
      setPlaying(false);
      return;
    }
    seek(time < duration ? time : 0);
    setPlaying(true);
    previous = null;
    requestAnimationFrame(frame);
  }

  function frame(now) {
    if (!playing) return;
    const passed = previous === null ? 0 : Math.min((now - previous) / 1000, 0.25); // a hidden page draws no frames
    previous = now;
    seek(time + passed * Number(speedSelect.value));
    if (time >= duration) setPlaying(false);
    else requestAnimationFrame(frame);
  }

  function seekToPointer(event) {
    const box = chart.getBoundingClientRect();
    const part = (event.clientX - box.left - MARGIN.left) / (box.width - MARGIN.left - MARGIN.right);
    seek(part * duration);
  }

  button.addEventListener("click", toggle);
  slider.addEventListener("input", () => seek(Number(slider.value)));
  slider.addEventListener("keydown", (event) => {
    const direction = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
    if (!direction) return;
    event.preventDefault();
    seek(time + direction * step * (event.shiftKey ? 10 : 1));
  });
  root.addEventListener("keydown", (event) => {
    if (event.key !== " " || event.target === button || event.target === speedSelect) return; // these have their own Space
    event.preventDefault();
    if (!event.repeat) toggle();
  });
  chart.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    chart.setPointerCapture(event.pointerId);
    seekToPointer(event);
  });
  chart.addEventListener("pointermove", (event) => {
    if (chart.hasPointerCapture(event.pointerId)) seekToPointer(event);
  });

  function redraw() {
    readColours();
    draw();
  }

  new ResizeObserver(draw).observe(root);
  window.addEventListener("resize", draw); // also when the zoom changes
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  setPlaying(false);
  redraw();
})();

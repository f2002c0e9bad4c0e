// What the runs have come to: the table of metrics, notes, and the plots, drawn by charts.js. Where other runs have the same
// charts, only their curves are drawn anew.
export default {
  template: `<div>
    <section aria-label="Metrics">
      <div class="scroll" tabindex="0"><table class="numbers"><thead></thead><tbody></tbody></table></div>
      <p class="note"></p>
    </section>
    <slot></slot>
    <section class="plots" aria-label="Curves"></section></div>`,
  methods: {
    part(name) {
      return this.$el.querySelector(name);
    },
    draw(number, { headings, rows, notes, drawn }) {
      this.$el.classList.remove("earlier");
      this.part("thead").replaceChildren(this.row("th", headings));
      this.part("tbody").replaceChildren(...rows.map((row) => this.row("td", row)));
      this.say(notes.join("; "));
      const kind = JSON.stringify([
        drawn.tables.length,
        drawn.charts.map(({ label, floor, curves }) => [label, floor > 0, curves]),
      ]);
      if (kind === this.kind) {
        this.shown.update(drawn);
      } else {
        this.kind = kind;
        this.build(drawn);
      }
      this.part(".plots").querySelectorAll("figure").forEach((figure, k) => {
        figure.querySelector(".plot").setAttribute("aria-label", drawn.charts[k].text);
        figure.querySelector("figcaption").textContent = drawn.charts[k].remark;
      });
      requestAnimationFrame(() => { this.$el.dataset.drawn = number; }); // for whoever waits for it
    },
    say(text) {
      this.part(".note").textContent = text;
    },
    wait() {
      this.say("computing …");
      this.keep();
    },
    keep() { // what is seen is not of what is set
      this.$el.classList.add("earlier");
    },
    row(kind, texts) {
      const row = document.createElement("tr");
      row.append(...texts.map((text, k) => {
        const cell = document.createElement(k === 0 ? "th" : kind);
        if (cell.tagName === "TH") cell.scope = kind === "th" ? "col" : "row";
        cell.textContent = text;
        return cell;
      }));
      return row;
    },
    build(drawn) {
      this.shown?.end();
      const toolbar = document.createElement("div");
      toolbar.className = "toolbar";
      const figures = drawn.charts.map((_, k) => {
        const figure = document.createElement("figure");
        figure.className = "chart";
        figure.dataset.chart = k;
        figure.innerHTML = '<ul class="legend"></ul><div class="plot" role="img"></div><figcaption class="note"></figcaption>';
        return figure;
      });
      this.part(".plots").replaceChildren(toolbar, ...figures);
      this.shown = Charts.show(this.part(".plots"), drawn);
    },
  },
  beforeUnmount() {
    this.shown?.end();
  },
};

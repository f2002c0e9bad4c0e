// The plots of the page, drawn by charts.js; where other runs have the same charts, only their curves are drawn anew.
export default {
  template: '<section class="plots" aria-label="Curves"></section>',
  methods: {
    draw(number, data) {
      const kind = JSON.stringify([
        data.tables.length,
        data.charts.map(({ label, floor, curves }) => [label, floor > 0, curves]),
      ]);
      if (kind === this.kind) {
        this.shown.update(data);
      } else {
        this.kind = kind;
        this.build(data);
      }
      this.$el.querySelectorAll(".plot").forEach((plot, k) => plot.setAttribute("aria-label", data.charts[k].text));
      this.$el.querySelectorAll("figcaption").forEach((remark, k) => { remark.textContent = data.charts[k].remark; });
      requestAnimationFrame(() => { this.$el.dataset.drawn = number; }); // for whoever waits for it
    },
    build(data) {
      this.shown?.end();
      const toolbar = document.createElement("div");
      toolbar.className = "toolbar";
      const figures = data.charts.map((_, k) => {
        const figure = document.createElement("figure");
        figure.className = "chart";
        figure.dataset.chart = k;
        figure.innerHTML = '<ul class="legend"></ul><div class="plot" role="img"></div><figcaption class="note"></figcaption>';
        return figure;
      });
      this.$el.replaceChildren(toolbar, ...figures);
      this.shown = Charts.show(this.$el, data);
    },
  },
  beforeUnmount() {
    this.shown?.end();
  },
};

// A map: panels, of which one is seen, each a picture, lines and points over two axes. All places are shares of the axes, from
// the lower left: {title, x: {label, ticks: [[place, text]]}, y, image, lines: [{d, colour, dashed}],
// points: [{at, shape, colour, ring, text, key}], legend: [{shape, colour, text}], shades: {of, low, high, text}, free}.
// It says what is chosen: {at} where a panel is free, else the {key} of the nearest point that has one.
// Marks of each panel: {cross: [x, y], y null: a line over all of y; keys: of points that are in force}.
const BOX = { left: 50, top: 8, width: 180, height: 160 };
const SIZE = { width: 238, height: 206 };
const REACH = 18; // from a click to a point
export default {
  template: `<figure class="map">
    <figcaption><b>{{ title }}</b>
      <select v-if="panels.length > 1" v-model.number="shown" :aria-label="title">
        <option v-for="(one, k) in panels" :value="k">{{ one.title }}</option></select>
      <span v-else>{{ panel.title }}</span></figcaption>
    <svg :viewBox="'0 0 ${SIZE.width} ${SIZE.height}'" role="group" :aria-label="title + ', ' + panel.title"
      :class="{ free: panel.free }" @click="choose">
      <g class="ticks">
        <template v-for="[at, text] in panel.x.ticks">
          <path :d="'M' + x(at) + ' ${BOX.top}v${BOX.height}'" /><text :x="x(at)" y="${BOX.top + BOX.height + 13}"
            text-anchor="middle">{{ text }}</text></template>
        <template v-for="[at, text] in panel.y.ticks">
          <path :d="'M${BOX.left} ' + y(at) + 'h${BOX.width}'" /><text x="${BOX.left - 5}" :y="y(at) + 3.5"
            text-anchor="end">{{ text }}</text></template>
      </g>
      <text x="${BOX.left + BOX.width / 2}" y="${SIZE.height - 6}" text-anchor="middle">{{ panel.x.label }}</text>
      <text :transform="'translate(11 ${BOX.top + BOX.height / 2}) rotate(-90)'" text-anchor="middle">{{ panel.y.label }}</text>
      <svg x="${BOX.left}" y="${BOX.top}" width="${BOX.width}" height="${BOX.height}" viewBox="0 0 1 1"
        preserveAspectRatio="none">
        <image v-if="panel.image" :href="panel.image" width="1" height="1" preserveAspectRatio="none" />
        <path v-for="line in panel.lines" :d="line.d" :stroke="colour(line.colour)" :class="{ dashed: line.dashed }" class="line" />
      </svg>
      <rect x="${BOX.left}" y="${BOX.top}" width="${BOX.width}" height="${BOX.height}" class="frame" />
      <g v-for="point in panel.points" class="point" v-bind="able(point)" @keydown.enter="send(point)"
        @keydown.space.prevent="send(point)" :transform="'translate(' + x(point.at[0]) + ' ' + y(point.at[1]) + ')'">
        <title>{{ point.text }}</title>
        <circle v-if="point.ring" r="8" class="ring" :stroke="colour(point.ring)" />
        <circle v-if="mark.keys?.includes(point.key)" r="6" class="now" />
        <path :d="shapes[point.shape]" :fill="colour(point.colour)" />
      </g>
      <path v-if="mark.cross && mark.cross[1] === null" :d="'M' + x(mark.cross[0]) + ' ${BOX.top}v${BOX.height}'" class="cross" />
      <path v-else-if="mark.cross" class="cross halo"
        :transform="'translate(' + x(mark.cross[0]) + ' ' + y(mark.cross[1]) + ')'" d="M-5 -5L5 5M-5 5L5 -5" />
      <path v-if="mark.cross && mark.cross[1] !== null" class="cross"
        :transform="'translate(' + x(mark.cross[0]) + ' ' + y(mark.cross[1]) + ')'" d="M-5 -5L5 5M-5 5L5 -5" />
    </svg>
    <div v-if="panel.shades" class="shades"><span>{{ panel.shades.low }}</span><i :style="{ background: panel.shades.of }"></i>
      <span>{{ panel.shades.high }} {{ panel.shades.text }}</span></div>
    <ul><li v-for="one in panel.legend"><svg viewBox="-8 -8 16 16">
      <circle v-if="one.shape === 'ring'" r="6" class="ring" :stroke="colour(one.colour)" />
      <path v-else-if="one.shape === 'line' || one.shape === 'dashed'" d="M-8 0H8" class="line" :stroke="colour(one.colour)"
        :class="{ dashed: one.shape === 'dashed' }" />
      <path v-else :d="shapes[one.shape]" :fill="colour(one.colour)" /></svg>{{ one.text }}</li></ul>
    <p class="note" v-for="text in notes">{{ text }}</p></figure>`,
  props: { title: String, panels: Array, notes: Array, marks: Array },
  emits: ["choose"],
  data() {
    return {
      shown: 0,
      now: this.marks,
      dark: 0,
      shapes: {
        circle: "M-3.5 0a3.5 3.5 0 1 0 7 0a3.5 3.5 0 1 0 -7 0",
        square: "M-3 -3h6v6h-6z",
        diamond: "M0 -5.5L5.5 0L0 5.5L-5.5 0z",
        triangle: "M0 -4.5L4.5 3.5L-4.5 3.5z",
      },
    };
  },
  computed: {
    panel() {
      return this.panels[this.shown];
    },
    mark() {
      return this.now[this.shown] ?? {};
    },
  },
  methods: {
    x: (share) => BOX.left + BOX.width * share,
    y: (share) => BOX.top + BOX.height * (1 - share),
    colour(name) {
      return this.dark >= 0 && name ? Colours.shown(name) : "currentColor";
    },
    able({ key, text }) {
      return key === null ? {} : { role: "button", tabindex: 0, "aria-label": text, "data-key": key };
    },
    set(marks) {
      this.now = marks;
    },
    send({ key }) {
      if (key !== null) this.$emit("choose", { key });
    },
    choose(event) {
      const { left, top, width } = event.currentTarget.getBoundingClientRect();
      const scale = SIZE.width / width;
      const at = [(event.clientX - left) * scale, (event.clientY - top) * scale];
      if (this.panel.free) {
        const shares = [(at[0] - BOX.left) / BOX.width, 1 - (at[1] - BOX.top) / BOX.height];
        if (shares.every((share) => share >= -0.03 && share <= 1.03)) this.$emit("choose", { at: shares });
        return;
      }
      const away = (point) => Math.hypot(this.x(point.at[0]) - at[0], this.y(point.at[1]) - at[1]);
      const able = this.panel.points.filter(({ key }) => key !== null);
      const nearest = able.reduce((best, one) => (!best || away(one) < away(best) ? one : best), null);
      if (nearest && away(nearest) < REACH) this.send(nearest);
    },
    recolour() {
      this.dark += 1;
    },
  },
  mounted() {
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.scheme.addEventListener("change", this.recolour);
  },
  beforeUnmount() {
    this.scheme.removeEventListener("change", this.recolour);
  },
};

// A number with its name: a field to type it, and a slider of the browser's own, which goes along. It says what is `taken`;
// `show` shows another. Where it is logarithmic, the slider is moved by the power of ten.
const STEPS = 200;
const DIGITS = 3; // of a number that a logarithmic slider gives
export default {
  template: `<label :title="meaning"><span>{{ label }}</span>
    <input type="number" :step="logarithmic ? 'any' : step" :value="text" :aria-label="label" @change="typed($event.target)" />
    <input type="range" :min="Math.min(at(min), at(value))" :max="Math.max(at(max), at(value))"
      :step="logarithmic ? (at(max) - at(min)) / ${STEPS} : step" :value="at(value)"
      :aria-label="label" :aria-valuetext="value" @input="take(from(Number($event.target.value)))" /></label>`,
  props: { label: String, meaning: String, min: Number, max: Number, step: Number, logarithmic: Boolean, whole: Boolean, start: Number },
  emits: ["taken"],
  data() {
    return { value: this.start };
  },
  computed: {
    text() { // short enough for the field
      return this.value !== 0 && Math.abs(this.value) < 1e-3 ? this.value.toExponential() : String(this.value);
    },
  },
  methods: {
    at(value) {
      if (!this.logarithmic) return value;
      return value > 0 ? Math.log10(value) : Math.log10(this.min);
    },
    from(place) {
      return this.logarithmic ? Number((10 ** place).toPrecision(DIGITS)) : place;
    },
    typed(field) {
      const value = field.value === "" ? NaN : Number(field.value);
      if (Number.isFinite(value)) this.take(this.whole ? Math.round(value) : value);
      field.value = this.text; // also where it was no number
    },
    take(value) {
      if (value === this.value) return;
      this.value = value;
      this.$emit("taken", value);
    },
    show(value) {
      this.value = value;
    },
  },
};

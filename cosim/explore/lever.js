// A number with its name: a field to type it, and a slider of the browser's own, which goes along.
export default {
  template: `<label :title="meaning"><span>{{ label }}</span>
    <input type="number" :step="step" :value="value" :aria-label="label" @change="take($event.target.value)" />
    <input type="range" :min="Math.min(min, value)" :max="Math.max(max, value)" :step="step" :value="value"
      :aria-label="label" @input="take($event.target.value)" /></label>`,
  props: { label: String, meaning: String, min: Number, max: Number, step: Number, modelValue: Number },
  emits: ["update:modelValue"],
  data() {
    return { value: this.modelValue };
  },
  methods: {
    take(text) {
      if (text === "" || Number(text) === this.value) return;
      this.value = Number(text);
      this.$emit("update:modelValue", this.value);
    },
  },
};

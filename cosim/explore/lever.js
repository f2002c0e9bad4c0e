// A slider of the browser's own, with its keys and its name for those who hear the page.
export default {
  template: `<input type="range" :min="min" :max="max" :step="step" :value="modelValue"
    @input="$emit('update:modelValue', Number($event.target.value))" />`,
  props: { min: Number, max: Number, step: Number, modelValue: Number },
  emits: ["update:modelValue"],
};

// Colours of canvases, which no style sheet reaches: read from the style, and lighter on a dark page.
const Colours = (() => {
  "use strict";

  const pen = document.createElement("canvas").getContext("2d");

  function variable(name, element = document.documentElement) {
    return getComputedStyle(element).getPropertyValue(`--${name}`).trim();
  }

  function lighten(colour, part) { // towards white
    pen.fillStyle = "#777777"; // what stays if the colour is not one
    pen.fillStyle = colour;
    const hex = pen.fillStyle; // a canvas gives an opaque colour back as #rrggbb
    if (!/^#[0-9a-f]{6}$/.test(hex)) return hex;
    const mixed = [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)).map((v) => Math.round(v + part * (255 - v)));
    return `rgb(${mixed.join(", ")})`;
  }

  return { variable, shown: (colour) => lighten(colour, Number(variable("lift"))) };
})();

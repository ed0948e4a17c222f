// Colours, as CSS text and as the 32-bit words of a canvas, in the theme of the browser.

import { theme } from "./page.mjs";

/** Okabe and Ito's colours, which colour-blind people can distinguish; in the order of `OUTCOMES`. */
const OUTCOME_COLOURS = {
  light: ["#0072b2", "#000000", "#e69f00", "#cc79a7", "#94a3b1", "#d55e00", "#009e73"],
  dark: ["#56b4e9", "#f5f5f5", "#e69f00", "#cc79a7", "#5d6b78", "#ff7f3f", "#2fd3a4"],
};

/** Colours of values from low to high: dark to bright in steps that look even, also in print. */
const STOPS = {
  light: ["#30206b", "#2f4f9e", "#1f7f9f", "#23a385", "#6fbf4a", "#d8b021"],
  dark: ["#5a49b8", "#4a7fe0", "#2fb3c4", "#48cf97", "#a8dc5e", "#fde25a"],
};

/** Colours of topics. */
const LAYER_COLOURS = {
  light: ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#8a6d00", "#56b4e9"],
  dark: ["#56b4e9", "#ff8c4b", "#2fd3a4", "#e59bc6", "#f0e442", "#9ad1f5"],
};

export const outcomeColours = () => OUTCOME_COLOURS[theme()];

/** @param {number} layer */
export const layerColour = (layer) => LAYER_COLOURS[theme()][layer % LAYER_COLOURS.light.length];

/** @param {string} colour "#rrggbb" */
export const word = (colour) => packed(channels(colour));

/** @param {string} colour */
const channels = (colour) => [1, 3, 5].map((place) => Number.parseInt(colour.slice(place, place + 2), 16));

/** @param {number[]} channels red, green and blue */
const packed = ([red, green, blue]) => (0xff000000 | (blue << 16) | (green << 8) | red) >>> 0;

/** A scale of 256 colours, as words. */
function scale() {
  const stops = STOPS[theme()].map(channels);
  return Array.from({ length: 256 }, (_, n) => {
    const place = (n / 255) * (stops.length - 1);
    const low = Math.min(Math.floor(place), stops.length - 2);
    return packed(stops[low].map((value, k) => Math.round(value + (stops[low + 1][k] - value) * (place - low))));
  });
}

/**
 * The limits between which nearly all values lie.
 * @param {ArrayLike<number>} values
 * @returns {[number, number]}
 */
export function usualRange(values) {
  const step = Math.max(1, Math.floor(values.length / 4096));
  const some = [];
  for (let n = 0; n < values.length; n += step) if (Number.isFinite(values[n])) some.push(values[n]);
  some.sort((a, b) => a - b);
  if (!some.length) return [0, 1];
  const low = some[Math.floor(some.length * 0.02)];
  const high = some[Math.ceil(some.length * 0.98) - 1];
  return high > low ? [low, high] : [low, low + 1];
}

/**
 * The colours of values, as words.
 * @param {ArrayLike<number>} values
 */
export function paintValues(values) {
  const colours = scale();
  const [low, high] = usualRange(values);
  return new Uint32Array(values.length).map((_, n) => {
    const place = Math.round(((values[n] - low) / (high - low)) * 255);
    return colours[Math.max(0, Math.min(255, place || 0))];
  });
}

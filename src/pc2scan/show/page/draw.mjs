// Draws over the points: beams, sector, rings, the height band, frames.

import { styled } from "./page.mjs";
import { niceStep } from "./stage.mjs";

/** @typedef {import("./flat.mjs").Flat} Flat */
/** @typedef {CanvasRenderingContext2D} Pen */
/** @typedef {{name: string, x: number, y: number, z: number}} Frame */

/**
 * Draw lines.
 * @param {Pen} pen
 * @param {...number[]} lines x and y of both ends, pixels
 */
export function strokeLines(pen, ...lines) {
  pen.beginPath();
  for (const [x0, y0, x1, y1] of lines) {
    pen.moveTo(x0, y0);
    pen.lineTo(x1, y1);
  }
  pen.stroke();
}

/**
 * A circle around a place.
 * @param {Pen} pen
 * @param {number} x pixels
 * @param {number} y pixels
 */
export function mark(pen, x, y) {
  pen.strokeStyle = styled("--ink");
  pen.beginPath();
  pen.arc(x, y, 6, 0, 2 * Math.PI);
  pen.stroke();
}

/** Maximum number of returns with a line from the sensor; more lines would hide everything else. */
const MOST_LINES = 1500;

/**
 * The ends of the beams: x and y of each, alternating; NaN for beams without a return.
 * @param {{angleMin: number, increment: number}} layout radians
 * @param {Float32Array} ranges metres
 * @param {(range: number) => boolean} isReturn
 */
export function endsOf({ angleMin, increment }, ranges, isReturn) {
  const ends = new Float64Array(2 * ranges.length).fill(NaN);
  ranges.forEach((range, beam) => {
    if (!isReturn(range)) return;
    const angle = angleMin + beam * increment;
    ends.set([range * Math.cos(angle), range * Math.sin(angle)], 2 * beam);
  });
  return ends;
}

/**
 * @param {Pen} pen
 * @param {Flat} view
 * @param {Float64Array} ends
 * @param {string} colour
 * @param {readonly number[]} origin where the sensor is, metres
 * @param {boolean} lines whether to draw lines from the sensor, too
 * @param {number} size of a return, pixels
 */
export function beamsFromAbove(pen, view, ends, colour, origin, lines, size = 3) {
  const [x0, y0] = [view.px(origin[0]), view.py(origin[1])];
  if (lines && ends.length / 2 <= MOST_LINES) {
    pen.strokeStyle = colour;
    pen.globalAlpha = 0.18;
    const drawn = [];
    for (let n = 0; n < ends.length; n += 2)
      if (ends[n] === ends[n]) drawn.push([x0, y0, view.px(ends[n]), view.py(ends[n + 1])]);
    strokeLines(pen, ...drawn);
    pen.globalAlpha = 1;
  }
  squares(pen, ends, (x, y) => [view.px(x), view.py(y)], colour, size);
}

/**
 * A square at each place that is known.
 * @param {Pen} pen
 * @param {Float64Array} ends
 * @param {(x: number, y: number) => [number, number]} place
 * @param {string} colour
 * @param {number} size pixels
 */
export function squares(pen, ends, place, colour, size) {
  pen.fillStyle = colour;
  for (let n = 0; n < ends.length; n += 2) {
    if (ends[n] !== ends[n]) continue;
    const [x, y] = place(ends[n], ends[n + 1]);
    pen.fillRect(x - size / 2, y - size / 2, size, size);
  }
}

/**
 * Circles at round distances.
 * @param {Pen} pen
 * @param {Flat} view
 */
export function rings(pen, view) {
  const [x, y] = [view.px(0), view.py(0)];
  const { width, height } = view.stage;
  const { scale } = view.shown;
  const step = niceStep(width / scale, 8) * scale;
  const reach = Math.hypot(Math.max(x, width - x), Math.max(y, height - y));
  pen.strokeStyle = styled("--line");
  pen.beginPath();
  for (let n = 1; n * step <= reach && n <= 60; n++) {
    pen.moveTo(x + n * step, y);
    pen.arc(x, y, n * step, 0, 2 * Math.PI);
  }
  pen.stroke();
}

/**
 * The edges of a sector, and the limits of the range.
 * @param {Pen} pen
 * @param {Flat} view
 * @param {import("./params.mjs").Params} params
 */
export function sector(pen, view, { angle_min, angle_max, range_min, range_max }) {
  const [x, y] = [view.px(0), view.py(0)];
  const { scale } = view.shown;
  const at = (/** @type {number} */ angle, /** @type {number} */ radius) =>
    /** @type {const} */ ([x + radius * Math.cos(angle), y - radius * Math.sin(angle)]);
  pen.strokeStyle = styled("--accent");
  pen.setLineDash([5, 4]);
  pen.beginPath();
  const reach = range_max < 1e6 ? range_max * scale : 1e5;
  for (const angle of angle_max - angle_min < 2 * Math.PI - 1e-3 ? [angle_min, angle_max] : []) {
    pen.moveTo(x, y);
    pen.lineTo(...at(angle, reach));
  }
  for (const radius of [range_min * scale, range_max * scale]) {
    if (!(radius > 1 && radius < 1e5)) continue;
    pen.moveTo(...at(angle_min, radius));
    pen.arc(x, y, radius, -angle_min, -angle_max, true);
  }
  pen.stroke();
  pen.setLineDash([]);
}

/**
 * The heights of the points used, as a band with two edges.
 * @param {Pen} pen
 * @param {Flat} view
 * @param {[number, number]} edges pixels, upper and lower; within the view
 */
export function band(pen, view, [upper, lower]) {
  const { width } = view.stage;
  pen.fillStyle = styled("--band");
  pen.fillRect(0, upper, width, lower - upper);
  pen.strokeStyle = pen.fillStyle = styled("--accent");
  for (const y of [upper, lower]) {
    strokeLines(pen, [0, y, width, y]);
    pen.fillRect(width / 2 - 22, y - 2.5, 44, 5);
  }
}

/**
 * The axes of the scan's frame, and crosses with names where other frames are.
 * @param {Pen} pen
 * @param {(x: number, y: number, z: number) => [number, number]} place
 * @param {Frame[]} frames
 * @param {number} length of the axes, metres
 */
export function frameMarks(pen, place, frames, length) {
  const origin = place(0, 0, 0);
  pen.lineWidth = 2;
  ["#e0483e", "#3fa34d", "#3f7fe0"].forEach((colour, axis) => {
    const [x, y, z] = [0, 1, 2].map((other) => (other === axis ? length : 0));
    pen.strokeStyle = colour;
    strokeLines(pen, [...origin, ...place(x, y, z)]);
  });
  pen.textAlign = "left";
  for (const { name, x, y, z } of together(frames)) {
    const [px, py] = place(x, y, z);
    pen.lineWidth = 1;
    pen.strokeStyle = pen.fillStyle = styled("--ink");
    strokeLines(pen, [px - 4, py, px + 4, py], [px, py - 4, px, py + 4]);
    pen.lineWidth = 3;
    pen.strokeStyle = styled("--paper");
    pen.strokeText(name, px + 6, py - 7);
    pen.fillText(name, px + 6, py - 7);
  }
  pen.lineWidth = 1;
}

/**
 * Frames at one place share their mark.
 * @param {Frame[]} frames
 */
function together(frames) {
  /** @type {Map<string, Frame>} */
  const places = new Map();
  for (const frame of frames) {
    const key = [frame.x, frame.y, frame.z].map((value) => value.toFixed(2)).join();
    const other = places.get(key);
    places.set(key, other ? { ...other, name: `${other.name}, ${frame.name}` } : frame);
  }
  return places.values();
}

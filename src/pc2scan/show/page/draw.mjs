// Draws over the points: beams, sector, rings, the height band, frames.

import { styled } from "./page.mjs";

/** @typedef {import("./flat.mjs").Flat} Flat */
/** @typedef {import("./layout.mjs").Layout} Layout */

/**
 * The parts of a scan that are drawn.
 * @typedef {object} Beams
 * @property {Pick<Layout, "angleMin" | "increment">} layout
 * @property {Float32Array} ranges metres
 */

/**
 * Draw lines.
 * @param {CanvasRenderingContext2D} pen
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

/** Maximum number of returns with a line from the sensor; more lines would hide everything else. */
const MOST_LINES = 1500;

/**
 * The ends of the beams: x and y of each, alternating; NaN for beams without a return.
 * @param {Beams} scan
 * @param {(range: number) => boolean} isReturn
 */
export function endsOf({ layout, ranges }, isReturn) {
  const ends = new Float64Array(2 * ranges.length).fill(NaN);
  for (let beam = 0; beam < ranges.length; beam++) {
    if (!isReturn(ranges[beam])) continue;
    const angle = layout.angleMin + beam * layout.increment;
    ends[2 * beam] = ranges[beam] * Math.cos(angle);
    ends[2 * beam + 1] = ranges[beam] * Math.sin(angle);
  }
  return ends;
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Flat} view
 * @param {Float64Array} ends
 * @param {string} colour
 * @param {readonly number[]} origin where the sensor is, metres
 * @param {boolean} lines whether to draw lines from the sensor, too
 * @param {number} size of a return, pixels
 */
export function beamsFromAbove(pen, view, ends, colour, origin, lines, size = 3) {
  pen.strokeStyle = pen.fillStyle = colour;
  const [x0, y0] = [view.px(origin[0]), view.py(origin[1])];
  if (lines && ends.length / 2 <= MOST_LINES) {
    pen.globalAlpha = 0.18;
    pen.beginPath();
    for (let n = 0; n < ends.length; n += 2) {
      if (ends[n] !== ends[n]) continue;
      pen.moveTo(x0, y0);
      pen.lineTo(view.px(ends[n]), view.py(ends[n + 1]));
    }
    pen.stroke();
    pen.globalAlpha = 1;
  }
  squares(pen, ends, (x, y) => [view.px(x), view.py(y)], colour, size);
}

/**
 * A square at each place that is known.
 * @param {CanvasRenderingContext2D} pen
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
 * @param {CanvasRenderingContext2D} pen
 * @param {Flat} view
 * @param {number} step metres
 */
export function rings(pen, view, step) {
  const [x, y] = [view.px(0), view.py(0)];
  const { width, height } = view.stage;
  const reach = Math.hypot(Math.max(x, width - x), Math.max(y, height - y)) / view.shown.scale;
  pen.strokeStyle = styled("--line");
  pen.beginPath();
  for (let n = 1; n * step <= reach && n <= 60; n++) {
    const radius = n * step * view.shown.scale;
    pen.moveTo(x + radius, y);
    pen.arc(x, y, radius, 0, 2 * Math.PI);
  }
  pen.stroke();
}

/**
 * The edges of a sector, and the limits of the range.
 * @param {CanvasRenderingContext2D} pen
 * @param {Flat} view
 * @param {import("./params.mjs").Params} params
 */
export function sector(pen, view, params) {
  const [x, y] = [view.px(0), view.py(0)];
  pen.strokeStyle = styled("--accent");
  pen.setLineDash([5, 4]);
  pen.beginPath();
  const reach = params.range_max < 1e6 ? params.range_max * view.shown.scale : 1e5;
  if (params.angle_max - params.angle_min < 2 * Math.PI - 1e-3) {
    for (const angle of [params.angle_min, params.angle_max]) {
      pen.moveTo(x, y);
      pen.lineTo(x + reach * Math.cos(angle), y - reach * Math.sin(angle));
    }
  }
  for (const range of [params.range_min, params.range_max]) {
    const radius = range * view.shown.scale;
    if (!(radius > 1 && radius < 1e5)) continue;
    pen.moveTo(x + radius * Math.cos(params.angle_min), y - radius * Math.sin(params.angle_min));
    pen.arc(x, y, radius, -params.angle_min, -params.angle_max, true);
  }
  pen.stroke();
  pen.setLineDash([]);
}

/**
 * The heights of the points used, as a band with two edges.
 * @param {CanvasRenderingContext2D} pen
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
 * @param {CanvasRenderingContext2D} pen
 * @param {(x: number, y: number, z: number) => [number, number]} place
 * @param {{name: string, x: number, y: number, z: number}[]} frames
 * @param {number} length of the axes, metres
 */
export function frameMarks(pen, place, frames, length) {
  const colours = ["#e0483e", "#3fa34d", "#3f7fe0"];
  const [x0, y0] = place(0, 0, 0);
  pen.lineWidth = 2;
  for (let axis = 0; axis < 3; axis++) {
    const tip = place(axis === 0 ? length : 0, axis === 1 ? length : 0, axis === 2 ? length : 0);
    pen.strokeStyle = colours[axis];
    strokeLines(pen, [x0, y0, ...tip]);
  }
  pen.lineWidth = 1;
  pen.strokeStyle = pen.fillStyle = styled("--ink");
  pen.textAlign = "left";
  /** @type {[number, number, number][]} left, right and height of the names so far */
  const named = [];
  for (const { name, x, y, z } of together(frames)) {
    const [px, py] = place(x, y, z);
    strokeLines(pen, [px - 4, py, px + 4, py], [px, py - 4, px, py + 4]);
    pen.globalAlpha = 0.75;
    const end = px + 6 + pen.measureText(name).width;
    let line = py - 7;
    // A name that would overlap another one is drawn above it.
    while (named.some(([from, to, at]) => px + 6 < to && end > from && Math.abs(at - line) < 12)) line -= 13;
    named.push([px + 6, end, line]);
    pen.lineWidth = 3;
    pen.strokeStyle = styled("--paper");
    pen.strokeText(name, px + 6, line);
    pen.lineWidth = 1;
    pen.strokeStyle = pen.fillStyle;
    pen.fillText(name, px + 6, line);
    pen.globalAlpha = 1;
  }
}

/**
 * Frames at one place share their mark.
 * @param {{name: string, x: number, y: number, z: number}[]} frames
 */
function together(frames) {
  /** @type {Map<string, {name: string, x: number, y: number, z: number}>} */
  const places = new Map();
  for (const frame of frames) {
    const key = [frame.x, frame.y, frame.z].map((value) => value.toFixed(2)).join();
    const other = places.get(key);
    places.set(key, other ? { ...other, name: `${other.name}, ${frame.name}` } : frame);
  }
  return places.values();
}

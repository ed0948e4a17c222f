// A view along an axis, with metres on its axes, pan and zoom. Views may share a window.

import { strokeLines } from "./draw.mjs";
import { styled } from "./page.mjs";
import { Stage, niceStep, tick, ticks } from "./stage.mjs";

/**
 * The part of the world that a view shows; linked views share it.
 * @typedef {object} Window
 * @property {number} x metres, in the middle
 * @property {number} y
 * @property {number} z
 * @property {number} scale pixels a metre
 * @property {number} stretch how many times as large heights are shown
 */

/** @typedef {[number, number]} Pair */

/** Space for the numbers of the axes, pixels. */
const MARGIN = { left: 40, bottom: 20 };

export class Flat {
  /**
   * @param {HTMLElement} element
   * @param {"y" | "z"} up the axis that points up; x points right
   * @param {Window} shown
   * @param {() => void} draw
   * @param {() => void} fit
   * @param {(start: Pair, reach: number) => ((at: Pair) => void) | null} grab returns what drags something that is at
   *   most `reach` pixels away; null: the view is dragged
   */
  constructor(element, up, shown, draw, fit, grab = () => null) {
    this.up = up;
    this.shown = shown;
    this.stage = new Stage(element, draw);
    const pan = (/** @type {number} */ dx, /** @type {number} */ dy) => {
      this.shown.x -= dx / this.shown.scale;
      this.shown[this.up] += dy / this.rise;
      draw();
    };
    this.stage.onDrag((start, { pointerType }) => {
      const grabbed = grab(start, pointerType === "touch" ? 21 : 7);
      return grabbed ? (_dx, _dy, at) => grabbed(at) : pan;
    });
    this.stage.onZoom((factor, at) => {
      const before = this.world(at);
      this.shown.scale = Math.min(1e5, Math.max(0.01, this.shown.scale * factor));
      const after = this.world(at);
      this.shown.x += before[0] - after[0];
      this.shown[this.up] += before[1] - after[1];
      draw();
    });
    this.stage.onKeys(fit, (right, down) => pan(-40 * right, -40 * down));
  }

  /** Pixels a metre, along the axis that points up. */
  get rise() {
    return this.shown.scale * (this.up === "z" ? this.shown.stretch : 1);
  }

  /** The size of the plot without its margins, pixels. */
  get room() {
    return [Math.max(1, this.stage.width - MARGIN.left), Math.max(1, this.stage.height - MARGIN.bottom)];
  }

  /** The middle of the plot, pixels. */
  get middle() {
    return [(this.stage.width + MARGIN.left) / 2, (this.stage.height - MARGIN.bottom) / 2];
  }

  /**
   * Show a rectangle from above, and the sensor; returns its sides.
   * @param {Pair[]} limits of x and y, metres
   */
  fit(...limits) {
    const sides = limits.map(([low, high]) => /** @type {Pair} */ ([Math.min(low, 0), Math.max(high, 0)]));
    const [x, y] = sides.map(([low, high]) => (low + high) / 2);
    const [width, height] = sides.map(([low, high]) => Math.max(1, high - low));
    const scale = 0.92 * Math.min(this.room[0] / width, this.room[1] / height);
    Object.assign(this.shown, { x, y, scale });
    return sides;
  }

  /** @param {number} x metres */
  px(x) {
    return this.middle[0] + (x - this.shown.x) * this.shown.scale;
  }

  /** @param {number} value metres, along the axis that points up */
  py(value) {
    return this.middle[1] - (value - this.shown[this.up]) * this.rise;
  }

  /**
   * The place of a pixel, metres.
   * @param {Pair} place pixels
   */
  world([px, py]) {
    const [x, y] = this.middle;
    return [this.shown.x + (px - x) / this.shown.scale, this.shown[this.up] - (py - y) / this.rise];
  }

  /**
   * Draw points.
   * @param {import("./raster.mjs").Cloud} cloud
   * @param {number} size pixels of CSS
   * @param {Uint32Array} colours
   * @param {Uint8Array | null} ranks points of rank 0 are drawn in front; null: those closer to the eye
   */
  points(cloud, size, colours, ranks) {
    const { ratio } = this.stage;
    const [scale, rise] = [this.shown.scale * ratio, this.rise * ratio];
    const right = [scale, 0, 0, this.px(0) * ratio];
    const top = this.py(0) * ratio;
    const [down, near] = this.up === "y" ? [[0, -rise, 0, top], [0, 0, 1]] : [[0, 0, -rise, top], [0, -1, 0]]; // prettier-ignore
    this.stage.points(cloud, { right, down, near }, size, colours, ranks);
  }

  /** Draw the grid and the axes' numbers, and return the pen for what is drawn above them. */
  axes() {
    const pen = this.stage.pen();
    const { width, height } = this.stage;
    const bottom = height - MARGIN.bottom;
    const step = niceStep(width / this.shown.scale, width / 90);
    const stepUp = this.rise === this.shown.scale ? step : niceStep(height / this.rise, height / 30);
    const [left, low] = this.world([MARGIN.left, bottom]);
    const [right, high] = this.world([width, 0]);
    const across = ticks(left, right, step).map((value) => ({
      at: Math.round(this.px(value)) + 0.5,
      text: tick(value, step),
    }));
    const along = ticks(low, high, stepUp).map((value) => ({
      at: Math.round(this.py(value)) + 0.5,
      text: tick(value, stepUp),
    }));
    pen.strokeStyle = styled("--grid");
    pen.globalCompositeOperation = "destination-over";
    strokeLines(pen, ...across.map(({ at }) => [at, 0, at, bottom]), ...along.map(({ at }) => [0, at, width, at]));
    pen.globalCompositeOperation = "source-over";
    pen.fillStyle = styled("--plot");
    pen.fillRect(0, 0, MARGIN.left, height);
    pen.fillRect(0, bottom, width, MARGIN.bottom);
    pen.fillStyle = styled("--faint");
    pen.textAlign = "center";
    for (const { at, text } of across)
      if (at >= MARGIN.left + 4 && at <= width - 10) pen.fillText(text, at, bottom + 11);
    pen.textAlign = "right";
    for (const { at, text } of along) if (at >= 6) pen.fillText(text, MARGIN.left - 6, at);
    pen.textAlign = "left";
    pen.fillText("m", 8, bottom + 11);
    pen.save();
    pen.beginPath();
    pen.rect(MARGIN.left, 0, width - MARGIN.left, bottom);
    pen.clip();
    return pen;
  }
}

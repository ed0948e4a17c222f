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

/** Space for the numbers of the axes, pixels. */
const MARGIN = { left: 40, bottom: 20 };

/** How close the pointer must be to something to drag it, pixels. */
export const GRAB = 7;

export class Flat {
  /**
   * @param {HTMLElement} element
   * @param {"y" | "z"} up the axis that points up; x points right
   * @param {Window} shown
   * @param {object} on
   * @param {() => void} on.change the window has changed
   * @param {() => void} on.draw draw this view
   * @param {() => void} on.fit
   * @param {(start: [number, number], reach: number) => ((at: [number, number]) => void) | null} [on.grab] something
   *   to be dragged, which is at most `reach` pixels away
   */
  constructor(element, up, shown, on) {
    this.up = up;
    this.shown = shown;
    this.stage = new Stage(element, on.draw);
    this.stage.onDrag((start, { pointerType }) => {
      const grabbed = on.grab?.(start, pointerType === "touch" ? 3 * GRAB : GRAB);
      if (grabbed) return (_dx, _dy, at) => grabbed(at);
      return (dx, dy) => {
        this.pan(dx, dy);
        on.change();
      };
    });
    this.stage.onZoom((factor, at) => {
      this.zoom(factor, at);
      on.change();
    });
    this.stage.onKeys(on.fit, (right, down) => {
      this.pan(-40 * right, -40 * down);
      on.change();
    });
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
   * Show a rectangle from above, and the sensor.
   * @param {[number, number]} x limits, metres
   * @param {[number, number]} y
   */
  fit(x, y) {
    const sides = [x, y].map(([low, high]) => [Math.min(low, 0), Math.max(high, 0)]);
    const [middleX, middleY] = sides.map(([low, high]) => (low + high) / 2);
    const [width, height] = sides.map(([low, high]) => Math.max(1, high - low));
    const scale = 0.92 * Math.min(this.room[0] / width, this.room[1] / height);
    Object.assign(this.shown, { x: middleX, y: middleY, scale });
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
   * @param {[number, number]} place pixels
   * @returns {[number, number]} metres
   */
  world([px, py]) {
    return [
      this.shown.x + (px - this.middle[0]) / this.shown.scale,
      this.shown[this.up] - (py - this.middle[1]) / this.rise,
    ];
  }

  /**
   * @param {number} dx pixels
   * @param {number} dy pixels
   */
  pan(dx, dy) {
    this.shown.x -= dx / this.shown.scale;
    this.shown[this.up] += dy / this.rise;
  }

  /**
   * @param {number} factor
   * @param {[number, number]} at the place that stays
   */
  zoom(factor, at) {
    const before = this.world(at);
    this.shown.scale = Math.min(1e5, Math.max(0.01, this.shown.scale * factor));
    const after = this.world(at);
    this.shown.x += before[0] - after[0];
    this.shown[this.up] += before[1] - after[1];
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
    const [mx, my] = this.middle;
    const scale = this.shown.scale * ratio;
    const left = mx * ratio - this.shown.x * scale;
    const rise = this.rise * ratio;
    const top = my * ratio + this.shown[this.up] * rise;
    const view =
      this.up === "y"
        ? { right: [scale, 0, 0, left], down: [0, -rise, 0, top], near: [0, 0, 1] }
        : { right: [scale, 0, 0, left], down: [0, 0, -rise, top], near: [0, -1, 0] };
    this.stage.points(cloud, view, size, colours, ranks);
  }

  /**
   * Draw the grid and the axes' numbers, and return the pen for what is drawn above them.
   */
  axes() {
    const pen = this.stage.pen();
    const { width, height } = this.stage;
    const bottom = height - MARGIN.bottom;
    const step = niceStep(width / this.shown.scale, width / 90);
    const [left, low] = this.world([MARGIN.left, bottom]);
    const [right, high] = this.world([width, 0]);
    pen.strokeStyle = styled("--grid");
    pen.fillStyle = styled("--faint");
    const numbers = [];
    const lines = [];
    for (const value of ticks(left, right, step)) {
      const x = Math.round(this.px(value)) + 0.5;
      lines.push([x, 0, x, bottom]);
      numbers.push({ x, y: bottom + 11, text: tick(value, step), align: "center" });
    }
    const stepUp = this.rise === this.shown.scale ? step : niceStep(height / this.rise, height / 30);
    for (const value of ticks(low, high, stepUp)) {
      const y = Math.round(this.py(value)) + 0.5;
      lines.push([MARGIN.left, y, width, y]);
      numbers.push({ x: MARGIN.left - 6, y, text: tick(value, stepUp), align: "right" });
    }
    pen.globalCompositeOperation = "destination-over";
    strokeLines(pen, ...lines);
    pen.globalCompositeOperation = "source-over";
    pen.fillStyle = styled("--plot");
    pen.fillRect(0, 0, MARGIN.left, height);
    pen.fillRect(0, bottom, width, MARGIN.bottom);
    pen.fillStyle = styled("--faint");
    for (const { x, y, text, align } of numbers) {
      if (y < 6 || x > width - 10 || (align === "center" && x < MARGIN.left + 4)) continue;
      pen.textAlign = /** @type {CanvasTextAlign} */ (align);
      pen.fillText(text, x, y);
    }
    pen.textAlign = "left";
    pen.fillText("m", 8, bottom + 11);
    pen.save();
    pen.beginPath();
    pen.rect(MARGIN.left, 0, width - MARGIN.left, bottom);
    pen.clip();
    return pen;
  }
}

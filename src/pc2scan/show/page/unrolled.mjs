// The view of ranges over the angle: the scan beam by beam, like a consumer reads it.

import { strokeLines } from "./draw.mjs";
import { styled } from "./page.mjs";
import { Stage, niceStep, tick, ticks } from "./stage.mjs";

const LEFT = 40;
const BOTTOM = 20;
const DEGREE = Math.PI / 180;

/**
 * @typedef {object} Curve
 * @property {number} angleMin radians
 * @property {number} increment radians
 * @property {Float32Array} ranges metres
 * @property {string} colour
 * @property {number} size of a return, pixels
 * @property {(range: number) => boolean} isReturn
 */

export class Unrolled {
  /**
   * @param {HTMLElement} element
   * @param {() => void} draw
   */
  constructor(element, draw) {
    this.stage = new Stage(element, draw);
    this.from = -180;
    this.to = 180;
  }

  /**
   * @param {Curve[]} curves
   * @param {number} marked a beam of the first curve; -1: none
   */
  draw(curves, marked) {
    const pen = this.stage.pen();
    const { width, height } = this.stage;
    const bottom = height - BOTTOM;
    const ends = curves.flatMap(({ angleMin, increment, ranges }) => [
      angleMin / DEGREE,
      (angleMin + increment * Math.max(0, ranges.length - 1)) / DEGREE,
    ]);
    this.from = Math.min(...ends);
    this.to = Math.max(...ends, this.from + 1e-3);
    const farthest = curves.map(({ ranges, isReturn }) =>
      ranges.reduce((most, range) => (isReturn(range) && range > most ? range : most), 0.5),
    );
    const most = 1.06 * Math.max(...farthest);
    const px = (/** @type {number} */ degrees) =>
      LEFT + ((degrees - this.from) / (this.to - this.from)) * (width - LEFT - 4) + 2;
    const py = (/** @type {number} */ range) => bottom * (1 - range / most);
    pen.strokeStyle = styled("--grid");
    pen.fillStyle = styled("--faint");
    const step = [1, 5, 10, 15, 30, 45, 90, 180].find((value) => (this.to - this.from) / value <= width / 50) ?? 360;
    pen.textAlign = "center";
    for (const value of ticks(this.from, this.to, step)) {
      const x = Math.round(px(value)) + 0.5;
      strokeLines(pen, [x, 0, x, bottom]);
      pen.fillText(`${value}\u00b0`, Math.min(width - 18, x), bottom + 11);
    }
    const rise = niceStep(most, height / 36);
    pen.textAlign = "right";
    for (const value of ticks(0, most, rise)) {
      const y = Math.round(py(value)) + 0.5;
      strokeLines(pen, [LEFT, y, width, y]);
      if (y > 8) pen.fillText(tick(value, rise), LEFT - 6, y);
    }
    pen.textAlign = "left";
    pen.fillText("m", 8, bottom + 11);
    for (const { angleMin, increment, ranges, colour, size, isReturn } of curves) {
      pen.fillStyle = colour;
      ranges.forEach((range, beam) => {
        const x = px((angleMin + beam * increment) / DEGREE);
        if (isReturn(range)) pen.fillRect(x - size / 2, py(range) - size / 2, size, size);
      });
    }
    if (marked < 0) return;
    const x = px((curves[0].angleMin + marked * curves[0].increment) / DEGREE);
    pen.strokeStyle = styled("--accent");
    strokeLines(pen, [x, 0, x, bottom]);
  }

  /**
   * The angle at a place, radians.
   * @param {number} x pixels
   */
  angle(x) {
    return (this.from + ((x - LEFT - 2) / (this.stage.width - LEFT - 4)) * (this.to - this.from)) * DEGREE;
  }
}

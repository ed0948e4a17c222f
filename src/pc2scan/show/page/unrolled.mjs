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
    this.top = 10;
  }

  /**
   * @param {Curve[]} curves
   * @param {number} [marked] a beam of the first curve
   */
  draw(curves, marked = -1) {
    const pen = this.stage.pen();
    const { width, height } = this.stage;
    if (!curves.length) return;
    const ends = curves.map(({ angleMin, increment, ranges }) => [
      angleMin / DEGREE,
      (angleMin + increment * Math.max(0, ranges.length - 1)) / DEGREE,
    ]);
    this.from = Math.min(...ends.map((end) => Math.min(...end)));
    this.to = Math.max(...ends.map((end) => Math.max(...end)), this.from + 1e-3);
    this.top = 1.06 * Math.max(0.5, ...curves.map(farthest));
    pen.strokeStyle = styled("--grid");
    pen.fillStyle = styled("--faint");
    const step = [1, 5, 10, 15, 30, 45, 90, 180].find((value) => (this.to - this.from) / value <= width / 50) ?? 360;
    const lines = [];
    pen.textAlign = "center";
    for (const value of ticks(this.from, this.to, step)) {
      const x = Math.round(this.px(value)) + 0.5;
      lines.push([x, 0, x, height - BOTTOM]);
      pen.fillText(`${value}\u00b0`, Math.min(width - 18, x), height - BOTTOM + 11);
    }
    const rise = niceStep(this.top, height / 36);
    pen.textAlign = "right";
    for (const value of ticks(0, this.top, rise)) {
      const y = Math.round(this.py(value)) + 0.5;
      lines.push([LEFT, y, width, y]);
      if (y > 8) pen.fillText(tick(value, rise), LEFT - 6, y);
    }
    strokeLines(pen, ...lines);
    pen.textAlign = "left";
    pen.fillText("m", 8, height - BOTTOM + 11);
    for (const { angleMin, increment, ranges, colour, size, isReturn } of curves) {
      pen.fillStyle = colour;
      for (let beam = 0; beam < ranges.length; beam++) {
        if (!isReturn(ranges[beam])) continue;
        const x = this.px((angleMin + beam * increment) / DEGREE);
        pen.fillRect(x - size / 2, this.py(ranges[beam]) - size / 2, size, size);
      }
    }
    if (marked >= 0 && curves[0]) {
      const x = this.px((curves[0].angleMin + marked * curves[0].increment) / DEGREE);
      pen.strokeStyle = styled("--accent");
      strokeLines(pen, [x, 0, x, height - BOTTOM]);
    }
  }

  /** @param {number} degrees */
  px(degrees) {
    return LEFT + ((degrees - this.from) / (this.to - this.from)) * (this.stage.width - LEFT - 4) + 2;
  }

  /** @param {number} range metres */
  py(range) {
    return (this.stage.height - BOTTOM) * (1 - range / this.top);
  }

  /**
   * The angle at a place, radians.
   * @param {number} x pixels
   */
  angle(x) {
    return (this.from + ((x - LEFT - 2) / (this.stage.width - LEFT - 4)) * (this.to - this.from)) * DEGREE;
  }
}

/** @param {Curve} curve */
function farthest({ ranges, isReturn }) {
  let found = 0;
  for (const range of ranges) if (isReturn(range) && range > found) found = range;
  return found;
}

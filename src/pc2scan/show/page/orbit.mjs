// A view in 3D that can be turned: an orthographic camera around a point, drawn in software.

import { Stage } from "./stage.mjs";

export class Orbit {
  /**
   * @param {HTMLElement} element
   * @param {object} on
   * @param {() => void} on.draw
   * @param {() => void} on.fit
   */
  constructor(element, on) {
    this.turn = -0.9;
    this.tilt = 0.75;
    this.scale = 10;
    this.centre = [0, 0, 0];
    this.stage = new Stage(element, on.draw);
    this.stage.onDrag((_start, event) => (dx, dy) => {
      if (event.shiftKey) this.slide(dx, dy);
      else this.rotate(dx * 0.008, dy * 0.008);
      on.draw();
    });
    this.stage.onZoom((factor) => {
      this.scale = Math.min(1e5, Math.max(0.01, this.scale * factor));
      on.draw();
    });
    this.stage.onKeys(on.fit, (right, down) => {
      this.rotate(0.1 * right, 0.1 * down);
      on.draw();
    });
  }

  /**
   * @param {number} turn radians
   * @param {number} tilt radians
   */
  rotate(turn, tilt) {
    this.turn += turn;
    this.tilt = Math.min(Math.PI / 2, Math.max(-0.2, this.tilt + tilt));
  }

  /**
   * @param {number} dx pixels
   * @param {number} dy pixels
   */
  slide(dx, dy) {
    const [right, up] = this.directions();
    this.centre = this.centre.map((value, axis) => value - (right[axis] * dx - up[axis] * dy) / this.scale);
  }

  /** The unit vectors that point right, up, and to the eye. */
  directions() {
    const [s, c] = [Math.sin(this.turn), Math.cos(this.turn)];
    const [st, ct] = [Math.sin(this.tilt), Math.cos(this.tilt)];
    return [
      [c, -s, 0],
      [s * st, c * st, ct],
      [-s * ct, -c * ct, st],
    ];
  }

  /**
   * Show a box as large as the view allows.
   * @param {[number, number][]} limits of x, y and z, metres
   */
  fit(limits) {
    this.centre = limits.map(([low, high]) => (low + high) / 2);
    const [right, up] = this.directions();
    const half = (/** @type {number[]} */ direction) =>
      limits.reduce((sum, [low, high], axis) => sum + (Math.abs(direction[axis]) * (high - low)) / 2, 0);
    const { width, height } = this.stage;
    this.scale = 0.46 * Math.min(width / Math.max(0.1, half(right)), height / Math.max(0.1, half(up)));
  }

  /**
   * Where a point of the world is on the screen, pixels of CSS.
   * @param {number} x metres
   * @param {number} y
   * @param {number} z
   * @returns {[number, number]}
   */
  place(x, y, z) {
    const [right, up] = this.directions();
    const d = [x - this.centre[0], y - this.centre[1], z - this.centre[2]];
    const dot = (/** @type {number[]} */ v) => v[0] * d[0] + v[1] * d[1] + v[2] * d[2];
    return [this.stage.width / 2 + dot(right) * this.scale, this.stage.height / 2 - dot(up) * this.scale];
  }

  /**
   * Draw points.
   * @param {import("./raster.mjs").Cloud} cloud
   * @param {number} size pixels of CSS
   * @param {Uint32Array} colours
   */
  points(cloud, size, colours) {
    const { ratio, width, height } = this.stage;
    const [right, up, near] = this.directions();
    const scale = this.scale * ratio;
    const row = (/** @type {number[]} */ direction, /** @type {number} */ factor, /** @type {number} */ middle) => {
      const [a, b, c] = direction.map((value) => value * factor);
      return [a, b, c, middle - a * this.centre[0] - b * this.centre[1] - c * this.centre[2]];
    };
    const view = {
      right: row(right, scale, (width * ratio) / 2),
      down: row(up, -scale, (height * ratio) / 2),
      near,
    };
    this.stage.points(cloud, view, size, colours, null);
  }
}

// A view in 3D that can be turned: an orthographic camera around a point, drawn in software.

import { Stage } from "./stage.mjs";

export class Orbit {
  /**
   * @param {HTMLElement} element
   * @param {() => void} draw
   * @param {() => void} fit
   */
  constructor(element, draw, fit) {
    this.turn = -0.9;
    this.tilt = 0.75;
    this.scale = 10;
    this.centre = [0, 0, 0];
    this.stage = new Stage(element, draw);
    const rotate = (/** @type {number} */ turn, /** @type {number} */ tilt) => {
      this.turn += turn;
      this.tilt = Math.min(Math.PI / 2, Math.max(-0.2, this.tilt + tilt));
      draw();
    };
    this.stage.onDrag(() => (dx, dy) => rotate(dx * 0.008, dy * 0.008));
    this.stage.onZoom((factor) => {
      this.scale = Math.min(1e5, Math.max(0.01, this.scale * factor));
      draw();
    });
    this.stage.onKeys(fit, (right, down) => rotate(0.1 * right, 0.1 * down));
  }

  /** The unit vectors that point right, up, and to the eye. */
  get directions() {
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
    const [across, along] = this.directions.map((direction) =>
      limits.reduce((sum, [low, high], axis) => sum + (Math.abs(direction[axis]) * (high - low)) / 2, 0),
    );
    const { width, height } = this.stage;
    this.scale = 0.46 * Math.min(width / Math.max(0.1, across), height / Math.max(0.1, along));
  }

  /** The rows that x, y, z and 1 are multiplied with: pixels of CSS from the left, and from the top. */
  get rows() {
    const [right, up] = this.directions;
    const row = (/** @type {number[]} */ direction, /** @type {number} */ factor, /** @type {number} */ middle) => {
      const [a, b, c] = direction.map((value) => value * factor);
      return [a, b, c, middle - a * this.centre[0] - b * this.centre[1] - c * this.centre[2]];
    };
    return [row(right, this.scale, this.stage.width / 2), row(up, -this.scale, this.stage.height / 2)];
  }

  /**
   * Where a point of the world is on the screen, pixels of CSS.
   * @param {number} x metres
   * @param {number} y
   * @param {number} z
   */
  place(x, y, z) {
    const [px, py] = this.rows.map(([a, b, c, d]) => a * x + b * y + c * z + d);
    return /** @type {[number, number]} */ ([px, py]);
  }

  /**
   * Draw points.
   * @param {import("./raster.mjs").Cloud} cloud
   * @param {number} size pixels of CSS
   * @param {Uint32Array} colours
   */
  points(cloud, size, colours) {
    const [right, down] = this.rows.map((row) => row.map((value) => value * this.stage.ratio));
    this.stage.points(cloud, { right, down, near: this.directions[2] }, size, colours, null);
  }
}

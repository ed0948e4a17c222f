// Draws points as coloured pixels, the nearest in front, and finds the point that a pixel shows.

/** @typedef {{x: Float32Array, y: Float32Array, z: Float32Array}} Cloud */

/**
 * Where a point is on the screen: three rows, each of which x, y, z and 1 are multiplied with.
 * @typedef {object} View
 * @property {readonly number[]} right pixels from the left
 * @property {readonly number[]} down pixels from the top
 * @property {readonly number[]} near larger is nearer to the eye
 */

export class Raster {
  constructor() {
    this.width = 0;
    this.height = 0;
    /** @type {ImageData | null} the picture; null if there is none */
    this.image = null;
    this.pixels = new Uint32Array(0);
    this.depths = new Float32Array(0);
    /** Which point each pixel shows, plus one. */
    this.points = new Int32Array(0);
  }

  /**
   * Take a size, pixels.
   * @param {number} width
   * @param {number} height
   */
  resize(width, height) {
    if (width === this.width && height === this.height) return;
    this.width = width;
    this.height = height;
    this.image = width && height ? new ImageData(width, height) : null;
    this.pixels = new Uint32Array(this.image?.data.buffer ?? new ArrayBuffer(0));
    this.depths = new Float32Array(this.pixels.length);
    this.points = new Int32Array(this.pixels.length);
  }

  /**
   * Draw a cloud.
   * @param {Cloud} cloud metres
   * @param {View} view
   * @param {number} size pixels of a point
   * @param {Uint32Array} colours of the points
   * @param {Uint8Array | null} ranks points of rank 0 are drawn in front; null: the nearest
   */
  draw({ x: xs, y: ys, z: zs }, { right: [a, b, c, p], down: [d, e, f, q], near: [g, h, i] }, size, colours, ranks) {
    const { points, depths, pixels, width } = this;
    points.fill(0);
    depths.fill(-Infinity);
    const [mostLeft, mostTop] = [width - size + 1, this.height - size + 1];
    const shift = (1 - size) / 2;
    // A view along an axis shows points of which only the place along this axis is unknown: another axis, times 0,
    // takes its place.
    const [hasX, hasY, hasZ] = [a !== 0 || d !== 0, b !== 0 || e !== 0, c !== 0 || f !== 0];
    const [us, vs, ws] = [hasX ? xs : ys, hasY ? ys : xs, hasZ ? zs : xs];
    for (let n = 0; n < us.length; n++) {
      const left = a * us[n] + b * vs[n] + c * ws[n] + p + shift;
      const top = d * us[n] + e * vs[n] + f * ws[n] + q + shift;
      if (!(left >= 0 && left < mostLeft && top >= 0 && top < mostTop)) continue;
      const depth = ranks ? Number(ranks[n] === 0) : g * xs[n] + h * ys[n] + i * zs[n];
      const first = (top | 0) * width + (left | 0);
      for (let row = 0; row < size; row++) {
        for (let place = first + row * width, end = place + size; place < end; place++) {
          if (depth < depths[place]) continue;
          depths[place] = depth;
          points[place] = n + 1;
        }
      }
    }
    for (let place = 0; place < points.length; place++)
      pixels[place] = points[place] === 0 ? 0 : colours[points[place] - 1];
  }

  /**
   * The point that is shown at a place or closest to it; -1 for none.
   * @param {number} x pixels
   * @param {number} y pixels
   * @param {number} reach pixels
   */
  at(x, y, reach) {
    let found = -1;
    let closest = reach * reach + 1;
    for (let row = Math.max(0, Math.floor(y - reach)); row <= Math.min(this.height - 1, y + reach); row++) {
      for (let column = Math.max(0, Math.floor(x - reach)); column <= Math.min(this.width - 1, x + reach); column++) {
        const point = this.points[row * this.width + column];
        const distance = (row - y) ** 2 + (column - x) ** 2;
        if (point && distance < closest) {
          closest = distance;
          found = point - 1;
        }
      }
    }
    return found;
  }
}

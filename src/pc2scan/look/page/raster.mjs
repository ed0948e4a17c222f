// Draws points as coloured pixels, the nearest in front, and finds the point that a pixel shows.

export class Raster {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.width = 0;
    this.height = 0;
    this.pixels = new Uint32Array(0);
    this.depths = new Float32Array(0);
    /** Which point each pixel shows, plus one. */
    this.points = new Int32Array(0);
    /** @type {ImageData | null} */
    this.image = null;
  }

  /** Begin a new picture, of the size of the canvas. */
  clear() {
    const { width, height } = this.canvas;
    if (width !== this.width || height !== this.height || !this.image) {
      this.width = width;
      this.height = height;
      this.image = new ImageData(Math.max(1, width), Math.max(1, height));
      this.pixels = new Uint32Array(this.image.data.buffer);
      this.depths = new Float32Array(this.pixels.length);
      this.points = new Int32Array(this.pixels.length);
    }
    this.pixels.fill(0);
    this.depths.fill(-Infinity);
    this.points.fill(0);
  }

  /**
   * Show a point, unless another one is in front of it.
   * @param {number} point
   * @param {number} x pixels
   * @param {number} y pixels
   * @param {number} depth larger is nearer
   * @param {number} colour
   * @param {number} size pixels
   */
  dot(point, x, y, depth, colour, size) {
    const { width, height } = this;
    const left = Math.round(x - size / 2);
    const top = Math.round(y - size / 2);
    if (!(left > -size && left < width && top > -size && top < height)) return;
    for (let row = Math.max(0, top); row < Math.min(height, top + size); row++) {
      for (let column = Math.max(0, left); column < Math.min(width, left + size); column++) {
        const place = row * width + column;
        if (depth < this.depths[place]) continue;
        this.depths[place] = depth;
        this.pixels[place] = colour;
        this.points[place] = point + 1;
      }
    }
  }

  /** Put the picture on the canvas. */
  show() {
    if (this.image && this.canvas.width && this.canvas.height) {
      this.canvas.getContext("2d")?.putImageData(this.image, 0, 0);
    }
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

// A drawing area, as large as its element: points, and lines and text above them.

import { Raster } from "./raster.mjs";

/** What a pixel of the screen is at most divided into: more costs time, and nobody sees it. */
const MAX_RATIO = 2;

/** @typedef {[number, number]} Pair */

export class Stage {
  /**
   * @param {HTMLElement} element
   * @param {() => void} draw called when the size changes
   */
  constructor(element, draw) {
    this.element = element;
    this.canvas = document.createElement("canvas");
    element.replaceChildren(this.canvas);
    this.raster = new Raster();
    this.ratio = 1;
    this.width = 0;
    this.height = 0;
    const resize = () => {
      this.ratio = Math.min(MAX_RATIO, window.devicePixelRatio || 1);
      this.width = this.element.clientWidth;
      this.height = this.element.clientHeight;
      this.canvas.width = Math.round(this.width * this.ratio);
      this.canvas.height = Math.round(this.height * this.ratio);
    };
    new ResizeObserver(() => {
      resize();
      draw();
    }).observe(element);
    resize();
  }

  /**
   * Draw a cloud; `pen` shows it. The parameters are those of `Raster.draw`.
   * @param {import("./raster.mjs").Cloud} cloud
   * @param {import("./raster.mjs").View} view
   * @param {number} size pixels of CSS
   * @param {Uint32Array} colours
   * @param {Uint8Array | null} ranks
   */
  points(cloud, view, size, colours, ranks) {
    this.raster.resize(this.canvas.width, this.canvas.height);
    this.raster.draw(cloud, view, Math.max(1, Math.round(size * this.ratio)), colours, ranks);
  }

  /** @returns {CanvasRenderingContext2D} for lines and text over the points, in the units of CSS */
  pen() {
    const pen = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    if (this.raster.image) pen.putImageData(this.raster.image, 0, 0);
    else pen.clearRect(0, 0, this.width, this.height);
    pen.font = `12px ${getComputedStyle(document.documentElement).fontFamily}`;
    pen.textBaseline = "middle";
    pen.lineWidth = 1;
    return pen;
  }

  /**
   * The position of an event, in CSS pixels.
   * @param {MouseEvent} event
   * @returns {Pair}
   */
  place(event) {
    const box = this.element.getBoundingClientRect();
    return [event.clientX - box.left - this.element.clientLeft, event.clientY - box.top - this.element.clientTop];
  }

  /**
   * Call a function with each step of dragging, in CSS pixels.
   * @param {(start: Pair, event: PointerEvent) => (dx: number, dy: number, at: Pair) => void} begin
   */
  onDrag(begin) {
    this.element.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !event.isPrimary) return;
      let last = this.place(event);
      const step = begin(last, event);
      this.element.setPointerCapture(event.pointerId);
      this.element.onpointermove = (moved) => {
        if (!moved.isPrimary) return;
        const at = this.place(moved);
        step(at[0] - last[0], at[1] - last[1], at);
        last = at;
      };
    });
    this.element.addEventListener("lostpointercapture", () => (this.element.onpointermove = null));
  }

  /**
   * Call a function with each arrow key, and another one to show everything: on 0 and on a double click.
   * @param {() => void} fit
   * @param {(right: number, down: number) => void} step
   */
  onKeys(fit, step) {
    this.element.addEventListener("dblclick", fit);
    this.element.addEventListener("keydown", (event) => {
      const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (event.key === "0") fit();
      if (!arrow) return;
      event.preventDefault();
      step(arrow[0], arrow[1]);
    });
  }

  /**
   * Call a function on zooming, by wheel or key, with the factor and the place that stays fixed.
   * @param {(factor: number, at: Pair) => void} zoom
   */
  onZoom(zoom) {
    const wheel = (/** @type {WheelEvent} */ event) => {
      event.preventDefault();
      zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), this.place(event));
    };
    this.element.addEventListener("wheel", wheel, { passive: false });
    this.element.addEventListener("keydown", (event) => {
      const factor = { "+": 1.25, "=": 1.25, "-": 0.8 }[event.key];
      if (factor) zoom(factor, [this.width / 2, this.height / 2]);
    });
  }
}

/**
 * Round steps for an axis.
 * @param {number} span what is shown
 * @param {number} count of steps, about
 */
export function niceStep(span, count) {
  const rough = span / Math.max(1, count);
  const power = 10 ** Math.floor(Math.log10(rough));
  return power * ([1, 2, 5, 10].find((step) => step * power >= rough) ?? 10);
}

/**
 * A number with as few digits as its step needs.
 * @param {number} value
 * @param {number} step
 */
export function tick(value, step) {
  return value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
}

/**
 * The multiples of a step between two limits; none if there would be too many to read.
 * @param {number} low
 * @param {number} high
 * @param {number} step
 */
export function ticks(low, high, step) {
  const first = Math.ceil(low / step);
  const count = Math.floor(high / step) - first + 1;
  return count > 0 && count < 200 ? Array.from({ length: count }, (_, n) => (first + n) * step) : [];
}

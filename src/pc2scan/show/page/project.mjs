// The projection of core/project.py, to the bit: ranges from points, and the outcome of each point.

import { correctAngle, olderGlibcAngle } from "./angles.mjs";
import { emptyRange } from "./params.mjs";
import { reduce } from "./reduce.mjs";
import { layoutOf } from "./layout.mjs";
import { ruleOf } from "./rule.mjs";

/** @typedef {import("./params.mjs").Params} Params */
/** @typedef {import("./layout.mjs").Layout} Layout */

/** What becomes of a point; but for filters, which come first, the order is that of the checks. */
export const OUTCOMES = /** @type {const} */ (["used", "nan", "height", "range", "angle", "past_end", "filtered"]);
const [USED, IS_NAN, HEIGHT, RANGE, ANGLE, PAST_END, FILTERED] = OUTCOMES.keys();

/**
 * @typedef {object} Cloud
 * @property {Float32Array} x metres
 * @property {Float32Array} y
 * @property {Float32Array} z
 */

/**
 * @typedef {object} Scan
 * @property {Layout} layout
 * @property {Float32Array} ranges metres, `emptyRange` for beams without a return
 * @property {Float32Array | null} intensities
 * @property {number[]} counts points, in the order of `OUTCOMES`
 * @property {Uint8Array} outcomes the outcome of each point, an index of `OUTCOMES`
 * @property {Int32Array} bins the beam of each used point
 * @property {number} returns beams that have one
 */

/**
 * Transform points into another frame, in float32: every product and every sum is rounded, from left to right.
 * @param {Cloud} cloud
 * @param {Float32Array} transform (12,): the rows of the rotation, then the translation
 * @param {Cloud} into of the same length
 * @returns {Cloud}
 */
export function transformed(cloud, transform, into) {
  const { fround } = Math;
  const [a, b, c, d, e, f, g, h, i, p, q, r] = transform;
  for (let n = 0; n < cloud.x.length; n++) {
    const x = cloud.x[n];
    const y = cloud.y[n];
    const z = cloud.z[n];
    into.x[n] = fround(fround(fround(a * x) + fround(b * y)) + fround(c * z)) + p;
    into.y[n] = fround(fround(fround(d * x) + fround(e * y)) + fround(f * z)) + q;
    into.z[n] = fround(fround(fround(g * x) + fround(h * y)) + fround(i * z)) + r;
  }
  return into;
}

/** Projects a cloud again and again. Its angles, which take most of the time, are kept; arrays are used again. */
export class Projector {
  constructor() {
    /** @type {Cloud} in the scan's frame */
    this.cloud = { x: new Float32Array(), y: new Float32Array(), z: new Float32Array() };
    /** @type {ArrayLike<number> | null} 1 for the points that filters reject */
    this.filtered = null;
    /** The angle of each point, radians; NaN until it is needed. */
    this.angles = new Float64Array();
    this.rounding = "";
    this.outcomes = new Uint8Array();
    this.bins = new Int32Array();
    this.squares = new Float64Array();
  }

  /**
   * Take other points.
   * @param {Cloud} cloud in the scan's frame
   * @param {ArrayLike<number> | null} filtered 1 for the points that filters reject
   */
  place(cloud, filtered = null) {
    this.cloud = cloud;
    this.filtered = filtered;
    const points = cloud.x.length;
    if (this.angles.length !== points) {
      this.angles = new Float64Array(points);
      this.outcomes = new Uint8Array(points);
      this.bins = new Int32Array(points);
      this.squares = new Float64Array(points);
    }
    this.angles.fill(NaN);
  }

  /**
   * Project the points.
   * @param {Params} params without a problem; see `problemOf`
   * @param {ArrayLike<number> | null} values of the intensity field, one for each point
   * @returns {Scan} `outcomes` and `bins` are overwritten by the next scan
   */
  scan(params, values = null) {
    const layout = layoutOf(params);
    const { outcomes, bins, squares } = this;
    const counts = this.count(params, layout);
    const empty = emptyRange(params);
    const returned = returnsOf(params, empty, outcomes, squares);
    const ranges = new Float32Array(layout.count).fill(empty);
    const intensities = values && new Float32Array(layout.count);
    const points = { outcomes: returned, bins, squares, values };
    const returns = reduce(params, points, layout.increment, ranges, intensities);
    return { layout, ranges, intensities, counts, outcomes, bins, returns };
  }

  /**
   * Find the outcome of each point, and the bins and squared ranges of those that are used.
   * @param {Params} params
   * @param {Layout} layout
   * @returns {number[]} points of each outcome
   */
  count(params, layout) {
    const rule = ruleOf(params);
    const { lowest, highest, least, most, first, last, offset, turn, end, skew, increment, closed } = rule;
    if (this.rounding !== params.angle_rounding) this.angles.fill(NaN);
    this.rounding = params.angle_rounding;
    const angleOf = params.angle_rounding === "glibc-2.40" ? olderGlibcAngle : correctAngle;
    const { filtered, angles, outcomes, bins, squares } = this;
    const { x: xs, y: ys, z: zs } = this.cloud;
    const beams = layout.count;
    for (let n = 0; n < xs.length; n++) {
      const x = xs[n];
      const y = ys[n];
      const z = zs[n];
      if (filtered && filtered[n]) {
        outcomes[n] = FILTERED;
        continue;
      }
      if (x !== x || y !== y || z !== z) {
        outcomes[n] = IS_NAN;
        continue;
      }
      if (!(z >= lowest && z <= highest)) {
        outcomes[n] = HEIGHT;
        continue;
      }
      const square = x * x + y * y;
      if (!(square >= least && square <= most)) {
        outcomes[n] = RANGE;
        continue;
      }
      let angle = angles[n];
      if (angle !== angle) angle = angles[n] = angleOf(y, x);
      let turned = angle + offset;
      // The angles from -float32(pi) to float32(pi) are more than one turn.
      for (let twice = 0; twice < 2; twice++) if (turned >= turn) turned -= turn;
      if (angle < first || angle > last || turned > end) {
        outcomes[n] = ANGLE;
        continue;
      }
      let bin = Math.trunc((turned + skew) / increment);
      if (bin >= beams) {
        if (!closed) {
          outcomes[n] = PAST_END;
          continue;
        }
        bin = beams - 1;
      }
      outcomes[n] = USED;
      bins[n] = bin;
      squares[n] = square;
    }
    const counts = new Array(OUTCOMES.length).fill(0);
    for (let n = 0; n < outcomes.length; n++) counts[outcomes[n]] += 1;
    return counts;
  }
}

/**
 * Outcomes in which only the returns are `USED`: their range is below that of a beam without a return, if that is not
 * a choice of pc2scan's own, and finite.
 * @param {Params} params
 * @param {number} empty the range of a beam without a return
 * @param {Uint8Array} outcomes
 * @param {Float64Array} squares
 */
function returnsOf(params, empty, outcomes, squares) {
  const limit = ["", "inf", "range-max-plus"].includes(params.no_return) ? empty : Infinity;
  if (limit > params.range_max) return outcomes;
  return outcomes.map((outcome, n) =>
    outcome === USED && !(Math.fround(Math.sqrt(squares[n])) < limit) ? RANGE : outcome,
  );
}

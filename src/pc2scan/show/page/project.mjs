// The projection of core/project.py, to the bit: ranges from points, and the outcome of each point.

import { correctAngle, olderGlibcAngle } from "./angles.mjs";
import { emptyRange } from "./params.mjs";
import { reduce } from "./reduce.mjs";
import { layoutOf } from "./layout.mjs";
import { ruleOf } from "./rule.mjs";

/** @typedef {import("./params.mjs").Params} Params */

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
 * @property {import("./layout.mjs").Layout} layout
 * @property {Float32Array} ranges metres, `emptyRange` for beams without a return
 * @property {number[]} counts points, in the order of `OUTCOMES`
 * @property {Uint8Array} outcomes the outcome of each point, an index of `OUTCOMES`
 * @property {Int32Array} bins the beam of each point that is a return, -1 for others
 * @property {number} returns beams that have one
 */

/**
 * Transform points into another frame, in float32: every product and every sum is rounded, from left to right.
 * @param {Cloud} cloud
 * @param {Float32Array} transform (12,): the rows of the rotation, then the translation
 * @returns {Cloud}
 */
export function transformed({ x, y, z }, transform) {
  const { fround } = Math;
  const [rows, moved] = [transform.subarray(0, 9), transform.subarray(9)];
  const [ahead, left, up] = [0, 1, 2].map((row) => {
    const [a, b, c] = rows.subarray(3 * row);
    return x.map((value, n) => fround(fround(fround(a * value) + fround(b * y[n])) + fround(c * z[n])) + moved[row]);
  });
  return { x: ahead, y: left, z: up };
}

/** Projects a cloud again and again. Its angles, which take most of the time, are kept; arrays are used again. */
export class Projector {
  /**
   * @param {Cloud} cloud in the scan's frame
   * @param {ArrayLike<number> | null} filtered 1 for the points that filters reject
   */
  constructor(cloud, filtered = null) {
    const points = cloud.x.length;
    this.cloud = cloud;
    this.filtered = filtered;
    /** The angle of each point, radians; NaN until it is needed. */
    this.angles = new Float32Array(points).fill(NaN);
    this.rounding = "";
    this.outcomes = new Uint8Array(points);
    this.bins = new Int32Array(points);
    this.distances = new Float32Array(points);
  }

  /**
   * Project the points.
   * @param {Params} params without a problem; see `problemOf`
   * @returns {Scan} `outcomes` and `bins` are overwritten by the next scan
   */
  scan(params) {
    const layout = layoutOf(params);
    const rule = ruleOf(params);
    if (this.rounding !== params.angle_rounding) this.angles.fill(NaN);
    this.rounding = params.angle_rounding;
    const angleOf = params.angle_rounding === "glibc-2.40" ? olderGlibcAngle : correctAngle;
    const { outcomes, bins, distances } = this;
    const empty = emptyRange(params);
    // Returns are below the range of a beam without a return, if that is not a choice of pc2scan's own, and finite.
    const limit = ["", "inf", "range-max-plus"].includes(params.no_return) ? empty : Infinity;
    const counts = new Array(OUTCOMES.length).fill(0);
    for (let n = 0; n < outcomes.length; n++) {
      outcomes[n] = this.judge(n, rule, layout.count, angleOf);
      counts[outcomes[n]] += 1;
      if (outcomes[n] !== USED || !(distances[n] < limit)) bins[n] = -1;
    }
    const ranges = new Float32Array(layout.count).fill(empty);
    const returns = reduce(params, bins, distances, layout.increment, ranges);
    return { layout, ranges, counts, outcomes, bins, returns };
  }

  /**
   * The outcome of a point; of one that is used, also its bin and its distance.
   * @param {number} n
   * @param {import("./rule.mjs").Rule} rule
   * @param {number} beams
   * @param {(y: number, x: number) => number} angleOf
   */
  judge(n, rule, beams, angleOf) {
    const [x, y, z] = [this.cloud.x[n], this.cloud.y[n], this.cloud.z[n]];
    if (this.filtered?.[n]) return FILTERED;
    if (x !== x || y !== y || z !== z) return IS_NAN;
    if (!(z >= rule.lowest && z <= rule.highest)) return HEIGHT;
    const square = x * x + y * y;
    if (!(square >= rule.least && square <= rule.most)) return RANGE;
    let angle = this.angles[n];
    if (angle !== angle) angle = this.angles[n] = angleOf(y, x);
    let turned = angle + rule.offset;
    // The angles from -float32(pi) to float32(pi) are more than one turn.
    for (let twice = 0; twice < 2; twice++) if (turned >= rule.turn) turned -= rule.turn;
    if (angle < rule.first || angle > rule.last || turned > rule.end) return ANGLE;
    const bin = Math.trunc((turned + rule.skew) / rule.increment);
    if (bin >= beams && !rule.closed) return PAST_END;
    this.bins[n] = Math.min(bin, beams - 1);
    this.distances[n] = Math.sqrt(square);
    return USED;
  }
}

// The numbers that points are compared with: the rules of core/rule.py.

import { firstFrom, nextDown64, nextUp32, nextUp64 } from "./float32.mjs";
import { TURN, layoutOf } from "./layout.mjs";

/** @typedef {import("./params.mjs").Params} Params */
/** @typedef {import("./layout.mjs").Layout} Layout */

/**
 * @typedef {object} Rule
 * @property {number} lowest limits of z, inclusive: float32 values
 * @property {number} highest
 * @property {number} least limits of the squared range, inclusive
 * @property {number} most
 * @property {number} first limits of the angle, inclusive
 * @property {number} last
 * @property {number} offset added to an angle; the sum is the angle from the first edge, called turned
 * @property {number} turn subtracted from turned if that is at least this much
 * @property {number} end points with a larger turned are outside
 * @property {number} skew the bin is the truncated quotient (turned + skew) / increment
 * @property {number} increment
 * @property {boolean} closed whether points after the last bin are put into the last bin
 */

/**
 * @param {Params} params
 * @returns {Rule}
 */
export function ruleOf(params) {
  const layout = layoutOf(params);
  const beyond = nextUp32(-firstFrom(-params.range_max));
  return {
    lowest: firstFrom(params.min_height),
    highest: -firstFrom(-params.max_height),
    least: firstSquare(firstFrom(params.range_min)),
    most: params.range_max < Infinity ? nextDown64(firstSquare(beyond)) : Infinity,
    ...(params.geometry === "upstream" ? upstreamBeams(layout) : centeredBeams(layout)),
  };
}

/** @param {Layout} layout */
function upstreamBeams({ angleMin: first, angleMax: last, increment }) {
  return { first, last, offset: -first, turn: Infinity, end: Infinity, skew: 0, increment, closed: false };
}

/** @param {Layout} layout */
function centeredBeams({ count, angleMin, increment, fullCircle }) {
  let end = Infinity;
  let skew = 0;
  if (fullCircle) skew = (count * increment - TURN) / 2;
  else if (count * increment < TURN) end = count * increment;
  const firstEdge = angleMin - increment / 2 + skew;
  const offset = TURN * Math.ceil((firstEdge + Math.PI + 1e-6) / TURN) - firstEdge;
  return { first: -Infinity, last: Infinity, offset, turn: TURN, end, skew, increment, closed: true };
}

/**
 * The smallest non-negative float64 whose root, rounded to float32, is not below a limit.
 * @param {number} limit a float32 value
 */
function firstSquare(limit) {
  if (limit <= 0) return 0;
  const before = -nextUp32(-limit);
  let square = ((before + Math.min(limit, 2 ** 128)) / 2) ** 2;
  while (Math.fround(Math.sqrt(square)) >= limit) square = nextDown64(square);
  while (Math.fround(Math.sqrt(square)) < limit) square = nextUp64(square);
  return square;
}

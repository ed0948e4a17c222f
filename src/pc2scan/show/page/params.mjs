// The projection's parameters, with the checks of core/params.py.

import { SYMMETRIC_BEAMS, layoutOf } from "./layout.mjs";

/**
 * The parameters of the projection that change the ranges; names, units and defaults are those of pc2scan.
 * @typedef {object} Params
 * @property {number} min_height metres
 * @property {number} max_height metres
 * @property {number} angle_min radians
 * @property {number} angle_max radians
 * @property {number} angle_increment radians
 * @property {number} range_min metres
 * @property {number} range_max metres
 * @property {boolean} use_inf
 * @property {number} inf_epsilon metres
 * @property {string} geometry
 * @property {number} beams
 * @property {string} no_return
 * @property {string} reduce
 * @property {number} min_points
 * @property {string} intensity_field
 * @property {string} angle_rounding
 */

const MAX_BEAMS = 4_000_000;
const { fround } = Math;

/**
 * The first problem of the parameters; null if there is none.
 * @param {Params} params
 * @returns {{name: string, message: string} | null} the parameter to blame; null where they are fine
 */
export function problemOf(params) {
  const { angle_min, angle_max, angle_increment, beams } = params;
  for (const [name, value] of Object.entries(params)) {
    if (typeof value === "number" && Number.isNaN(value)) return { name, message: "is not a number" };
  }
  for (const name of /** @type {const} */ (["angle_min", "angle_max", "angle_increment"])) {
    if (!Number.isFinite(params[name])) return { name, message: "must be finite" };
  }
  if (!(fround(angle_min) < fround(angle_max))) return { name: "angle_min", message: "must be below angle_max" };
  if (params.range_min > params.range_max) return { name: "range_min", message: "is above range_max" };
  if (params.min_height > params.max_height) return { name: "min_height", message: "is above max_height" };
  if (!Number.isInteger(beams) || beams < 0 || beams === 1 || beams > MAX_BEAMS)
    return { name: "beams", message: `must be 0, or from 2 to ${MAX_BEAMS.toLocaleString("en")}` };
  if (!beams && !(fround(angle_increment) > 0)) return { name: "angle_increment", message: "must be positive" };
  const layout = layoutOf(params);
  if (!(layout.count > 0 && layout.count <= MAX_BEAMS))
    return { name: "angle_increment", message: `makes ${layout.count.toLocaleString("en")} beams of this sector` };
  if (!(layout.angleMin < layout.angleMax))
    return { name: "angle_increment", message: "is so large that the sector has only one beam" };
  if (params.geometry === "symmetric") {
    const [least, most] = SYMMETRIC_BEAMS;
    if (layout.count < least || layout.count > most)
      return {
        name: beams ? "beams" : "angle_increment",
        message: `must make ${least} to ${most.toLocaleString("en")} beams, which MRPT reads right`,
      };
    if (!layout.fullCircle && Math.abs(angle_min + angle_max) > layout.increment / 2)
      return { name: "angle_min", message: "and angle_max must be symmetric around 0, or a full circle" };
  }
  if (params.min_points < 1) return { name: "min_points", message: "must be 1 or more" };
  if (params.no_return.startsWith("range-max") && fround(params.range_max) === Infinity)
    return { name: "no_return", message: "needs a finite range_max" };
  return null;
}

/**
 * The range of a beam that has no return: a float32 value in metres.
 * @param {Params} params
 */
export function emptyRange(params) {
  const last = fround(params.range_max);
  switch (params.no_return || (params.use_inf ? "inf" : "range-max-plus")) {
    case "range-max-plus":
      return fround(last + params.inf_epsilon);
    case "range-max-minus":
      return fround(Math.min(last - 0.0001, last * (1 - 2 ** -23)));
    case "nan":
      return NaN;
    case "zero":
      return 0;
    default:
      return Infinity;
  }
}

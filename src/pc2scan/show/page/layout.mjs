// The directions of a scan's beams, by the rules of core/layout.py.

import { nextUp32 } from "./float32.mjs";

const { fround } = Math;
export const TURN = 2 * Math.PI;
const SLACK = 1e-3;
const GAP = 0.5e-3;

/** @typedef {import("./params.mjs").Params} Params */

/**
 * @typedef {object} Layout
 * @property {number} count length of `ranges`
 * @property {number} angleMin float32, radians
 * @property {number} angleMax float32, radians
 * @property {number} increment float32, radians
 * @property {boolean} fullCircle whether the last beam and the first are neighbours
 */

/**
 * Length of a scan's ranges: the ceiling of a float32 quotient, as upstream computes it.
 * @param {number} angleMin
 * @param {number} angleMax
 * @param {number} increment
 */
function beamCount(angleMin, angleMax, increment) {
  const step = fround(increment);
  if (step === 0) return 0;
  const quotient = fround(fround(fround(angleMax) - fround(angleMin)) / step);
  return quotient > 0 && quotient < Infinity ? Math.ceil(quotient) : 0;
}

/** @param {Params} params */
function upstreamLayout({ angle_min, angle_max, angle_increment, beams }) {
  const [angleMin, angleMax] = [fround(angle_min), fround(angle_max)];
  let step = angle_increment;
  if (beams) {
    step = fround((angleMax - angleMin) / beams);
    while (beamCount(angleMin, angleMax, step) > beams) step = nextUp32(step);
  }
  const count = beamCount(angleMin, angleMax, step);
  return { count, angleMin, angleMax, increment: fround(step), fullCircle: false };
}

/** @param {Params} params */
function centeredLayout({ angle_min, angle_max, angle_increment, beams }) {
  const angleMin = fround(angle_min);
  const span = angle_max - angle_min;
  let step = beams ? span / (beams - 1) : angle_increment;
  let fullCircle = true;
  let count = beams;
  if (span < TURN) {
    count = beams || Math.floor(span / step + SLACK) + 1;
    fullCircle = count * step >= TURN - GAP * step;
  }
  if (fullCircle) {
    count = beams || Math.max(1, roundHalfEven(TURN / step));
    step = TURN / count;
  }
  let rounded = fround(step);
  if ((beams || fullCircle) && rounded > step) rounded = -nextUp32(-rounded);
  const angleMax = fround(angleMin + (count - 1) * rounded);
  return { count, angleMin, angleMax, increment: rounded, fullCircle };
}

/**
 * The beams of `centeredLayout`, with `angleMax` one increment after the last beam's middle.
 * @param {Params} params
 */
function halfOpenLayout(params) {
  const layout = centeredLayout(params);
  return { ...layout, angleMax: fround(layout.angleMin + layout.count * layout.increment) };
}

/**
 * The least and the largest number of beams of `symmetricLayout` that MRPT reads right.
 * @type {[number, number]}
 */
export const SYMMETRIC_BEAMS = [3, 100_000];

/**
 * The beams of `centeredLayout`, shifted so that their middle is 0, but for ten float32 steps: MRPT then misreads none.
 * @param {Params} params
 */
function symmetricLayout(params) {
  const layout = centeredLayout(params);
  const half = fround(((layout.count - 1) * layout.increment) / 2);
  const grid = 2 * (nextUp32(half) - half);
  const last = roundHalfEven(half / grid) * grid;
  return { ...layout, angleMin: fround(-(last + 5 * grid)), angleMax: fround(last - 5 * grid) };
}

/** @param {number} value */
function roundHalfEven(value) {
  const nearest = Math.round(value);
  return nearest - value === 0.5 && nearest % 2 ? nearest - 1 : nearest;
}

/** @type {Record<string, (params: Params) => Layout>} */
const LAYOUTS = {
  upstream: upstreamLayout,
  centered: centeredLayout,
  "half-open": halfOpenLayout,
  symmetric: symmetricLayout,
};

/** @param {Params} params */
export const layoutOf = (params) => (LAYOUTS[params.geometry] ?? upstreamLayout)(params);

// The float32 angle of a point, as pc2scan computes it: `correct`, or as an older glibc does.
//
// ECMAScript does not specify how exact `Math.atan2` is, so only fifteen of its digits are used. If these do not decide
// which float32 is closest (for two points in a hundred million), the angle is computed with whole numbers.

import { nextUp32, nextUp64 } from "./float32.mjs";

/** An upper limit of the relative error of `Math.atan2`. */
const TRUSTED = 1e-15;

/** Binary digits after the point of the fixed-point numbers below; angles may be as small as 2 ** -278. */
const DIGITS = 512n;

/**
 * `float32(atan2(y, x))`, where atan2 is rounded correctly to float64.
 * @param {number} y a float32 value, not NaN
 * @param {number} x a float32 value, not NaN
 * @returns {number} radians
 */
export function correctAngle(y, x) {
  const angle = Math.atan2(y, x);
  const low = Math.fround(angle - angle * TRUSTED);
  if (low === Math.fround(angle + angle * TRUSTED)) return low === 0 ? angle : low;
  return exactAngle(y, x, Math.abs(angle));
}

/**
 * The same, computed with whole numbers.
 * @param {number} y a float32 value, not NaN
 * @param {number} x a float32 value, not NaN
 * @param {number} near the size of the angle, by `Math.atan2`
 * @returns {number} radians
 */
export function exactAngle(y, x, near) {
  if (!Number.isFinite(x) || !Number.isFinite(y)) return Math.fround(Math.atan2(y, x));
  const below = Math.fround(near - near * TRUSTED);
  const above = nextUp32(below);
  const middle = (below + above) / 2;
  const step = nextUp64(middle) - middle;
  const size = Math.abs(y);
  // Within half a step of float64 from the middle, float64 gives the middle itself, and rounding takes the even
  // neighbour.
  let found = Math.fround(middle);
  if (isBeyond(size, x, middle, step)) found = above;
  else if (!isBeyond(size, x, middle, -step)) found = below;
  return y < 0 ? -found : found;
}

/**
 * Whether the angle of a point above the x axis is larger than `angle + step / 2`.
 * @param {number} y
 * @param {number} x
 * @param {number} angle
 * @param {number} step
 */
function isBeyond(y, x, angle, step) {
  // sin(theta - angle) has the sign of y cos(angle) - x sin(angle).
  const turn = fixed(angle) + fixed(step) / 2n;
  const square = (turn * turn) >> DIGITS;
  let sine = 0n;
  let cosine = 0n;
  let term = 1n << DIGITS;
  for (let n = 1n; term !== 0n; n += 2n) {
    cosine += term;
    const odd = ((term * turn) >> DIGITS) / n;
    sine += odd;
    term = -((term * square) >> DIGITS) / (n * (n + 1n));
  }
  return fixed(y) * cosine - fixed(x) * sine > 0n;
}

/**
 * A number in fixed point, without loss for float32 values and for angles.
 * @param {number} value finite
 */
function fixed(value) {
  let exponent = 0;
  let whole = value;
  while (!Number.isInteger(whole)) {
    whole *= 2;
    exponent += 1;
  }
  return (BigInt(whole) << DIGITS) >> BigInt(exponent);
}

const { fround } = Math;

/** The rows of the reduction, each with the smallest quotient that it applies to: a, b, c, d, high, low. */
const REDUCTION = [
  { from: 0, a: 1, b: 0, c: 0, d: 1, high: 0, low: 0 },
  { from: 7 / 16, a: 2, b: -1, c: 1, d: 2, high: fround(4.6364760399e-1), low: fround(5.012158244e-9) },
  { from: 11 / 16, a: 1, b: -1, c: 1, d: 1, high: fround(7.8539812565e-1), low: fround(3.7748947079e-8) },
  { from: 19 / 16, a: 1, b: -1.5, c: 1.5, d: 1, high: fround(9.8279368877e-1), low: fround(3.447321717e-8) },
  { from: 39 / 16, a: 0, b: -1, c: 1, d: 0, high: fround(1.5707962513), low: fround(7.5497894159e-8) },
  { from: 2 ** 25, a: 0, b: 0, c: 0, d: 1, high: fround(1.5707962513), low: fround(7.5497894159e-8) },
];

const COEFFICIENTS = Float32Array.of(
  3.3333334327e-1,
  -2.0000000298e-1,
  1.4285714924e-1,
  -1.1111110449e-1,
  9.0908870101e-2,
  -7.6918758452e-2,
  6.6610731184e-2,
  -5.8335702866e-2,
  4.9768779427e-2,
  -3.6531571299e-2,
  1.6285819933e-2,
);

const PI = fround(3.141592741);
const PI_LOW = fround(-8.7422776573e-8);
const HALF_PI = fround(1.5707963705);
const QUARTER_PI = fround(0.78539818525);

/**
 * `atan2f(y, x)` of glibc 2.31 to 2.40 on x86-64: fdlibm's algorithm, every operation rounded to float32.
 * @param {number} y a float32 value, not NaN
 * @param {number} x a float32 value, not NaN
 * @returns {number} radians
 */
export function olderGlibcAngle(y, x) {
  const up = Math.abs(y);
  const across = Math.abs(x);
  const behind = x < 0 || Object.is(x, -0);
  let turn;
  if (up === 0) turn = behind ? PI : 0;
  else if (up === Infinity && across === Infinity) turn = behind ? fround(3 * QUARTER_PI) : QUARTER_PI;
  else if (across === 0 || up === Infinity) turn = HALF_PI;
  else {
    const ahead = arcTangent(fround(up / across));
    turn = behind ? fround(PI - fround(ahead - PI_LOW)) : ahead;
  }
  return y < 0 || Object.is(y, -0) ? -turn : turn;
}

/** @param {number} quotient from 0 to infinity */
function arcTangent(quotient) {
  let row = REDUCTION.length - 1;
  while (quotient < REDUCTION[row].from) row -= 1;
  const { a, b, c, d, high, low } = REDUCTION[row];
  const t = Math.min(quotient, 2 ** 25);
  const s = fround(fround(fround(a * t) + b) / fround(fround(c * t) + d));
  const z = fround(s * s);
  const w = fround(z * z);
  let odd = COEFFICIENTS[10];
  let even = COEFFICIENTS[9];
  for (let k = 8; k >= 0; k -= 2) odd = fround(COEFFICIENTS[k] + fround(w * odd));
  for (let k = 7; k >= 1; k -= 2) even = fround(COEFFICIENTS[k] + fround(w * even));
  const sum = fround(fround(z * odd) + fround(w * even));
  return fround(high - fround(fround(fround(s * sum) - low) - s));
}

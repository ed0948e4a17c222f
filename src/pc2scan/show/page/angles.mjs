// The float32 angle of a point, as pc2scan computes it: `correct`, or as an older glibc does.

const { fround } = Math;

/**
 * `atan2f(y, x)`, rounded correctly: of a billion points, browsers round a few in the last digit the other way.
 * @param {number} y a float32 value, not NaN
 * @param {number} x a float32 value, not NaN
 */
export const correctAngle = (y, x) => fround(Math.atan2(y, x));

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

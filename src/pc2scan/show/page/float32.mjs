// Float32 arithmetic in JavaScript, whose numbers are float64. A product, a sum or a quotient of two float32 numbers,
// computed in float64 and rounded once more, is the float32 result: float64 has more than twice the digits.

const bytes = new DataView(new ArrayBuffer(8));

/**
 * The float32 next to a float32, upwards.
 * @param {number} value a float32 value, not NaN
 * @returns {number}
 */
export function nextUp32(value) {
  if (value === Infinity) return value;
  if (value === 0) return 2 ** -149;
  bytes.setFloat32(0, value);
  bytes.setInt32(0, bytes.getInt32(0) + (value > 0 ? 1 : -1));
  return bytes.getFloat32(0);
}

/**
 * The float64 next to a float64, upwards.
 * @param {number} value not NaN
 * @returns {number}
 */
export function nextUp64(value) {
  if (value === Infinity) return value;
  if (value === 0) return Number.MIN_VALUE;
  bytes.setFloat64(0, value);
  bytes.setBigInt64(0, bytes.getBigInt64(0) + (value > 0 ? 1n : -1n));
  return bytes.getFloat64(0);
}

/**
 * The float64 next to a float64, downwards.
 * @param {number} value not NaN
 * @returns {number}
 */
export function nextDown64(value) {
  return -nextUp64(-value);
}

/**
 * The smallest float32 that is not below a limit.
 * @param {number} limit
 * @returns {number}
 */
export function firstFrom(limit) {
  const nearest = Math.fround(limit);
  return nearest >= limit ? nearest : nextUp32(nearest);
}

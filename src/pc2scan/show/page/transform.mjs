// Converts the mount of a sensor (x, y, z, roll, pitch and yaw) to the float32 matrix that points are multiplied with.

/**
 * @typedef {object} Mount
 * @property {number} x metres
 * @property {number} y
 * @property {number} z
 * @property {number} roll radians, about the fixed axes x, y, z of the target frame, in that order
 * @property {number} pitch
 * @property {number} yaw
 */

export const MOUNT_KEYS = /** @type {const} */ (["x", "y", "z", "roll", "pitch", "yaw"]);

/**
 * The rotation's rows and the translation, as tf2_sensor_msgs and Eigen compute them in float32.
 * @param {readonly number[]} quaternion x, y, z, w
 * @param {readonly number[]} translation metres
 * @returns {Float32Array} (12,)
 */
export function matrixOf(quaternion, translation) {
  const { fround } = Math;
  const [x, y, z, w] = quaternion.map(fround);
  const [xx, xy, xz, xw] = [fround(2 * x * x), fround(2 * x * y), fround(2 * x * z), fround(2 * x * w)];
  const [yy, yz, yw] = [fround(2 * y * y), fround(2 * y * z), fround(2 * y * w)];
  const [zz, zw] = [fround(2 * z * z), fround(2 * z * w)];
  const [one, two, three] = [fround(yy + zz), fround(xx + zz), fround(xx + yy)];
  // prettier-ignore
  return Float32Array.of(
    1 - one, xy - zw, xz + yw,
    xy + zw, 1 - two, yz - xw,
    xz - yw, yz + xw, 1 - three,
    ...translation,
  );
}

/**
 * @param {Mount} mount
 * @returns {Float32Array} (12,)
 */
export function matrixOfMount({ x, y, z, roll, pitch, yaw }) {
  const [sr, cr, sp, cp, sy, cy] = [roll, pitch, yaw].flatMap((angle) => [Math.sin(angle / 2), Math.cos(angle / 2)]);
  // As tf2's `setRPY` computes it.
  const quaternion = [
    sr * cp * cy - cr * sp * sy,
    cr * sp * cy + sr * cp * sy,
    cr * cp * sy - sr * sp * cy,
    cr * cp * cy + sr * sp * sy,
  ];
  return matrixOf(quaternion, [x, y, z]);
}

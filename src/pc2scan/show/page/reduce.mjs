// Chooses the return of each beam that becomes its range, by the rules of core/reduce.py.

const SURFACE_DEPTH = 0.05;
const SURFACE_SLOPE = 3;

/**
 * Give each beam its range; those without enough returns keep theirs.
 * @param {import("./params.mjs").Params} params
 * @param {Int32Array} bins the beam of each point; -1: no return
 * @param {Float32Array} distances of the points, metres
 * @param {number} increment radians
 * @param {Float32Array} ranges overwritten
 * @returns {number} how many beams have a return
 */
export function reduce(params, bins, distances, increment, ranges) {
  /** @type {number[][]} of each beam, in the order of the cloud */
  const beams = [];
  for (let n = 0; n < bins.length; n++) if (bins[n] >= 0) (beams[bins[n]] ??= []).push(distances[n]);
  const kth = params.reduce.startsWith("kth=") ? Number(params.reduce.slice(4)) : 0;
  const least = Math.max(params.min_points, kth);
  let returns = 0;
  beams.forEach((own, beam) => {
    if (own.length < least) return;
    returns += 1;
    ranges[beam] = chosen(params.reduce, kth, own, increment);
  });
  return returns;
}

/**
 * @param {string} by
 * @param {number} kth
 * @param {number[]} own the returns of a beam, at least one
 * @param {number} increment
 */
function chosen(by, kth, own, increment) {
  if (by === "min") return own.reduce((a, b) => (b < a ? b : a));
  if (by === "max") return own.reduce((a, b) => (b > a ? b : a));
  if (by === "mean") return own.reduce((a, b) => a + b, 0) / own.length;
  const [...sorted] = Float32Array.from(own).sort();
  if (kth) return sorted[kth - 1];
  // The median of all returns, or of those on the closest surface.
  const limit = sorted[0] + (SURFACE_DEPTH + SURFACE_SLOPE * increment * sorted[0]);
  const near = by === "surface" ? sorted.filter((range) => range <= limit) : sorted;
  return near[(near.length - 1) >> 1];
}

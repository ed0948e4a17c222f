// Chooses the return of each beam that becomes its range, by the rules of core/reduce.py.

/** @typedef {import("./params.mjs").Params} Params */

const SURFACE_DEPTH = 0.05;
const SURFACE_SLOPE = 3;

/**
 * @typedef {object} Returns
 * @property {Uint8Array} outcomes 0 for the returns, whose ranges are finite
 * @property {Int32Array} bins
 * @property {Float64Array} squares
 * @property {ArrayLike<number> | null} values of the intensity field
 */

/**
 * Give each beam its range, and its intensity.
 * @param {Params} params
 * @param {Returns} points
 * @param {number} increment radians
 * @param {Float32Array} ranges beams without a return keep theirs
 * @param {Float32Array | null} intensities
 * @returns {number} how many beams have a return
 */
export function reduce(params, points, increment, ranges, intensities) {
  if (params.reduce === "mean") return means(params.min_points, points, ranges, intensities);
  let returns = 0;
  winners(params, points, increment, ranges.length).forEach((point, bin) => {
    if (point < 0) return;
    returns += 1;
    ranges[bin] = Math.sqrt(points.squares[point]);
    if (intensities && points.values) intensities[bin] = points.values[point];
  });
  return returns;
}

/**
 * The point that gives each beam its range, -1 for none; of points with the same range, the first in the cloud.
 * @param {Params} params
 * @param {Returns} points
 * @param {number} increment radians
 * @param {number} beams
 */
function winners(params, points, increment, beams) {
  if (params.reduce === "min" && params.min_points === 1) return closest(points, beams);
  const readers = new Int32Array(beams).fill(-1);
  const { starts, members } = grouped(points, beams);
  const ranges = new Float32Array(points.squares.length);
  for (const point of members) ranges[point] = Math.sqrt(points.squares[point]);
  const kth = params.reduce.startsWith("kth=") ? Number(params.reduce.slice(4)) : 0;
  const least = Math.max(params.min_points, kth);
  for (let bin = 0; bin < readers.length; bin++) {
    const size = starts[bin + 1] - starts[bin];
    if (size < least || size === 0) continue;
    // Stable: points of equal range stay in the order of the cloud.
    const order = members.slice(starts[bin], starts[bin + 1]).sort((a, b) => ranges[a] - ranges[b] || a - b);
    const surface = params.reduce === "surface" ? onSurface(order, ranges, increment) : size;
    let place = 0;
    if (kth) place = kth - 1;
    else if (params.reduce === "median" || params.reduce === "surface") place = (surface - 1) >> 1;
    else if (params.reduce === "max") {
      place = size - 1;
      while (place > 0 && ranges[order[place - 1]] === ranges[order[size - 1]]) place -= 1;
    }
    readers[bin] = order[place];
  }
  return readers;
}

/**
 * How many of a beam's returns are on the closest surface.
 * @param {Int32Array} order the points, the closest first
 * @param {Float32Array} ranges
 * @param {number} increment radians
 */
function onSurface(order, ranges, increment) {
  const nearest = ranges[order[0]];
  const limit = nearest + (SURFACE_DEPTH + SURFACE_SLOPE * increment * nearest);
  let count = 0;
  while (count < order.length && ranges[order[count]] <= limit) count += 1;
  return count;
}

/**
 * @param {Returns} points
 * @param {number} beams
 */
function closest({ outcomes, bins, squares }, beams) {
  const readers = new Int32Array(beams).fill(-1);
  const smallest = new Float32Array(beams).fill(Infinity);
  for (let point = 0; point < bins.length; point++) {
    if (outcomes[point] !== 0) continue;
    const bin = bins[point];
    // Different squares may have the same float32 root.
    const range = Math.fround(Math.sqrt(squares[point]));
    if (range < smallest[bin]) {
      smallest[bin] = range;
      readers[bin] = point;
    }
  }
  return readers;
}

/**
 * The points of each beam, in the order of the cloud.
 * @param {Returns} points
 * @param {number} beams
 */
function grouped({ outcomes, bins }, beams) {
  const starts = new Int32Array(beams + 1);
  for (let point = 0; point < bins.length; point++) if (outcomes[point] === 0) starts[bins[point] + 1] += 1;
  for (let bin = 0; bin < beams; bin++) starts[bin + 1] += starts[bin];
  const members = new Int32Array(starts[beams]);
  const next = starts.slice();
  for (let point = 0; point < bins.length; point++) if (outcomes[point] === 0) members[next[bins[point]]++] = point;
  return { starts, members };
}

/**
 * Give each beam the mean of its ranges, and of its values, summed in the order of the cloud.
 * @param {number} least a beam with fewer returns has none
 * @param {Returns} points
 * @param {Float32Array} ranges
 * @param {Float32Array | null} intensities
 */
function means(least, { outcomes, bins, squares, values }, ranges, intensities) {
  const [sizes, sums, lit] = [0, 1, 2].map(() => new Float64Array(ranges.length));
  for (let point = 0; point < bins.length; point++) {
    if (outcomes[point] !== 0) continue;
    const bin = bins[point];
    sizes[bin] += 1;
    sums[bin] += Math.fround(Math.sqrt(squares[point]));
    if (values) lit[bin] += values[point];
  }
  let returns = 0;
  for (let bin = 0; bin < ranges.length; bin++) {
    if (sizes[bin] < least) continue;
    returns += 1;
    ranges[bin] = sums[bin] / sizes[bin];
    if (intensities) intensities[bin] = lit[bin] / sizes[bin];
  }
  return returns;
}

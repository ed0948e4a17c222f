// Chooses the return of each beam that becomes its range, by the rules of core/reduce.py.

/** @typedef {import("./params.mjs").Params} Params */

const SURFACE_DEPTH = 0.05;
const SURFACE_SLOPE = 3;

/**
 * The point that gives each beam its range; of points with the same range, the first in the cloud.
 * @param {Int32Array} readers -1 on entry; the winners on return
 * @param {Params} params
 * @param {Uint8Array} outcomes 0 for the returns, whose ranges are finite
 * @param {Int32Array} bins
 * @param {Float64Array} squares
 * @param {number} increment radians
 */
export function winners(readers, params, outcomes, bins, squares, increment) {
  if (params.reduce === "min" && params.min_points === 1) {
    closest(readers, outcomes, bins, squares);
    return;
  }
  const { starts, members } = grouped(readers.length, outcomes, bins);
  const ranges = new Float32Array(squares.length);
  for (const point of members) ranges[point] = Math.sqrt(squares[point]);
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
 * @param {Int32Array} readers
 * @param {Uint8Array} outcomes
 * @param {Int32Array} bins
 * @param {Float64Array} squares
 */
function closest(readers, outcomes, bins, squares) {
  const smallest = new Float32Array(readers.length).fill(Infinity);
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
}

/**
 * The points of each beam, in the order of the cloud.
 * @param {number} beams
 * @param {Uint8Array} outcomes
 * @param {Int32Array} bins
 */
function grouped(beams, outcomes, bins) {
  const starts = new Int32Array(beams + 1);
  for (let point = 0; point < bins.length; point++) if (outcomes[point] === 0) starts[bins[point] + 1] += 1;
  for (let bin = 0; bin < beams; bin++) starts[bin + 1] += starts[bin];
  const members = new Int32Array(starts[beams]);
  const next = starts.slice();
  for (let point = 0; point < bins.length; point++) if (outcomes[point] === 0) members[next[bins[point]]++] = point;
  return { starts, members };
}

/**
 * The mean of each beam's ranges, and of its values, summed in the order of the cloud.
 * @param {number} beams
 * @param {number} least a beam with fewer returns has none
 * @param {Uint8Array} outcomes
 * @param {Int32Array} bins
 * @param {Float64Array} squares
 * @param {ArrayLike<number> | null} values
 */
export function means(beams, least, outcomes, bins, squares, values) {
  const sizes = new Float64Array(beams);
  const ranges = new Float64Array(beams);
  const lit = values && new Float64Array(beams);
  for (let point = 0; point < bins.length; point++) {
    if (outcomes[point] !== 0) continue;
    const bin = bins[point];
    sizes[bin] += 1;
    ranges[bin] += Math.fround(Math.sqrt(squares[point]));
    if (lit && values) lit[bin] += values[point];
  }
  const seen = new Uint8Array(beams);
  for (let bin = 0; bin < beams; bin++) {
    if (sizes[bin] < least) continue;
    seen[bin] = 1;
    ranges[bin] /= sizes[bin];
    if (lit) lit[bin] /= sizes[bin];
  }
  return { seen, ranges, values: lit };
}

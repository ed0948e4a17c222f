// Reads the data that Python put into the page: a description as JSON, and compressed arrays as text.

/**
 * @typedef {object} FieldData
 * @property {string} name
 * @property {"f4" | "f8" | "u1" | "i1" | "u2" | "i2" | "u4" | "i4"} type little-endian
 */

/**
 * @typedef {object} ArrayData
 * @property {string} id of the element that holds the bytes
 * @property {number} length values of each field
 * @property {FieldData[]} fields
 */

/** @typedef {Float32Array | Float64Array | Uint8Array | Int8Array | Uint16Array | Int16Array | Uint32Array | Int32Array} Column */

const TYPES = {
  f4: Float32Array,
  f8: Float64Array,
  u1: Uint8Array,
  i1: Int8Array,
  u2: Uint16Array,
  i2: Int16Array,
  u4: Uint32Array,
  i4: Int32Array,
};

/** @returns {any} the description of what the page shows */
export function description() {
  return JSON.parse(document.getElementById("recording")?.textContent ?? "{}");
}

/**
 * Decompress the arrays of a cloud or of some scans.
 * @param {ArrayData} data
 * @returns {Promise<Map<string, Column>>} by field name, in order
 */
export async function columns(data) {
  const text = document.getElementById(data.id)?.textContent ?? "";
  const bytes = await inflated(bytesOf(text.trim()));
  /** @type {Map<string, Column>} */
  const found = new Map();
  let begin = 0;
  for (const { name, type } of data.fields) {
    const column = new TYPES[type](data.length);
    joinPlanes(bytes.subarray(begin, begin + column.byteLength), column);
    begin += column.byteLength;
    found.set(name, column);
  }
  return found;
}

/** @param {string} text base64 */
function bytesOf(text) {
  const characters = atob(text);
  const bytes = new Uint8Array(characters.length);
  for (let n = 0; n < bytes.length; n++) bytes[n] = characters.charCodeAt(n);
  return bytes;
}

/** @param {Uint8Array<ArrayBuffer>} bytes zlib's raw deflate format */
async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/**
 * Join the bytes of values that are stored with the first bytes of all values first, then their second bytes, and so
 * on, which compresses better.
 * @param {Uint8Array} planes
 * @param {Column} column overwritten
 */
function joinPlanes(planes, column) {
  const width = column.BYTES_PER_ELEMENT;
  const bytes = new Uint8Array(column.buffer);
  for (let place = 0; place < width; place++) {
    const plane = planes.subarray(place * column.length, (place + 1) * column.length);
    for (let n = 0; n < column.length; n++) bytes[n * width + place] = plane[n];
  }
}

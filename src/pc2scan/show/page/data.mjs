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
 * Decompress the arrays of a cloud or of some scans. The first bytes of all values come first, then their second bytes,
 * and so on, which compresses better.
 * @param {ArrayData} data
 * @returns {Promise<Map<string, Column>>} by field name, in order
 */
export async function columns({ id, length, fields }) {
  const text = document.getElementById(id)?.textContent ?? "";
  const characters = atob(text.trim());
  // Not `from` with a function, which takes ten times as long.
  const packed = new Uint8Array(characters.length).map((_, n) => characters.charCodeAt(n));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  /** @type {Map<string, Column>} */
  const found = new Map();
  let begin = 0;
  for (const { name, type } of fields) {
    const column = new TYPES[type](length);
    const bytes = new Uint8Array(column.buffer);
    const width = column.BYTES_PER_ELEMENT;
    for (let n = 0; n < bytes.length; n++) bytes[n] = planes[begin + (n % width) * length + Math.floor(n / width)];
    begin += bytes.length;
    found.set(name, column);
  }
  return found;
}

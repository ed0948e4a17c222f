// Counts the messages that @mcap/core's stream reader gets out of MCAP files that may be damaged:
//   node mcap_stream_count.mjs NODE_MODULES FILE...
// Prints a JSON list of numbers. A reader that gives up counts what it returned before.
import { createRequire } from "node:module";
import { readFileSync } from "node:fs";
import { join } from "node:path";

const [modules, ...files] = process.argv.slice(2);
const require = createRequire(join(modules, "x.js"));
const { McapStreamReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");

const decompressHandlers = await loadDecompressHandlers();
const counts = files.map((file) => {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: false });
  let count = 0;
  try {
    reader.append(readFileSync(file));
    for (let record; (record = reader.nextRecord()); ) {
      count += record.type === "Message" ? 1 : 0;
    }
  } catch {
    // What came before counts.
  }
  return count;
});
console.log(JSON.stringify(counts));

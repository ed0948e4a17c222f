// Prints a ROS 1 bag's messages as JSON, as the npm package @foxglove/rosbag reads them.
//
//     node rosbag_reader.mjs NODE_MODULES FILE
import { createHash } from "node:crypto";
import { createRequire } from "node:module";
import { join } from "node:path";

const [modules, path] = process.argv.slice(2);
const require = createRequire(join(modules, "anything.js"));
const { Bag } = require("@foxglove/rosbag");
const { FileReader } = require("@foxglove/rosbag/node");
const decompressLz4 = require("@foxglove/wasm-lz4");
const Bzip2 = require("@foxglove/wasm-bz2");

await decompressLz4.isLoaded;
const bzip2 = await Bzip2.init();

const bag = new Bag(new FileReader(path), {
  parse: false,
  decompress: {
    lz4: (buffer, size) => decompressLz4(buffer, size),
    bz2: (buffer, size) => bzip2.decompress(buffer, size, { small: false }),
  },
});
await bag.open();

const messages = [];
for await (const { topic, timestamp, data } of bag.messageIterator()) {
  const time = BigInt(timestamp.sec) * 1_000_000_000n + BigInt(timestamp.nsec);
  messages.push([topic, time.toString(), createHash("sha256").update(data).digest("hex")]);
}
const connections = [...bag.connections.values()].map(({ topic, type, md5sum, messageDefinition }) => ({
  topic,
  type,
  md5sum,
  messageDefinition,
}));
console.log(JSON.stringify({ connections, messages }));

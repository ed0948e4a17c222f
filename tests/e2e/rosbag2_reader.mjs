// Prints the messages of a rosbag2 database as JSON, topic by topic, as the npm package @foxglove/rosbag2-web reads them.
//
//     node rosbag2_reader.mjs NODE_MODULES FILE
import { createHash } from "node:crypto";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { join } from "node:path";

const [modules, path] = process.argv.slice(2);
const require = createRequire(join(modules, "anything.js"));
const { SqliteSqljs } = require("@foxglove/rosbag2-web");

// Left to itself, it would fetch this as a browser does.
const wasmBinary = await readFile(join(modules, "@foxglove", "sql.js", "dist", "sql-wasm.wasm"));
await SqliteSqljs.Initialize({ wasmBinary });
const database = new SqliteSqljs(new Uint8Array(await readFile(path)));
await database.open();

const topics = await database.readTopics();
const messages = [];
for (const name of new Set(topics.map((topic) => topic.name))) {
  for await (const { topic, timestamp, data } of database.readMessages({ topics: [name] })) {
    const time = BigInt(timestamp.sec) * 1_000_000_000n + BigInt(timestamp.nsec);
    messages.push([topic.name, time.toString(), createHash("sha256").update(data).digest("hex")]);
  }
}
const counts = Object.fromEntries(await database.messageCounts());
console.log(JSON.stringify({ topics, counts, messages }));
await database.close();

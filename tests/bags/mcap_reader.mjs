// Prints an MCAP file as JSON, as the npm packages @mcap/core and @mcap/support read it: once through the
// index and once from end to end, CRCs checked both times.
//
//     node mcap_reader.mjs NODE_MODULES FILE
import { createHash } from "node:crypto";
import { open, readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { join } from "node:path";

const [modules, path] = process.argv.slice(2);
const require = createRequire(join(modules, "anything.js"));
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");

const decompressHandlers = await loadDecompressHandlers();
const sha = (data) => createHash("sha256").update(data).digest("hex");
const plain = (key, value) => (typeof value === "bigint" ? value.toString() : value);

const message = (record) => [
  record.channelId,
  record.sequence,
  record.logTime.toString(),
  record.publishTime.toString(),
  sha(record.data),
];
const channel = (record) => [
  record.id,
  record.schemaId,
  record.topic,
  record.messageEncoding,
  Object.fromEntries(record.metadata),
];
const schema = (record) => [record.id, record.name, record.encoding, sha(record.data)];
const attachment = (record) => [
  record.name,
  record.mediaType,
  record.logTime.toString(),
  record.createTime.toString(),
  sha(record.data),
];
const metadata = (record) => [record.name, Object.fromEntries(record.metadata)];

async function all(generator, show) {
  const found = [];
  for await (const record of generator) {
    found.push(show(record));
  }
  return found;
}

async function indexed() {
  const handle = await open(path);
  const readable = {
    size: async () => BigInt((await handle.stat()).size),
    read: async (offset, length) => {
      const buffer = new Uint8Array(Number(length));
      await handle.read(buffer, 0, Number(length), Number(offset));
      return buffer;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const result = {
    profile: reader.header.profile,
    library: reader.header.library,
    statistics: reader.statistics && [
      reader.statistics.messageCount,
      reader.statistics.chunkCount,
      reader.statistics.attachmentCount,
      reader.statistics.metadataCount,
      reader.statistics.messageStartTime,
      reader.statistics.messageEndTime,
    ],
    summaryOffsets: reader.summaryOffsetsByOpcode.size,
    channels: [...reader.channelsById.values()].map(channel),
    schemas: [...reader.schemasById.values()].map(schema),
    messages: await all(reader.readMessages({ validateCrcs: true }), message),
    attachments: await all(reader.readAttachments({ validateCrcs: true }), attachment),
    metadata: await all(reader.readMetadata(), metadata),
  };
  await handle.close();
  return result;
}

async function streamed() {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  reader.append(await readFile(path));
  const messages = [];
  for (let record = reader.nextRecord(); record; record = reader.nextRecord()) {
    if (record.type === "Message") {
      messages.push(message(record));
    }
  }
  return { done: reader.done(), messages };
}

console.log(JSON.stringify({ indexed: await indexed(), streamed: await streamed() }, plain));

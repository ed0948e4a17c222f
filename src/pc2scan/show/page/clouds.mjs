// The page of clouds. When a parameter changes, it projects the cloud again and updates the views.

import { commandLine, parameterFile } from "./commands.mjs";
import { Controls } from "./controls.mjs";
import { columns } from "./data.mjs";
import { band, beamsFromAbove, endsOf, frameMarks, mark, rings, sector, squares } from "./draw.mjs";
import { Flat } from "./flat.mjs";
import { layoutOf } from "./layout.mjs";
import { Orbit } from "./orbit.mjs";
import { beamAt, copyButton, element, figure, make, oncePerFrame, onTheme, setUpTime, styled } from "./page.mjs";
import { outcomeColours, paintValues, usualRange, word } from "./palette.mjs";
import { emptyRange, problemOf } from "./params.mjs";
import { OUTCOMES, Projector, transformed } from "./project.mjs";
import { matrixOf, matrixOfMount } from "./transform.mjs";
import { Unrolled } from "./unrolled.mjs";

/** @typedef {import("./params.mjs").Params} Params */
/** @typedef {import("./transform.mjs").Mount} Mount */
/** @typedef {import("./project.mjs").Cloud} Cloud */
/** @typedef {Record<string, number | string | boolean>} Values */

/**
 * @typedef {object} CloudEntry
 * @property {string} moment for people
 * @property {string} frame
 * @property {string} targetFrame the scan's frame
 * @property {{quaternion: number[], translation: number[]} | null} transform
 * @property {Mount} mount the same as x, y, z, roll, pitch and yaw
 * @property {{name: string, x: number, y: number, z: number}[]} frames
 * @property {number} total points in the recording
 * @property {import("./data.mjs").ArrayData} data
 * @property {import("./data.mjs").ArrayData | null} filtered
 */

/**
 * @typedef {object} TopicEntry
 * @property {string} topic
 * @property {CloudEntry[]} clouds
 */

/**
 * @typedef {object} CloudRecording
 * @property {Values} params
 * @property {Values} defaults
 * @property {Values} base the parameters of the preset
 * @property {Record<string, Record<string, number | string>>} presets
 * @property {string} preset
 * @property {Record<string, {help: string, choices: string[]}>} parameters
 * @property {string[]} command
 * @property {string} targetFrame the requested target frame
 * @property {TopicEntry[]} topics
 */

const OUTCOME_NAMES = {
  used: "used",
  nan: "NaN",
  height: "outside the heights",
  range: "outside the ranges",
  angle: "outside the sector",
  past_end: "after the last beam",
  filtered: "rejected by filters",
};

/** How many times as large heights are shown from the side, at most. */
const MOST_STRETCH = 20;

/** @param {CloudRecording} recording */
export function showClouds(recording) {
  const shown = { x: 0, y: 0, z: 0, scale: 20, stretch: 1 };
  const defaults = revived(recording.defaults);
  let topic = recording.topics[0];
  let params = /** @type {Params} */ (revived(recording.params));
  let base = revived(recording.base);
  let preset = recording.preset;
  let entry = topic.clouds[0];
  /** @type {Mount | null} the user's mount; null: the recorded one */
  let mount = null;
  /** @type {Map<string, import("./data.mjs").Column>} */
  let fields = new Map();
  /** @type {ArrayLike<number> | null} */
  let filtered = null;
  /** @type {Cloud} in the scan's frame */
  let cloud = { x: new Float32Array(), y: new Float32Array(), z: new Float32Array() };
  let projector = new Projector(cloud);
  let scan = projector.scan(params);
  let ends = new Float64Array();
  let colours = new Uint32Array();
  let markedBeam = -1;
  let fitted = false;

  const colourBy = element("colour", HTMLSelectElement);
  const topics = element("topic", HTMLSelectElement);
  const readout = element("readout", HTMLElement);
  const draw = oncePerFrame(drawAll);
  const top = new Flat(element("top", HTMLElement), "y", shown, draw, fit);
  const side = new Flat(element("side", HTMLElement), "z", shown, draw, fit, grabBand);
  const orbit = new Orbit(element("orbit", HTMLElement), draw, fit);
  const unrolled = new Unrolled(element("unrolled", HTMLElement), draw);

  const names = recording.topics.flatMap((t) => t.clouds.flatMap((c) => c.data.fields.map((f) => f.name)));
  const fieldNames = [...new Set(names)].filter((name) => !["x", "y", "z"].includes(name));
  const controls = new Controls(
    element("controls", HTMLElement),
    { parameters: recording.parameters, presets: Object.keys(recording.presets), fields: fieldNames },
    { param: setParam, mount: setMount, preset: setPreset, reset },
  );
  const results = resultsIn(element("results", HTMLElement), choice);

  colourBy.append(...["outcome", "height", ...fieldNames].map((name) => new Option(name, name)));
  colourBy.addEventListener("change", paint);
  topics.append(...recording.topics.map(({ topic: name }) => new Option(name, name)));
  topics.addEventListener("change", () => {
    topic = recording.topics[topics.selectedIndex];
    fitted = false;
    void go(0);
  });
  element("topic-label", HTMLElement).hidden = recording.topics.length < 2;
  for (const view of [top, side, orbit]) {
    view.stage.element.addEventListener("pointermove", (event) => {
      const [x, y] = view.stage.place(event);
      const { ratio, raster } = view.stage;
      const point = raster.at(x * ratio, y * ratio, 6 * ratio);
      const [ahead, left] = top.world([x, y]);
      const pointed = view === top ? beamAt(Math.atan2(left, ahead), ...beamEdges()) : -1;
      describe(point, point >= 0 && scan.bins[point] >= 0 ? scan.bins[point] : pointed);
    });
  }
  unrolled.stage.element.addEventListener("pointermove", (event) => {
    describe(-1, beamAt(unrolled.angle(unrolled.stage.place(event)[0]), ...beamEdges()));
  });

  const go = setUpTime(
    () => topic.clouds.length,
    load,
    (step) => topic.clouds[step].moment,
  );
  onTheme(paint);

  /** @param {number} step */
  async function load(step) {
    const wanted = topic.clouds[step];
    entry = wanted;
    const found = await columns(wanted.data);
    const rejected = wanted.filtered && (await columns(wanted.filtered)).get("filtered");
    // Another cloud may have been chosen while this one was decompressed.
    if (entry !== wanted) return;
    fields = found;
    filtered = rejected ?? null;
    place();
  }

  /** Transform the cloud into the scan's frame, and project it. */
  function place() {
    const own = /** @type {Cloud} */ (Object.fromEntries(["x", "y", "z"].map((axis) => [axis, fields.get(axis)])));
    const matrix = mount
      ? matrixOfMount(mount)
      : entry.transform && matrixOf(entry.transform.quaternion, entry.transform.translation);
    cloud = matrix ? transformed(own, matrix) : own;
    projector = new Projector(cloud, filtered);
    const frame = choice().targetFrame || entry.targetFrame;
    element("frame", HTMLElement).textContent = frame && `in frame ${frame}`;
    if (!fitted) fit();
    update();
  }

  /** Project with the present parameters, and show everything. */
  function update() {
    const problem = problemOf(params);
    controls.show(params, mount ?? entry.mount, preset, problem);
    if (!problem) {
      scan = projector.scan(params);
      ends = endsOf(scan.layout, scan.ranges, isReturn);
    }
    paint();
  }

  /** @param {number} range */
  function isReturn(range) {
    return Number.isFinite(range) && !Object.is(range, emptyRange(params));
  }

  /** Choose the colour of each point, and show the counts. */
  function paint() {
    const by = colourBy.value;
    if (by === "outcome") {
      const words = outcomeColours().map(word);
      colours = new Uint32Array(scan.outcomes).map((outcome) => words[outcome]);
    } else colours = paintValues(by === "height" ? cloud.z : (fields.get(by) ?? cloud.z));
    results(scan, entry);
    draw();
  }

  function drawAll() {
    if (!fields.size) return;
    const ranks = colourBy.value === "outcome" ? scan.outcomes : null;
    const beam = styled("--beam");
    const size = cloud.x.length > 60_000 ? 1 : 1.5;
    top.points(cloud, size, colours, ranks);
    side.points(cloud, size, colours, ranks);
    orbit.points(cloud, size, colours);
    const axis = 40 / shown.scale;
    let pen = top.axes();
    rings(pen, top);
    sector(pen, top, params);
    beamsFromAbove(pen, top, ends, beam, [0, 0], true);
    frameMarks(pen, (x, y) => [top.px(x), top.py(y)], entry.frames, axis);
    if (markedBeam >= 0) mark(pen, top.px(ends[2 * markedBeam]), top.py(ends[2 * markedBeam + 1]));
    pen.restore();
    pen = side.axes();
    band(pen, side, bandEdges());
    frameMarks(pen, (x, _y, z) => [side.px(x), side.py(z)], entry.frames, axis);
    pen.restore();
    pen = orbit.stage.pen();
    squares(pen, ends, (x, y) => orbit.place(x, y, 0), beam, 2);
    frameMarks(pen, (x, y, z) => orbit.place(x, y, z), entry.frames, 40 / orbit.scale);
    const { angleMin, increment } = scan.layout;
    unrolled.draw([{ angleMin, increment, ranges: scan.ranges, colour: beam, size: 2, isReturn }], markedBeam);
    const share = (100 * scan.counts[0]) / Math.max(1, cloud.x.length);
    top.stage.element.ariaLabel = `The cloud from above: ${cloud.x.length} points, ${share.toFixed(1)} % used`;
    document.body.dataset.drawn = "";
  }

  /** The edges of the band, upper and lower, kept within the view. */
  function bandEdges() {
    const keep = (/** @type {number} */ y) => Math.min(side.stage.height - 24, Math.max(4, y));
    return /** @type {[number, number]} */ ([keep(side.py(params.max_height)), keep(side.py(params.min_height))]);
  }

  /**
   * @param {[number, number]} start
   * @param {number} reach pixels
   */
  function grabBand([, y], reach) {
    const [toUpper, toLower] = bandEdges().map((edge) => Math.abs(y - edge));
    if (Math.min(toUpper, toLower) > reach) return null;
    return (/** @type {[number, number]} */ at) => {
      const height = Math.round(side.world(at)[1] * 100) / 100;
      if (toUpper < toLower) setParam("max_height", Math.max(height, params.min_height));
      else setParam("min_height", Math.min(height, params.max_height));
    };
  }

  /** Show the whole cloud except for a few points far away. */
  function fit() {
    fitted = true;
    const [x, y, z] = [cloud.x, cloud.y, cloud.z].map(usualRange);
    const [sides, withSensor] = top.fit(x, y);
    shown.z = (z[0] + z[1]) / 2;
    const rise = Math.max(1, z[1] - z[0]) * shown.scale;
    shown.stretch = Math.min(MOST_STRETCH, Math.max(1, (0.75 * side.room[1]) / rise));
    const stretched = shown.stretch > 1 ? `, heights \u00d7 ${figure(shown.stretch, 1)}` : "";
    element("stretch", HTMLElement).textContent = stretched;
    orbit.fit([sides, withSensor, z]);
    draw();
  }

  /**
   * @param {string} name
   * @param {number | string} value
   */
  function setParam(name, value) {
    params = { ...params, [name]: value };
    // The number of beams sets the increment, and the increment the number of beams, so only one of them is kept.
    if (name === "angle_increment") params.beams = 0;
    if (name === "beams" && value && !problemOf(params)) params.angle_increment = layoutOf(params).increment;
    update();
  }

  /**
   * @param {keyof Mount} key
   * @param {number} value
   */
  function setMount(key, value) {
    if (!Number.isFinite(value)) return;
    mount = { ...(mount ?? entry.mount), [key]: value };
    place();
  }

  /** @param {string} chosen */
  function setPreset(chosen) {
    preset = chosen;
    // Values that the user has set are kept.
    const own = Object.entries(params).filter(([name, value]) => base[name] !== value);
    base = { ...defaults, ...(recording.presets[chosen] ?? {}) };
    params = /** @type {Params} */ ({ ...base, ...Object.fromEntries(own) });
    update();
  }

  function reset() {
    params = /** @type {Params} */ (revived(recording.params));
    base = revived(recording.base);
    preset = recording.preset;
    mount = null;
    place();
  }

  /** The present choices, from which the command line and the files to copy are made. */
  function choice() {
    const parent = entry.targetFrame === entry.frame || !entry.targetFrame ? "base_link" : entry.targetFrame;
    const staticTf = mount && { parent, child: entry.frame || "lidar", mount };
    const targetFrame = mount ? parent : recording.targetFrame;
    return { params, base, preset, command: recording.command, staticTf, targetFrame };
  }

  /** @returns {[number, number, number]} the first edge, radians, the width and the number of the beams */
  function beamEdges() {
    const { angleMin, increment, count } = scan.layout;
    return [angleMin - (params.geometry === "upstream" ? 0 : increment / 2), increment, count];
  }

  /**
   * @param {number} point
   * @param {number} beam
   */
  function describe(point, beam) {
    const words = [];
    if (point >= 0) {
      const values = [...fields].map(([name, column]) => `${name} ${figure(column[point])}`);
      words.push(`Point ${point}: ${values.join(", ")}`);
      const place = [cloud.x, cloud.y, cloud.z].map((axis) => figure(axis[point]));
      if (mount || entry.transform) words.push(`in ${entry.targetFrame || "the scan's frame"} ${place.join(", ")}`);
      words.push(OUTCOME_NAMES[OUTCOMES[scan.outcomes[point]]]);
    }
    if (beam >= 0) {
      const angle = scan.layout.angleMin + beam * scan.layout.increment;
      const reads = isReturn(scan.ranges[beam]) ? `${figure(scan.ranges[beam])} m` : "no return";
      words.push(`Beam ${beam}: ${((angle * 180) / Math.PI).toFixed(2)}\u00b0, ${reads}`);
    }
    readout.textContent = words.join("; ");
    markedBeam = beam;
    draw();
  }

  Object.assign(window, {
    pc2scan: {
      scan: () => ({ ranges: [...scan.ranges].map(String), counts: scan.counts }),
      go,
      command: () => commandLine(choice()),
      file: (/** @type {1 | 2} */ ros) => parameterFile(choice(), ros),
    },
  });
  return go(0);
}

/**
 * Convert infinite numbers, which JSON only has as text, back to numbers.
 * @param {Values} values
 * @returns {Values}
 */
function revived(values) {
  const isInfinite = (/** @type {string} */ name) => name !== "no_return" && /^-?inf$/.test(String(values[name]));
  const read = (/** @type {string} */ name) => (String(values[name]).startsWith("-") ? -Infinity : Infinity);
  return Object.fromEntries(Object.keys(values).map((name) => [name, isInfinite(name) ? read(name) : values[name]]));
}

/**
 * The counts, and what can be copied; returns what shows those of a scan.
 * @param {HTMLElement} panel
 * @param {() => import("./commands.mjs").Choice} choice
 */
function resultsIn(panel, choice) {
  const table = make("table");
  const summary = make("p");
  const command = make("pre", { id: "command", tabIndex: 0 });
  const buttons = make("div", { className: "buttons" });
  buttons.append(
    copyButton("Copy command", () => commandLine(choice())),
    copyButton("ROS 1 parameters", () => parameterFile(choice(), 1)),
    copyButton("ROS 2 parameters", () => parameterFile(choice(), 2)),
  );
  const take = make("h2", { textContent: "Copy these parameters" });
  panel.append(make("h2", { textContent: "Points" }), table, summary, take, buttons, command);
  const rows = OUTCOMES.map((outcome) => {
    const row = table.insertRow();
    const swatch = make("span", { className: "swatch" });
    row.insertCell().append(swatch, OUTCOME_NAMES[outcome]);
    const [count, share] = ["count", "share"].map((className) => Object.assign(row.insertCell(), { className }));
    return { row, swatch, count, share };
  });
  const { format } = new Intl.NumberFormat("en");
  return (/** @type {import("./project.mjs").Scan} */ scan, /** @type {CloudEntry} */ entry) => {
    const total = Math.max(1, scan.outcomes.length);
    rows.forEach(({ row, swatch, count, share }, n) => {
      swatch.style.background = outcomeColours()[n];
      row.hidden = OUTCOMES[n] === "filtered" && !entry.filtered;
      count.textContent = format(scan.counts[n]);
      share.textContent = `${((100 * scan.counts[n]) / total).toFixed(1)} %`;
    });
    const thinned = entry.total > scan.outcomes.length ? `; of ${format(entry.total)} points, thinned` : "";
    summary.textContent = `${scan.ranges.length} beams, ${scan.returns} with a return${thinned}`;
    command.textContent = commandLine(choice());
  };
}

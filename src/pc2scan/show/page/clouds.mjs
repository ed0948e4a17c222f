// The page of clouds. When a parameter changes, it projects the cloud again and updates the views.

import { commandLine, commandWords, parameterFile, staticText } from "./commands.mjs";
import { Controls } from "./controls.mjs";
import { columns } from "./data.mjs";
import { band, beamsFromAbove, endsOf, frameMarks, rings, sector, squares } from "./draw.mjs";
import { Flat, GRAB } from "./flat.mjs";
import { Orbit } from "./orbit.mjs";
import {
  copyButton,
  element,
  figure,
  nameFrame,
  oncePerFrame,
  put,
  setUpTheme,
  setUpTime,
  theme,
  make,
  styled,
} from "./page.mjs";
import { outcomeColours, paintValues, usualRange, word } from "./palette.mjs";
import { emptyRange, problemOf } from "./params.mjs";
import { OUTCOMES, Projector, transformed } from "./project.mjs";
import { layoutOf } from "./layout.mjs";
import { niceStep } from "./stage.mjs";
import { matrixOf, matrixOfMount } from "./transform.mjs";
import { Unrolled } from "./unrolled.mjs";

/** @typedef {import("./params.mjs").Params} Params */
/** @typedef {import("./transform.mjs").Mount} Mount */
/** @typedef {import("./project.mjs").Cloud} Cloud */
/** @typedef {import("./project.mjs").Scan} Scan */
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
 * @property {Partial<Params>} heights that suit its clouds, `min_height` and `max_height`; empty: those of `params`
 * @property {CloudEntry[]} clouds
 */

/**
 * @typedef {object} CloudRecording
 * @property {string} title
 * @property {string} subtitle
 * @property {string[]} notes
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
  let params = given();
  let base = revived(recording.base);
  let preset = recording.preset;
  let entry = topic.clouds[0];
  /** @type {Mount | null} the user's mount; null: the recorded one */
  let mount = null;
  /** @type {Map<string, import("./data.mjs").Column>} */
  let fields = new Map();
  /** @type {ArrayLike<number> | null} */
  let filtered = null;
  const projector = new Projector();
  /** @type {Cloud} in the scan's frame */
  let cloud = emptyCloud(0);
  /** @type {Cloud} where points are transformed to */
  let moved = emptyCloud(0);
  /** @type {Scan} */
  let scan = projector.scan(params);
  let ends = new Float64Array();
  let colours = new Uint32Array();
  let markedBeam = -1;
  let fitted = false;

  const colourBy = element("colour", HTMLSelectElement);
  const readout = element("readout", HTMLElement);
  const draw = oncePerFrame(drawAll);

  const top = new Flat(element("top", HTMLElement), "y", shown, { change: draw, draw, fit });
  const side = new Flat(element("side", HTMLElement), "z", shown, { change: draw, draw, fit, grab: grabBand });
  const orbit = new Orbit(element("orbit", HTMLElement), { draw, fit });
  const unrolled = new Unrolled(element("unrolled", HTMLElement), draw);

  const fieldNames = [
    ...new Set(recording.topics.flatMap((t) => t.clouds.flatMap((c) => c.data.fields.map((f) => f.name)))),
  ];
  const controls = new Controls(
    element("controls", HTMLElement),
    {
      parameters: recording.parameters,
      presets: Object.keys(recording.presets),
      fields: fieldNames.filter((name) => !["x", "y", "z"].includes(name)),
    },
    { param: setParam, mount: setMount, preset: setPreset, reset },
  );
  const results = resultsIn(element("results", HTMLElement), choice);

  colourBy.replaceChildren(
    ...["outcome", "height", ...fieldNames.filter((name) => !["x", "y", "z"].includes(name))].map(
      (name) => new Option(name, name),
    ),
  );
  colourBy.addEventListener("change", () => {
    paint();
    draw();
  });
  const topics = element("topic", HTMLSelectElement);
  topics.replaceChildren(...recording.topics.map(({ topic: name }) => new Option(name, name)));
  topics.addEventListener("change", () => {
    const before = given();
    topic = recording.topics[topics.selectedIndex];
    // Heights that the user has set are kept.
    const { min_height, max_height } = given();
    if (params.min_height === before.min_height && params.max_height === before.max_height)
      params = { ...params, min_height, max_height };
    fitted = false;
    void go(0);
  });
  element("topic-label", HTMLElement).hidden = recording.topics.length < 2;
  hover();

  const go = setUpTime(
    () => topic.clouds.length,
    load,
    (step) => `${step + 1} of ${topic.clouds.length}: ${topic.clouds[step].moment}`,
  );
  setUpTheme(() => {
    results.colour();
    paint();
    draw();
  });

  /** The parameters that the page opens a topic with. */
  function given() {
    return /** @type {Params} */ ({ ...revived(recording.params), ...topic.heights });
  }

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
    if (moved.x.length !== own.x.length) moved = emptyCloud(own.x.length);
    // Another object, by which the views know that points have moved.
    cloud = { ...(matrix ? transformed(own, matrix, moved) : own) };
    projector.place(cloud, filtered);
    nameFrame(choice().targetFrame || entry.targetFrame);
    if (!fitted) fit();
    update();
  }

  /** Project with the present parameters, and show everything. */
  function update() {
    const problem = problemOf(params);
    controls.blame(problem);
    controls.show(params, mount ?? entry.mount, preset);
    if (!problem) {
      scan = projector.scan(params, (params.intensity_field && fields.get(params.intensity_field)) || null);
      ends = endsOf(scan, isReturn);
    }
    results.show(scan, entry);
    paint();
    draw();
  }

  /** @param {number} range */
  function isReturn(range) {
    return Number.isFinite(range) && !Object.is(range, emptyRange(params));
  }

  /** Choose the colour of each point. */
  function paint() {
    const by = colourBy.value;
    const { outcomes } = scan;
    const count = cloud.x.length;
    if (colours.length !== count) colours = new Uint32Array(count);
    if (by === "outcome") {
      const words = Uint32Array.from(outcomeColours(theme()), word);
      for (let n = 0; n < count; n++) colours[n] = words[outcomes[n]];
    } else {
      paintValues(by === "height" ? cloud.z : (fields.get(by) ?? cloud.z), theme(), colours);
    }
  }

  function drawAll() {
    if (!cloud.x.length && !fields.size) return;
    const ranks = colourBy.value === "outcome" ? scan.outcomes : null;
    const beam = styled("--beam");
    const size = cloud.x.length > 60_000 ? 1 : 1.5;
    top.points(cloud, size, colours, ranks);
    side.points(cloud, size, colours, ranks);
    orbit.points(cloud, size, colours);
    const axis = 40 / shown.scale;
    let pen = top.axes();
    rings(pen, top, niceStep(top.stage.width / shown.scale, 8));
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
    unrolled.draw(
      [
        {
          angleMin: scan.layout.angleMin,
          increment: scan.layout.increment,
          ranges: scan.ranges,
          colour: beam,
          size: 2,
          isReturn,
        },
      ],
      markedBeam,
    );
    const share = scan.counts[0] / Math.max(1, cloud.x.length);
    const text = `${cloud.x.length} points, ${(100 * share).toFixed(1)} % used`;
    top.stage.element.setAttribute("aria-label", `The cloud from above: ${text}; the beams of the scan over it`);
    side.stage.element.setAttribute("aria-label", `The cloud from the side: ${text}; the height band`);
    orbit.stage.element.setAttribute("aria-label", `The cloud in 3D: ${text}`);
    unrolled.stage.element.setAttribute("aria-label", `Ranges of ${scan.ranges.length} beams by angle`);
    document.body.dataset.drawn = `${Number(document.body.dataset.drawn ?? 0) + 1}`;
  }

  /**
   * @param {CanvasRenderingContext2D} pen
   * @param {number} x
   * @param {number} y
   */
  function mark(pen, x, y) {
    pen.strokeStyle = styled("--ink");
    pen.beginPath();
    pen.arc(x, y, 6, 0, 2 * Math.PI);
    pen.stroke();
  }

  /** The edges of the band, upper and lower, kept within the view. */
  function bandEdges() {
    const { height } = side.stage;
    const keep = (/** @type {number} */ y) => Math.min(height - 24, Math.max(4, y));
    return /** @type {[number, number]} */ ([keep(side.py(params.max_height)), keep(side.py(params.min_height))]);
  }

  /**
   * @param {[number, number]} start
   * @param {number} reach pixels
   */
  function grabBand([, y], reach) {
    const [upper, lower] = bandEdges();
    const [toUpper, toLower] = [Math.abs(y - upper), Math.abs(y - lower)];
    if (Math.min(toUpper, toLower) > reach) return null;
    const name = toUpper < toLower ? "max_height" : "min_height";
    return (/** @type {[number, number]} */ at) => {
      const height = Math.round(side.world(at)[1] * 100) / 100;
      const [low, high] = [params.min_height, params.max_height];
      setParam(name, name === "max_height" ? Math.max(height, low) : Math.min(height, high));
    };
  }

  /** Show the whole cloud except for a few points far away. */
  function fit() {
    fitted = true;
    const [x, y, z] = [cloud.x, cloud.y, cloud.z].map(usualRange);
    top.fit(x, y);
    shown.z = (z[0] + z[1]) / 2;
    const rise = Math.max(1, z[1] - z[0]) * shown.scale;
    shown.stretch = Math.min(MOST_STRETCH, Math.max(1, (0.75 * side.room[1]) / rise));
    element("stretch", HTMLElement).textContent =
      shown.stretch > 1 ? `, heights \u00d7 ${figure(shown.stretch, 1)}` : "";
    const withSensor = [x, y].map(([low, high]) => [Math.min(low, 0), Math.max(high, 0)]);
    orbit.fit(/** @type {[number, number][]} */ ([...withSensor, z]));
    draw();
  }

  /**
   * @param {string} name
   * @param {number | string} value
   */
  function setParam(name, value) {
    /** @type {Record<string, number | string>} */
    const changes = { [name]: value };
    // The number of beams sets the increment, and the increment the number of beams, so only one of them is kept.
    if (name === "angle_increment") changes.beams = 0;
    params = { ...params, ...changes };
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
    params = given();
    base = revived(recording.base);
    preset = recording.preset;
    mount = null;
    place();
  }

  /** The present choices, from which the command line and the files to copy are made. */
  function choice() {
    const parent = entry.targetFrame === entry.frame || !entry.targetFrame ? "base_link" : entry.targetFrame;
    return {
      params,
      base,
      preset,
      command: recording.command,
      staticTf: mount && { parent, child: entry.frame || "lidar", mount },
      targetFrame: mount ? parent : recording.targetFrame,
    };
  }

  function hover() {
    for (const view of [top, side, orbit]) {
      view.stage.element.addEventListener("pointermove", (event) => {
        const [x, y] = view.stage.place(event);
        const { ratio, raster } = view.stage;
        const point = raster?.at(x * ratio, y * ratio, 6 * ratio) ?? -1;
        if (view === side) {
          const near = bandEdges().some((edge) => Math.abs(edge - y) <= GRAB);
          side.stage.element.style.cursor = near ? "ns-resize" : "";
        }
        const [ahead, left] = top.world([x, y]);
        const angle = view === top ? Math.atan2(left, ahead) : NaN;
        describe(point, point >= 0 && scan.outcomes[point] === 0 ? scan.bins[point] : beamAt(angle));
      });
    }
    unrolled.stage.element.addEventListener("pointermove", (event) => {
      describe(-1, beamAt(unrolled.angle(unrolled.stage.place(event)[0])));
    });
  }

  /**
   * @param {number} angle radians
   */
  function beamAt(angle) {
    const { angleMin, increment, count } = scan.layout;
    const turned = angle - angleMin + (params.geometry === "upstream" ? 0 : increment / 2);
    const turn = 2 * Math.PI;
    const beam = Math.floor((((turned % turn) + turn) % turn) / increment);
    return beam >= 0 && beam < count ? beam : -1;
  }

  /**
   * @param {number} point
   * @param {number} beam
   */
  function describe(point, beam) {
    const words = [];
    if (point >= 0) {
      const values = [...fields].map(([name, column]) => `${name} ${figure(column[point])}`);
      const [x, y, z] = [cloud.x[point], cloud.y[point], cloud.z[point]];
      words.push(`Point ${point}: ${values.join(", ")}`);
      if (mount || entry.transform)
        words.push(`in ${entry.targetFrame || "the scan's frame"} ${figure(x)}, ${figure(y)}, ${figure(z)}`);
      words.push(OUTCOME_NAMES[OUTCOMES[scan.outcomes[point]]]);
    }
    if (beam >= 0) {
      const angle = scan.layout.angleMin + beam * scan.layout.increment;
      const range = scan.ranges[beam];
      words.push(
        `Beam ${beam}: ${((angle * 180) / Math.PI).toFixed(2)}\u00b0, ${isReturn(range) ? `${figure(range)} m` : "no return"}`,
      );
    }
    readout.textContent = words.join("; ");
    if (beam !== markedBeam) {
      markedBeam = beam;
      draw();
    }
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
  return Object.fromEntries(
    Object.entries(values).map(([name, value]) => {
      const infinite = (value === "inf" || value === "-inf") && name !== "no_return";
      return [name, infinite ? (value === "inf" ? Infinity : -Infinity) : value];
    }),
  );
}

/**
 * @param {number} points
 * @returns {Cloud}
 */
function emptyCloud(points) {
  return { x: new Float32Array(points), y: new Float32Array(points), z: new Float32Array(points) };
}

/**
 * The counts, and what can be copied.
 * @param {HTMLElement} panel
 * @param {() => import("./commands.mjs").Choice} choice
 */
function resultsIn(panel, choice) {
  const table = make("table");
  const summary = make("p");
  const command = make("pre", { id: "command", tabIndex: 0 });
  const staticButton = copyButton("--static-tf", () => staticText(choice()));
  const buttons = make(
    "div",
    { className: "buttons" },
    copyButton("Copy command", () => commandLine(choice())),
    copyButton("ROS 1 parameters", () => parameterFile(choice(), 1)),
    copyButton("ROS 2 parameters", () => parameterFile(choice(), 2)),
    staticButton,
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
  return {
    /** Colour the names like the points. */
    colour() {
      rows.forEach(({ swatch }, n) => (swatch.style.background = outcomeColours(theme())[n]));
    },
    /**
     * @param {Scan} scan
     * @param {CloudEntry} entry
     */
    show(scan, entry) {
      const total = Math.max(1, scan.outcomes.length);
      rows.forEach(({ row, count, share }, n) => {
        put(row, "hidden", OUTCOMES[n] === "filtered" && !entry.filtered);
        put(count, "textContent", grouped(scan.counts[n]));
        put(share, "textContent", `${((100 * scan.counts[n]) / total).toFixed(1)} %`);
      });
      const thinned = entry.total > scan.outcomes.length ? `; of ${grouped(entry.total)} points, thinned` : "";
      summary.textContent = `${scan.ranges.length} beams, ${scan.returns} with a return${thinned}`;
      const words = commandWords(choice());
      if (command.children.length === words.length)
        words.forEach((word, n) => put(command.children[n], "textContent", word));
      else {
        const unbroken = words.map((word) => make("span", { className: "word", textContent: word }));
        command.replaceChildren(...unbroken.flatMap((word) => [" ", word]).slice(1));
      }
      staticButton.hidden = !choice().staticTf;
    },
  };
}

const { format: grouped } = new Intl.NumberFormat("en");

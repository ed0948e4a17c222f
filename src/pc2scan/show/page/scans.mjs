// The page of scans: overlays those of several topics.

import { columns } from "./data.mjs";
import { beamsFromAbove, endsOf, frameMarks, rings } from "./draw.mjs";
import { Flat } from "./flat.mjs";
import { element, figure, make, nameFrame, oncePerFrame, setUpTheme, setUpTime, theme } from "./page.mjs";
import { layerColour, usualRange } from "./palette.mjs";
import { niceStep } from "./stage.mjs";
import { Unrolled } from "./unrolled.mjs";

/**
 * @typedef {object} Layer
 * @property {string} name
 * @property {number} colour
 * @property {number} angleMin radians
 * @property {number} increment radians
 * @property {[number, number, number, number, number, number]} pose the matrix from x, y and 1 to the view, row by row
 * @property {number} rangeMin metres
 * @property {number} rangeMax metres
 * @property {import("./data.mjs").ArrayData} data
 */

/**
 * @typedef {object} ScanRecording
 * @property {{moment: string, frame: string, layers: Layer[]}[]} moments
 * @property {{heading: string, lines: {text: string, wrong: boolean}[]}[]} findings
 */

/** @typedef {Layer & {ranges: Float32Array, intensities: Float32Array | undefined, ends: Float64Array}} Loaded */

/** @param {ScanRecording} recording */
export function showScans(recording) {
  const shown = { x: 0, y: 0, z: 0, scale: 20, stretch: 1 };
  /** @type {Loaded[]} */
  let layers = [];
  let step = -1;
  let fitted = false;
  let pointed = -1;
  for (const id of ["side-figure", "orbit-figure", "colour-label", "topic-label"])
    element(id, HTMLElement).hidden = true;
  const draw = oncePerFrame(drawAll);
  const top = new Flat(element("top", HTMLElement), "y", shown, { change: draw, draw, fit });
  const unrolled = new Unrolled(element("unrolled", HTMLElement), draw);
  const readout = element("readout", HTMLElement);
  const legend = make("table");
  describeFindings(element("results", HTMLElement), recording, legend);
  const go = setUpTime(
    () => recording.moments.length,
    load,
    (n) => `${n + 1} of ${recording.moments.length}: ${recording.moments[n].moment}`,
  );
  setUpTheme(draw);
  top.stage.element.addEventListener("pointermove", (event) => {
    const place = top.world(top.stage.place(event));
    point((layer) => seenFrom(layer, place));
  });
  unrolled.stage.element.addEventListener("pointermove", (event) => {
    const angle = unrolled.angle(unrolled.stage.place(event)[0]);
    point(() => [angle, NaN]);
  });

  /** @param {number} wanted */
  async function load(wanted) {
    step = wanted;
    const loaded = await Promise.all(recording.moments[wanted].layers.map(loadLayer));
    if (step !== wanted) return;
    layers = loaded;
    nameFrame(recording.moments[wanted].frame);
    if (!fitted) fit();
    describeLayers();
    draw();
  }

  function drawAll() {
    if (!layers.length) return;
    const pen = top.axes();
    rings(pen, top, niceStep(top.stage.width / shown.scale, 8));
    layers.forEach((layer, n) =>
      beamsFromAbove(
        pen,
        top,
        layer.ends,
        layerColour(theme(), layer.colour),
        [layer.pose[2], layer.pose[5]],
        layers.length === 1,
        1 + sizeOf(n),
      ),
    );
    frameMarks(pen, (x, y) => [top.px(x), top.py(y)], [], 40 / shown.scale);
    pen.restore();
    unrolled.draw(
      layers.map((layer, n) => ({
        angleMin: layer.angleMin,
        increment: layer.increment,
        ranges: layer.ranges,
        colour: layerColour(theme(), layer.colour),
        size: sizeOf(n),
        isReturn: (range) => isReturn(layer, range),
      })),
      pointed,
    );
    const text = layers.map(
      (layer) => `${layer.name}, ${returnsOf(layer)} of ${layer.ranges.length} beams with a return`,
    );
    top.stage.element.setAttribute("aria-label", `Scans from above: ${text.join("; ")}`);
    unrolled.stage.element.setAttribute("aria-label", `Ranges by angle: ${text.join("; ")}`);
    document.body.dataset.drawn = `${Number(document.body.dataset.drawn ?? 0) + 1}`;
  }

  /**
   * The size of a layer's returns, pixels: each layer lies on larger returns of those below, so that all are seen.
   * @param {number} layer
   */
  function sizeOf(layer) {
    return 2 + 3 * Math.min(2, layers.length - 1 - layer);
  }

  function fit() {
    fitted = true;
    const all = layers.flatMap((layer) => [...layer.ends]);
    const [x, y] = [0, 1].map((axis) => usualRange(all.filter((_, n) => n % 2 === axis)));
    top.fit(x, y);
    draw();
  }

  function describeLayers() {
    legend.replaceChildren(
      ...layers.map((layer) => {
        const swatch = make("span", { className: "swatch" });
        swatch.style.background = layerColour(theme(), layer.colour);
        const beams = `${returnsOf(layer)} of ${layer.ranges.length} beams`;
        const count = make("td", { className: "count", textContent: beams });
        return make("tr", {}, make("td", {}, swatch, layer.name), count);
      }),
    );
  }

  /**
   * Describe the beams in the direction of a place.
   * @param {(layer: Loaded) => [number, number]} placeIn its angle, radians, and distance, metres, in a scan's frame
   */
  function point(placeIn) {
    const turn = 2 * Math.PI;
    const words = layers.map((layer) => {
      const [angle, distance] = placeIn(layer);
      const turned = (((angle - layer.angleMin + layer.increment / 2) % turn) + turn) % turn;
      const beam = Math.floor(turned / Math.abs(layer.increment));
      const place = `${((angle * 180) / Math.PI).toFixed(2)}\u00b0${Number.isFinite(distance) ? `, ${distance.toFixed(2)} m` : ""}`;
      if (!(beam < layer.ranges.length)) return `${layer.name}: ${place}: no beam`;
      if (layer === layers[0]) pointed = beam;
      const range = layer.ranges[beam];
      const intensity = layer.intensities?.length ? `, intensity ${figure(layer.intensities[beam])}` : "";
      const reads = isReturn(layer, range) ? `${figure(range)} m${intensity}` : `${range} (no return)`;
      return `${layer.name}: ${place}: beam ${beam} reads ${reads}`;
    });
    readout.textContent = words.join("; ");
    draw();
  }

  Object.assign(window, {
    pc2scan: { go, layers: () => layers.map(({ name, ranges }) => ({ name, ranges: [...ranges].map(String) })) },
  });
  return go(0);
}

/**
 * @param {Layer} layer
 * @param {number} range
 */
function isReturn(layer, range) {
  return Number.isFinite(range) && range >= layer.rangeMin && range <= layer.rangeMax;
}

/** @param {Loaded} layer */
function returnsOf(layer) {
  return layer.ranges.filter((range) => isReturn(layer, range)).length;
}

/**
 * A place in a scan's frame: angle, radians, and distance, metres.
 * @param {Layer} layer
 * @param {[number, number]} place
 * @returns {[number, number]}
 */
function seenFrom({ pose: [a, b, x, c, d, y] }, [px, py]) {
  const [dx, dy] = [px - x, py - y];
  const size = a * d - b * c;
  const [u, v] = [(d * dx - b * dy) / size, (a * dy - c * dx) / size];
  return [Math.atan2(v, u), Math.hypot(u, v)];
}

/**
 * @param {Layer} layer
 * @returns {Promise<Loaded>}
 */
async function loadLayer(layer) {
  const found = await columns(layer.data);
  const ranges = /** @type {Float32Array} */ (found.get("ranges"));
  const intensities = /** @type {Float32Array | undefined} */ (found.get("intensities"));
  const ends = endsOf({ layout: { angleMin: layer.angleMin, increment: layer.increment }, ranges }, (range) =>
    isReturn(layer, range),
  );
  const [a, b, x, c, d, y] = layer.pose;
  for (let n = 0; n < ends.length; n += 2) {
    [ends[n], ends[n + 1]] = [a * ends[n] + b * ends[n + 1] + x, c * ends[n] + d * ends[n + 1] + y];
  }
  return { ...layer, ranges, intensities, ends };
}

/**
 * @param {HTMLElement} panel
 * @param {ScanRecording} recording
 * @param {HTMLElement} legend
 */
function describeFindings(panel, recording, legend) {
  panel.append(make("h2", { textContent: "Scans" }), legend);
  for (const { heading, lines } of recording.findings) {
    const items = lines.map(({ text, wrong }) =>
      make("li", wrong ? { textContent: text, className: "wrong" } : { textContent: text }),
    );
    panel.append(make("h2", { textContent: heading }), make("ul", { className: "findings" }, ...items));
  }
}

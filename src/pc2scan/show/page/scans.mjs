// The page of scans: overlays those of several topics.

import { columns } from "./data.mjs";
import { beamsFromAbove, endsOf, frameMarks, rings } from "./draw.mjs";
import { Flat } from "./flat.mjs";
import { beamAt, element, figure, make, oncePerFrame, onTheme, setUpTime } from "./page.mjs";
import { layerColour, usualRange } from "./palette.mjs";
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

/** @typedef {Awaited<ReturnType<typeof loadLayer>>} Loaded */

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
  const top = new Flat(element("top", HTMLElement), "y", shown, draw, fit);
  const unrolled = new Unrolled(element("unrolled", HTMLElement), draw);
  const readout = element("readout", HTMLElement);
  const legend = make("table");
  const panel = element("results", HTMLElement);
  panel.append(make("h2", { textContent: "Scans" }), legend);
  for (const { heading, lines } of recording.findings) {
    const items = lines.map(({ text, wrong }) => make("li", { textContent: text, className: wrong ? "wrong" : "" }));
    panel.append(make("h2", { textContent: heading }), make("ul", { className: "findings" }, ...items));
  }
  const go = setUpTime(
    () => recording.moments.length,
    load,
    (n) => recording.moments[n].moment,
  );
  onTheme(draw);
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
    const { frame } = recording.moments[wanted];
    element("frame", HTMLElement).textContent = frame && `in frame ${frame}`;
    if (!fitted) fit();
    draw();
  }

  function drawAll() {
    if (!layers.length) return;
    const pen = top.axes();
    rings(pen, top);
    // Each layer lies on larger returns of those below, so that all are seen.
    const curves = layers.map((layer, n) => ({
      ...layer,
      colour: layerColour(layer.colour),
      size: 2 + 3 * Math.min(2, layers.length - 1 - n),
    }));
    for (const { ends, colour, pose, size } of curves)
      beamsFromAbove(pen, top, ends, colour, [pose[2], pose[5]], curves.length === 1, 1 + size);
    frameMarks(pen, (x, y) => [top.px(x), top.py(y)], [], 40 / shown.scale);
    pen.restore();
    unrolled.draw(curves, pointed);
    const rows = curves.map(({ name, colour, summary }) => {
      const swatch = make("span", { className: "swatch" });
      swatch.style.background = colour;
      return make("tr", {}, make("td", {}, swatch, name), make("td", { className: "count", textContent: summary }));
    });
    legend.replaceChildren(...rows);
    const text = curves.map(({ name, summary }) => `${name}, ${summary}`).join("; ");
    top.stage.element.ariaLabel = `Scans from above: ${text}`;
    document.body.dataset.drawn = "";
  }

  function fit() {
    fitted = true;
    const all = layers.flatMap((layer) => [...layer.ends]);
    top.fit(...[0, 1].map((axis) => usualRange(all.filter((_, n) => n % 2 === axis))));
    draw();
  }

  /**
   * Describe the beams in the direction of a place.
   * @param {(layer: Loaded) => number[]} placeIn its angle, radians, and distance, metres, in a scan's frame
   */
  function point(placeIn) {
    const words = layers.map((layer, n) => {
      const [angle, distance] = placeIn(layer);
      const { name, ranges, intensities, angleMin, increment } = layer;
      const beam = beamAt(angle, angleMin - increment / 2, increment, ranges.length);
      if (n === 0) pointed = beam;
      const away = Number.isFinite(distance) ? `, ${distance.toFixed(2)} m` : "";
      const place = `${name}: ${((angle * 180) / Math.PI).toFixed(2)}\u00b0${away}`;
      if (beam < 0) return `${place}: no beam`;
      const intensity = intensities ? `, intensity ${figure(intensities[beam])}` : "";
      const reads = layer.isReturn(ranges[beam])
        ? `${figure(ranges[beam])} m${intensity}`
        : `${ranges[beam]} (no return)`;
      return `${place}: beam ${beam} reads ${reads}`;
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
 * A place in a scan's frame: angle, radians, and distance, metres.
 * @param {Layer} layer
 * @param {number[]} place
 */
function seenFrom({ pose: [a, b, x, c, d, y] }, [px, py]) {
  const [dx, dy] = [px - x, py - y];
  const size = a * d - b * c;
  const [u, v] = [(d * dx - b * dy) / size, (a * dy - c * dx) / size];
  return [Math.atan2(v, u), Math.hypot(u, v)];
}

/** @param {Layer} layer */
async function loadLayer(layer) {
  const found = /** @type {Map<string, Float32Array>} */ (await columns(layer.data));
  const ranges = found.get("ranges") ?? new Float32Array();
  const isReturn = (/** @type {number} */ range) =>
    Number.isFinite(range) && range >= layer.rangeMin && range <= layer.rangeMax;
  const ends = endsOf(layer, ranges, isReturn);
  const [a, b, x, c, d, y] = layer.pose;
  for (let n = 0; n < ends.length; n += 2)
    ends.set([a * ends[n] + b * ends[n + 1] + x, c * ends[n] + d * ends[n + 1] + y], n);
  const summary = `${ranges.filter(isReturn).length} of ${ranges.length} beams`;
  return { ...layer, ranges, intensities: found.get("intensities"), ends, isReturn, summary };
}

// The parts that all kinds of pages share: the theme, the time slider, drawing once per frame.

/**
 * An element of the page.
 * @template {HTMLElement} T
 * @param {string} id
 * @param {new () => T} kind
 * @returns {T}
 */
export function element(id, kind) {
  const found = document.getElementById(id);
  if (!(found instanceof kind)) throw new Error(`the page has no ${id}`);
  return found;
}

/** @param {string} name of a colour of the style sheet in the present theme, such as `--ink` */
export const styled = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);

/**
 * A new element.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag
 * @param {Record<string, unknown>} properties
 * @param {...(Node | string)} children
 */
export function make(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  Object.assign(made, properties);
  made.append(...children);
  return made;
}

const dark = window.matchMedia("(prefers-color-scheme: dark)");

/** The theme of the browser. */
export const theme = () => (dark.matches ? "dark" : "light");

/** @param {() => void} changed */
export const onTheme = (changed) => dark.addEventListener("change", changed);

/**
 * Call a function once before the next frame, however often it is requested.
 * @param {() => void} draw
 */
export function oncePerFrame(draw) {
  let asked = 0;
  return () => {
    cancelAnimationFrame(asked);
    asked = requestAnimationFrame(draw);
  };
}

/**
 * The slider over moments, and playing them.
 * @param {() => number} count
 * @param {(step: number) => Promise<void>} show
 * @param {(step: number) => string} moment
 */
export function setUpTime(count, show, moment) {
  const slider = element("time", HTMLInputElement);
  const play = element("play", HTMLButtonElement);
  const label = element("moment", HTMLOutputElement);
  let playing = 0;
  const go = async (/** @type {number} */ step) => {
    slider.max = String(Math.max(0, count() - 1));
    slider.value = String(step);
    slider.disabled = play.disabled = count() < 2;
    label.textContent = slider.ariaValueText = `${step + 1} of ${count()}: ${moment(step)}`;
    await show(step);
  };
  const next = () => go((Number(slider.value) + 1) % count());
  slider.addEventListener("input", () => void go(Number(slider.value)));
  play.addEventListener("click", () => {
    if (playing) clearInterval(playing);
    playing = playing ? 0 : window.setInterval(next, 500);
    play.ariaPressed = String(playing > 0);
    play.textContent = playing ? "Pause" : "Play";
  });
  return go;
}

/**
 * The beam that an angle is in; -1 for none.
 * @param {number} angle radians
 * @param {number} edge the first edge of the first beam, radians
 * @param {number} increment radians
 * @param {number} count
 */
export function beamAt(angle, edge, increment, count) {
  const turn = 2 * Math.PI;
  const beam = Math.floor(((((angle - edge) % turn) + turn) % turn) / Math.abs(increment));
  return beam < count ? beam : -1;
}

/**
 * A button that copies a text.
 * @param {string} label
 * @param {() => string} text
 */
export function copyButton(label, text) {
  const button = make("button", { type: "button", textContent: label });
  button.addEventListener("click", async () => {
    const copied = navigator.clipboard?.writeText(text()).then(
      () => "Copied",
      () => "Select it below",
    );
    button.textContent = (await copied) ?? "Select it below";
    setTimeout(() => (button.textContent = label), 1200);
  });
  return button;
}

/**
 * A number for people.
 * @param {number} value
 * @param {number} digits
 */
export function figure(value, digits = 3) {
  if (!Number.isFinite(value) || (Number.isInteger(value) && Math.abs(value) < 1e15)) return String(value);
  return Math.abs(value) >= 1e6 || Math.abs(value) < 1e-3 ? value.toExponential(2) : value.toFixed(digits);
}

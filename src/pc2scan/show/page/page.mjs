// The parts that all kinds of pages share: the theme, the time slider, the readout, drawing once per frame.

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

/**
 * Set a property, if its value is another one: the browser lays out a text again even if it is the same.
 * @template {object} T
 * @template {keyof T} K
 * @param {T} element
 * @param {K} property
 * @param {T[K]} value
 */
export function put(element, property, value) {
  if (element[property] !== value) element[property] = value;
}

/**
 * A colour of the style sheet in the present theme, such as `--ink`.
 * @param {string} name
 */
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

/** @returns {import("./palette.mjs").Theme} */
export function theme() {
  return document.documentElement.dataset.theme === "dark" ? "dark" : "light";
}

/** @param {() => void} changed */
export function setUpTheme(changed) {
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  let chosen = "";
  const apply = () => {
    document.documentElement.dataset.theme = chosen || (system.matches ? "dark" : "light");
    changed();
  };
  system.addEventListener("change", apply);
  element("theme", HTMLButtonElement).addEventListener("click", () => {
    chosen = theme() === "dark" ? "light" : "dark";
    apply();
  });
  apply();
}

/**
 * Call a function once before the next frame, however often it is requested.
 * @param {() => void} draw
 */
export function oncePerFrame(draw) {
  let asked = false;
  return () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      draw();
    });
  };
}

/**
 * The slider over moments, and playing them.
 * @param {() => number} count
 * @param {(step: number) => Promise<void>} show
 * @param {(step: number) => string} describe
 */
export function setUpTime(count, show, describe) {
  const slider = element("time", HTMLInputElement);
  const play = element("play", HTMLButtonElement);
  const label = element("moment", HTMLOutputElement);
  let playing = 0;
  const go = async (/** @type {number} */ step) => {
    slider.max = String(Math.max(0, count() - 1));
    slider.value = String(step);
    slider.disabled = play.disabled = count() < 2;
    label.textContent = describe(step);
    slider.setAttribute("aria-valuetext", label.textContent);
    await show(step);
  };
  slider.addEventListener("input", () => void go(Number(slider.value)));
  play.addEventListener("click", () => {
    const on = !playing;
    play.setAttribute("aria-pressed", String(on));
    play.textContent = on ? "Pause" : "Play";
    clearTimeout(playing);
    playing = 0;
    const next = async () => {
      await go((Number(slider.value) + 1) % count());
      if (playing) playing = window.setTimeout(next, 400);
    };
    if (on) playing = window.setTimeout(next, 400);
  });
  return go;
}

/**
 * Name the frame of the view from above.
 * @param {string} frame empty: unknown
 */
export function nameFrame(frame) {
  put(element("frame", HTMLElement), "textContent", frame && `in frame ${frame}`);
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
  if (!Number.isFinite(value)) return String(value);
  if (Number.isInteger(value) && Math.abs(value) < 1e15) return String(value);
  return Math.abs(value) >= 1e6 || Math.abs(value) < 1e-3 ? value.toExponential(2) : value.toFixed(digits);
}

// The form: one row for each parameter, a slider beside its number.

import { make } from "./page.mjs";
import { MOUNT_KEYS } from "./transform.mjs";

/** @typedef {import("./params.mjs").Params} Params */
/** @typedef {import("./transform.mjs").Mount} Mount */
/** @typedef {{element: HTMLElement, show: (value: any) => void, mark: (wrong: boolean) => void}} Row */

const DEGREE = Math.PI / 180;
/** From here on a limit limits nothing: upstream's defaults are the largest float64. */
const NO_LIMIT = 1e300;

/**
 * A parameter that is a number: its name, its unit, the limits and the step of its slider, what an empty field means, and
 * the value of an empty field.
 * @typedef {[name: string, unit: string, min: number, max: number, step: number, none?: string, empty?: number]} Spec
 */

const { MAX_VALUE } = Number;

/** @type {Record<string, (Spec | string)[]>} parameters that are words have only a name */
const GROUPS = {
  Heights: [
    ["min_height", "m", -5, 5, 0.01, "no limit", -MAX_VALUE],
    ["max_height", "m", -5, 5, 0.01, "no limit", MAX_VALUE],
  ],
  Ranges: [
    ["range_min", "m", 0, 10, 0.01, "0", 0],
    ["range_max", "m", 0, 150, 0.1, "no limit", MAX_VALUE],
  ],
  "Sector and beams": [
    ["angle_min", "deg", -360, 360, 0.5],
    ["angle_max", "deg", -360, 360, 0.5],
    ["angle_increment", "deg", 0.05, 5, 0.05],
    ["beams", "", 0, 3600, 1, "unset", 0],
    "geometry",
  ],
  "Range of a beam": ["reduce", ["min_points", "", 1, 20, 1], "no_return", "angle_rounding", "intensity_field"],
};

/**
 * One parameter's row: a slider and a number that agree.
 * @param {Spec} spec
 * @param {string} id
 * @param {string} help
 * @param {(value: number) => void} changed
 * @returns {Row}
 */
function numberRow([name, unit, min, max, step, none = "", empty], id, help, changed) {
  const factor = unit === "deg" ? DEGREE : 1;
  const [low, high, by] = [min, max, step].map(String);
  const slider = make("input", { type: "range", tabIndex: -1, min: low, max: high, step: by, ariaHidden: "true" });
  const number = make("input", { type: "number", step: "any", id });
  slider.addEventListener("input", () => {
    number.value = slider.value;
    changed(Number(slider.value) * factor);
  });
  number.addEventListener("input", () => {
    const text = number.value.trim();
    changed(text === "" && empty !== undefined ? empty : Number.parseFloat(text) * factor);
  });
  const show = (/** @type {number} */ value) => {
    const shown = Number((value / factor).toPrecision(9));
    // Upstream's default min_height is the smallest number above 0.
    const above = value > 0 && value < 1e-300;
    number.placeholder = above ? "above 0" : none;
    const unset = above || Math.abs(value) >= NO_LIMIT || value === empty;
    if (document.activeElement !== number) number.value = unset ? "" : String(shown);
    if (!Number.isNaN(value)) slider.value = String(Math.min(1e9, Math.max(-1e9, shown)));
  };
  const after = make("span", { className: "unit", textContent: unit });
  return row(name === "angle_increment" ? "increment" : name, help, show, number, slider, number, after);
}

/**
 * A parameter that is one of some words.
 * @param {string} name
 * @param {string[]} choices
 * @param {string} help
 * @param {(value: string) => void} changed
 * @returns {Row}
 */
function choiceRow(name, choices, help, changed) {
  const select = make("select", { id: `param-${name}` });
  for (const choice of choices) select.add(new Option(choice || "none", choice));
  select.addEventListener("change", () => changed(select.value));
  const show = (/** @type {string} */ value) => {
    if (![...select.options].some((option) => option.value === value)) select.add(new Option(value, value));
    select.value = value;
  };
  return row(name, help, show, select, select);
}

/**
 * @param {string} text
 * @param {string} help
 * @param {(value: any) => void} show
 * @param {HTMLElement} field
 * @param {...HTMLElement} parts
 * @returns {Row}
 */
function row(text, help, show, field, ...parts) {
  const label = make("label", { htmlFor: field.id, textContent: text });
  const element = make("div", { className: "row", title: help }, label, ...parts);
  return { element, show, mark: (wrong) => (field.ariaInvalid = String(wrong)) };
}

export class Controls {
  /**
   * @param {HTMLElement} panel
   * @param {object} given
   * @param {Record<string, {help: string, choices: string[]}>} given.parameters by name, as pc2scan describes them
   * @param {string[]} given.presets
   * @param {string[]} given.fields of the clouds
   * @param {object} on
   * @param {(name: string, value: number | string) => void} on.param
   * @param {(key: keyof Mount, value: number) => void} on.mount
   * @param {(preset: string) => void} on.preset
   * @param {() => void} on.reset
   */
  constructor(panel, given, on) {
    /** @type {Map<string, Row>} */
    this.rows = new Map();
    const about = "Parameters that suit a consumer of the scans.";
    this.preset = choiceRow("preset", ["", ...given.presets], about, on.preset);
    panel.append(make("h2", { textContent: "Parameters" }), this.preset.element);
    for (const [title, specs] of Object.entries(GROUPS)) {
      const group = make("fieldset", {}, make("legend", { textContent: title }));
      for (const spec of specs) {
        const name = typeof spec === "string" ? spec : spec[0];
        const { help = "", choices = [] } = given.parameters[name] ?? {};
        const changed = (/** @type {number | string} */ value) => on.param(name, value);
        const words = name === "intensity_field" ? ["", ...given.fields] : choices;
        const isWord = typeof spec === "string";
        const made = isWord ? choiceRow(name, words, help, changed) : numberRow(spec, `param-${name}`, help, changed);
        this.rows.set(name, made);
        group.append(made.element);
      }
      panel.append(group);
    }
    const title = "Mount: the sensor in the target frame";
    const mount = make("fieldset", {}, make("legend", { textContent: title }));
    for (const key of MOUNT_KEYS) {
      const help = "Pose of the sensor in the target frame; see --static-tf.";
      /** @type {Spec} */
      const spec = key.length === 1 ? [key, "m", -3, 3, 0.01] : [key, "deg", -180, 180, 0.1];
      const made = numberRow(spec, `mount-${key}`, help, (value) => on.mount(key, value));
      this.rows.set(key, made);
      mount.append(made.element);
    }
    const reset = make("button", { type: "button", textContent: "Reset all" });
    reset.addEventListener("click", on.reset);
    this.problem = make("p", { className: "problem", role: "alert" });
    panel.append(mount, make("div", { className: "buttons" }, reset), this.problem);
  }

  /**
   * Show values, and the first problem of the parameters.
   * @param {Params} params
   * @param {Mount} mount
   * @param {string} preset
   * @param {{name: string, message: string} | null} problem
   */
  show(params, mount, preset, problem) {
    const { no_return, use_inf } = params;
    const values = { ...params, ...mount, no_return: no_return || (use_inf ? "inf" : "range-max-plus") };
    for (const [name, made] of this.rows) {
      made.show(values[/** @type {keyof typeof values} */ (name)]);
      made.mark(problem?.name === name);
    }
    this.preset.show(preset);
    this.problem.textContent = problem ? `${problem.name} ${problem.message}` : "";
  }
}

// The form: one row for each parameter, a slider beside its number.

import { make, put } from "./page.mjs";
import { MOUNT_KEYS } from "./transform.mjs";

/** @typedef {import("./params.mjs").Params} Params */
/** @typedef {import("./transform.mjs").Mount} Mount */

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

/** One parameter's row: a slider and a number that agree. */
class NumberRow {
  /**
   * @param {Spec} spec
   * @param {string} help
   * @param {(value: number) => void} changed
   */
  constructor([name, unit, min, max, step, none = "", empty], help, changed) {
    this.none = none;
    this.empty = empty;
    this.factor = unit === "deg" ? DEGREE : 1;
    const [low, high, by] = [min, max, step].map(String);
    this.slider = make("input", { type: "range", tabIndex: -1, min: low, max: high, step: by });
    this.number = make("input", { type: "number", step: "any", id: `param-${name}` });
    this.slider.setAttribute("aria-hidden", "true");
    this.slider.addEventListener("input", () => {
      this.number.value = this.slider.value;
      changed(Number(this.slider.value) * this.factor);
    });
    this.number.addEventListener("input", () => {
      const text = this.number.value.trim();
      const value = text === "" && empty !== undefined ? empty : Number.parseFloat(text) * this.factor;
      if (Number.isFinite(value)) this.slider.value = String(value / this.factor);
      changed(value);
    });
    const label = name === "angle_increment" ? "increment" : name;
    const after = make("span", { className: "unit", textContent: unit });
    this.element = row(label, this.number.id, help, this.slider, this.number, after);
  }

  /** @param {number} value */
  show(value) {
    const shown = Number((value / this.factor).toPrecision(9));
    const none = Math.abs(value) >= NO_LIMIT || value === this.empty;
    // Upstream's default min_height is the smallest number above 0.
    const above = value > 0 && value < 1e-300;
    const text = none || above ? "" : String(shown);
    put(this.number, "placeholder", above ? "above 0" : this.none);
    if (document.activeElement !== this.number) this.number.value = text;
    this.slider.value = String(Math.abs(value) >= NO_LIMIT ? Math.sign(value) * 1e9 : shown);
  }

  /** @param {boolean} wrong */
  mark(wrong) {
    this.number.setAttribute("aria-invalid", String(wrong));
  }
}

/** A parameter that is one of some words. */
class ChoiceRow {
  /**
   * @param {string} name
   * @param {string[]} choices
   * @param {string} help
   * @param {(value: string) => void} changed
   */
  constructor(name, choices, help, changed) {
    this.select = make("select", { id: `param-${name}` });
    for (const choice of choices) this.select.add(new Option(choice || "none", choice));
    this.select.addEventListener("change", () => changed(this.select.value));
    this.element = row(name, this.select.id, help, this.select);
  }

  /** @param {string} value */
  show(value) {
    if (![...this.select.options].some((option) => option.value === value)) this.select.add(new Option(value, value));
    this.select.value = value;
  }

  /** @param {boolean} wrong */
  mark(wrong) {
    this.select.setAttribute("aria-invalid", String(wrong));
  }
}

/**
 * @param {string} text
 * @param {string} id
 * @param {string} help
 * @param {...HTMLElement} parts
 */
function row(text, id, help, ...parts) {
  const label = make("label", { htmlFor: id, textContent: text });
  return make("div", { className: "row", title: help }, label, ...parts);
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
    /** @type {Map<string, NumberRow | ChoiceRow>} */
    this.rows = new Map();
    const about = "Parameters that suit a consumer of the scans.";
    this.presets = new ChoiceRow("preset", ["", ...given.presets], about, on.preset);
    panel.append(make("h2", { textContent: "Parameters" }), this.presets.element);
    for (const [title, specs] of Object.entries(GROUPS)) {
      const group = make("fieldset", {}, make("legend", { textContent: title }));
      for (const spec of specs) {
        const name = typeof spec === "string" ? spec : spec[0];
        const { help = "", choices = [] } = given.parameters[name] ?? {};
        const changed = (/** @type {number | string} */ value) => on.param(name, value);
        const words = name === "intensity_field" ? ["", ...given.fields] : choices;
        const made =
          typeof spec === "string" ? new ChoiceRow(name, words, help, changed) : new NumberRow(spec, help, changed);
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
      const made = new NumberRow(spec, help, (value) => on.mount(key, value));
      made.number.id = `mount-${key}`;
      made.element.querySelector("label")?.setAttribute("for", made.number.id);
      this.rows.set(`mount-${key}`, made);
      mount.append(made.element);
    }
    const reset = make("button", { type: "button", textContent: "Reset all" });
    reset.addEventListener("click", on.reset);
    this.problem = make("p", { className: "problem" });
    this.problem.setAttribute("role", "alert");
    panel.append(mount, make("div", { className: "buttons" }, reset), this.problem);
  }

  /**
   * Show values.
   * @param {Params} params
   * @param {Mount} mount
   * @param {string} preset
   */
  show(params, mount, preset) {
    for (const [name, made] of this.rows) {
      const key = name.startsWith("mount-") ? /** @type {keyof Mount} */ (name.slice(6)) : null;
      const value = key ? mount[key] : params[/** @type {keyof Params} */ (name)];
      if (made instanceof NumberRow) made.show(Number(value));
      else made.show(String(name === "no_return" && !value ? (params.use_inf ? "inf" : "range-max-plus") : value));
    }
    this.presets.show(preset);
  }

  /** @param {{name: string, message: string} | null} problem */
  blame(problem) {
    for (const [name, made] of this.rows) made.mark(problem?.name === name);
    put(this.problem, "textContent", problem ? `${problem.name} ${problem.message}` : "");
  }
}

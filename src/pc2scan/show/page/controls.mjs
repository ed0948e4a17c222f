// The form: one row for each parameter, a slider beside its number.

import { put } from "./page.mjs";
import { MOUNT_KEYS } from "./transform.mjs";

/** @typedef {import("./params.mjs").Params} Params */
/** @typedef {import("./transform.mjs").Mount} Mount */

const DEGREE = Math.PI / 180;
/** From here on a limit limits nothing: upstream's defaults are the largest float64. */
const NO_LIMIT = 1e300;

/**
 * @typedef {object} Spec
 * @property {string} name
 * @property {string} label
 * @property {string} unit
 * @property {number} [min] of the slider
 * @property {number} [max]
 * @property {number} [step]
 * @property {number} [factor] parameter per unit shown
 * @property {string} [none] what an empty field means
 * @property {number} [empty] the value of an empty field
 */

/** @type {{title: string, rows: (Spec | string)[]}[]} */
const GROUPS = [
  {
    title: "Heights",
    rows: [
      {
        name: "min_height",
        label: "min_height",
        unit: "m",
        min: -5,
        max: 5,
        step: 0.01,
        none: "no limit",
        empty: -Number.MAX_VALUE,
      },
      {
        name: "max_height",
        label: "max_height",
        unit: "m",
        min: -5,
        max: 5,
        step: 0.01,
        none: "no limit",
        empty: Number.MAX_VALUE,
      },
    ],
  },
  {
    title: "Ranges",
    rows: [
      { name: "range_min", label: "range_min", unit: "m", min: 0, max: 10, step: 0.01, none: "0", empty: 0 },
      {
        name: "range_max",
        label: "range_max",
        unit: "m",
        min: 0,
        max: 150,
        step: 0.1,
        none: "no limit",
        empty: Number.MAX_VALUE,
      },
    ],
  },
  {
    title: "Sector and beams",
    rows: [
      { name: "angle_min", label: "angle_min", unit: "deg", min: -360, max: 360, step: 0.5, factor: DEGREE },
      { name: "angle_max", label: "angle_max", unit: "deg", min: -360, max: 360, step: 0.5, factor: DEGREE },
      { name: "angle_increment", label: "increment", unit: "deg", min: 0.05, max: 5, step: 0.05, factor: DEGREE },
      { name: "beams", label: "beams", unit: "", min: 0, max: 3600, step: 1, none: "unset", empty: 0 },
      "geometry",
    ],
  },
  {
    title: "Range of a beam",
    rows: [
      "reduce",
      { name: "min_points", label: "min_points", unit: "", min: 1, max: 20, step: 1 },
      "no_return",
      "angle_rounding",
      "intensity_field",
    ],
  },
];

/** @type {Record<string, Spec>} */
const MOUNT_SPECS = {
  x: { name: "x", label: "x", unit: "m", min: -3, max: 3, step: 0.01 },
  y: { name: "y", label: "y", unit: "m", min: -3, max: 3, step: 0.01 },
  z: { name: "z", label: "z", unit: "m", min: -3, max: 3, step: 0.01 },
  roll: { name: "roll", label: "roll", unit: "deg", min: -180, max: 180, step: 0.1, factor: DEGREE },
  pitch: { name: "pitch", label: "pitch", unit: "deg", min: -90, max: 90, step: 0.1, factor: DEGREE },
  yaw: { name: "yaw", label: "yaw", unit: "deg", min: -180, max: 180, step: 0.1, factor: DEGREE },
};

/** One parameter's row: a slider and a number that agree. */
class NumberRow {
  /**
   * @param {Spec} spec
   * @param {string} help
   * @param {(value: number) => void} changed
   */
  constructor(spec, help, changed) {
    this.spec = spec;
    this.factor = spec.factor ?? 1;
    this.slider = Object.assign(document.createElement("input"), { type: "range", tabIndex: -1 });
    this.number = Object.assign(document.createElement("input"), { type: "number", step: "any" });
    for (const key of /** @type {const} */ (["min", "max", "step"])) this.slider[key] = String(spec[key]);
    this.slider.setAttribute("aria-hidden", "true");
    this.number.id = `param-${spec.name}`;
    this.slider.addEventListener("input", () => {
      this.number.value = this.slider.value;
      changed(Number(this.slider.value) * this.factor);
    });
    this.number.addEventListener("input", () => {
      const text = this.number.value.trim();
      const value = text === "" && spec.empty !== undefined ? spec.empty : Number.parseFloat(text) * this.factor;
      if (Number.isFinite(value)) this.slider.value = String(value / this.factor);
      changed(value);
    });
    this.element = row(spec.label, this.number.id, help, this.slider, this.number, unitOf(spec.unit));
  }

  /** @param {number} value */
  show(value) {
    const shown = Number((value / this.factor).toPrecision(9));
    const none = Math.abs(value) >= NO_LIMIT || value === this.spec.empty;
    // Upstream's default min_height is the smallest number above 0.
    const above = value > 0 && value < 1e-300;
    const text = none || above ? "" : String(shown);
    put(this.number, "placeholder", above ? "above 0" : (this.spec.none ?? ""));
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
    this.select = document.createElement("select");
    this.select.id = `param-${name}`;
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
  const element = document.createElement("div");
  element.className = "row";
  element.title = help;
  const label = document.createElement("label");
  label.htmlFor = id;
  label.textContent = text;
  element.append(label, ...parts);
  return element;
}

/** @param {string} unit */
function unitOf(unit) {
  const element = document.createElement("span");
  element.className = "unit";
  element.textContent = unit;
  return element;
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
    const heading = document.createElement("h2");
    heading.textContent = "Parameters";
    this.presets = new ChoiceRow(
      "preset",
      ["", ...given.presets],
      "Parameters that suit a consumer of the scans.",
      on.preset,
    );
    panel.append(heading, this.presets.element);
    for (const { title, rows } of GROUPS) {
      const group = fieldset(title);
      for (const spec of rows) {
        const name = typeof spec === "string" ? spec : spec.name;
        const { help = "", choices = [] } = given.parameters[name] ?? {};
        const made =
          typeof spec === "string"
            ? new ChoiceRow(name, name === "intensity_field" ? ["", ...given.fields] : choices, help, (value) =>
                on.param(name, value),
              )
            : new NumberRow(spec, help, (value) => on.param(name, value));
        this.rows.set(name, made);
        group.append(made.element);
      }
      panel.append(group);
    }
    const mount = fieldset("Mount: the sensor in the target frame");
    for (const key of MOUNT_KEYS) {
      const made = new NumberRow(
        MOUNT_SPECS[key],
        "Pose of the sensor in the target frame; see --static-tf.",
        (value) => on.mount(key, value),
      );
      made.number.id = `mount-${key}`;
      made.element.querySelector("label")?.setAttribute("for", made.number.id);
      this.rows.set(`mount-${key}`, made);
      mount.append(made.element);
    }
    const reset = Object.assign(document.createElement("button"), { type: "button", textContent: "Reset all" });
    reset.addEventListener("click", on.reset);
    const buttons = document.createElement("div");
    buttons.className = "buttons";
    buttons.append(reset);
    this.problem = document.createElement("p");
    this.problem.className = "problem";
    this.problem.setAttribute("role", "alert");
    panel.append(mount, buttons, this.problem);
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

/** @param {string} title */
function fieldset(title) {
  const element = document.createElement("fieldset");
  const legend = document.createElement("legend");
  legend.textContent = title;
  element.append(legend);
  return element;
}

// What the user can copy: the command line, parameter files and static transforms that make the scans of the page.

import { MOUNT_KEYS } from "./transform.mjs";

/** @typedef {import("./params.mjs").Params} Params */
/** @typedef {import("./transform.mjs").Mount} Mount */

/**
 * @typedef {object} Choice
 * @property {Params} params
 * @property {Record<string, number | string | boolean>} base the parameters without any option
 * @property {string} preset
 * @property {string[]} command the words that precede the parameters' options
 * @property {{parent: string, child: string, mount: Mount} | null} staticTf the user's mount
 * @property {string} targetFrame
 */

/**
 * Write a number so that Python reads the same bits.
 * @param {number} value
 */
function number(value) {
  if (value === Infinity) return "inf";
  const text = String(value);
  return /^-?\d+$/.test(text) && Math.abs(value) < 1e15 ? `${text}.0` : text;
}

/** @param {number | string | boolean} value */
const written = (value) => (typeof value === "number" ? number(value) : String(value));

/**
 * Quote a word for a POSIX shell.
 * @param {string} text
 */
function quoted(text) {
  return /^[\w@%+=:,./~-]+$/.test(text) && !text.startsWith("~") ? text : `'${text.replaceAll("'", `'"'"'`)}'`;
}

/**
 * The parameters that have an effect. pc2scan rejects the others: those that describe the same thing as another one, or
 * that belong to another choice.
 * @param {Params} params
 */
function counting(params) {
  return Object.entries(params).filter(([name, value]) => {
    if (name === "angle_increment") return !params.beams;
    if (name === "use_inf") return !params.no_return;
    return value !== "" && !(name === "beams" && !value);
  });
}

/**
 * The parameters that differ from those without any option.
 * @param {Choice} choice
 */
function changed({ params, base }) {
  return counting(params).filter(([name, value]) => base[name] !== value);
}

/** @param {Choice} choice */
export function staticText({ staticTf }) {
  if (!staticTf) return "";
  const { parent, child, mount } = staticTf;
  return [parent, child, ...MOUNT_KEYS.map((key) => number(mount[key]))].join(" ");
}

/**
 * The command line that makes the scans that the page shows.
 * @param {Choice} choice
 */
export function commandLine(choice) {
  return commandWords(choice).join(" ");
}

/**
 * The words of the command line, before quoting.
 * @param {Choice} choice
 */
export function commandWords(choice) {
  const words = [...choice.command];
  if (choice.preset) words.push("--preset", choice.preset);
  if (choice.staticTf) words.push("--static-tf", staticText(choice));
  if (choice.targetFrame) words.push(`--target-frame=${choice.targetFrame}`);
  for (const [name, value] of changed(choice)) {
    const option = `--${name.replaceAll("_", "-")}`;
    if (typeof value === "boolean") words.push(value ? option : `--no-${option.slice(2)}`);
    else if (name === "beams" || name === "min_points") words.push(`${option}=${value}`);
    else words.push(`${option}=${written(value)}`);
  }
  return words.map(quoted);
}

/**
 * A parameter file.
 * @param {Choice} choice
 * @param {1 | 2} ros
 */
export function parameterFile(choice, ros) {
  const { params, targetFrame } = choice;
  /** @type {[string, string][]} */
  const rows = targetFrame ? [["target_frame", JSON.stringify(targetFrame)]] : [];
  for (const [name, value] of counting(params)) {
    const whole = name === "beams" || name === "min_points";
    rows.push([name, typeof value === "string" ? JSON.stringify(value) : whole ? String(value) : written(value)]);
  }
  const indent = ros === 2 ? "    " : "";
  const head = ros === 2 ? "pointcloud_to_laserscan:\n  ros__parameters:\n" : "";
  return head + rows.map(([name, value]) => `${indent}${name}: ${value}\n`).join("");
}

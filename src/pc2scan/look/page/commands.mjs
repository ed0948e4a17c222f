// What the user takes away: the command line, parameter files and static transforms that mean the same as the page.

import { MOUNT_KEYS } from "./transform.mjs";

/** @typedef {import("./params.mjs").Params} Params */
/** @typedef {import("./transform.mjs").Mount} Mount */

/**
 * @typedef {object} Choice
 * @property {Params} params
 * @property {Record<string, number | string | boolean>} base what the parameters are without options
 * @property {string} preset
 * @property {string[]} command the words in front of the parameters' options
 * @property {{parent: string, child: string, mount: Mount} | null} staticTf what the user set
 * @property {string} targetFrame
 */

/**
 * A number as Python reads it back to the bit.
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
 * A word for a POSIX shell.
 * @param {string} text
 */
export function quoted(text) {
  return /^[\w@%+=:,./~-]+$/.test(text) && !text.startsWith("~") ? text : `'${text.replaceAll("'", `'"'"'`)}'`;
}

/**
 * The parameters that count: two that say the same, or that go with another choice, would be refused.
 * @param {Params} params
 */
function counting(params) {
  return Object.entries(params).filter(([name, value]) => {
    if (name === "angle_increment") return !params.beams;
    if (name === "kth") return params.reduce === "kth";
    if (name.startsWith("surface_")) return params.reduce === "surface";
    if (name === "use_inf") return !params.no_return;
    return value !== "" && !(name === "beams" && !value);
  });
}

/**
 * The parameters that differ from what they are without options.
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
 * Its words, as a shell reads them.
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
    else if (name === "beams" || name === "kth" || name === "min_points") words.push(`${option}=${value}`);
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
    const whole = name === "beams" || name === "kth" || name === "min_points";
    rows.push([name, typeof value === "string" ? JSON.stringify(value) : whole ? String(value) : written(value)]);
  }
  const indent = ros === 2 ? "    " : "";
  const head = ros === 2 ? "pointcloud_to_laserscan:\n  ros__parameters:\n" : "";
  return head + rows.map(([name, value]) => `${indent}${name}: ${value}\n`).join("");
}

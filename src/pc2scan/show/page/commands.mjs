// What the user can copy: the command line, and parameter files, that make the scans of the page.

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
 * Write a value so that Python reads the same bits.
 * @param {string} name
 * @param {number | string | boolean} value
 */
function written(name, value) {
  if (value === Infinity) return "inf";
  const isWhole = typeof value !== "number" || name === "beams" || name === "min_points";
  return /^-?\d+$/.test(String(value)) && !isWhole && Math.abs(value) < 1e15 ? `${value}.0` : String(value);
}

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
 * The command line that makes the scans that the page shows.
 * @param {Choice} choice
 */
export function commandLine({ params, base, preset, command, staticTf, targetFrame }) {
  const words = [...command];
  if (preset) words.push("--preset", preset);
  if (staticTf) {
    const { parent, child, mount } = staticTf;
    words.push("--static-tf", [parent, child, ...MOUNT_KEYS.map((key) => written(key, mount[key]))].join(" "));
  }
  if (targetFrame) words.push(`--target-frame=${targetFrame}`);
  for (const [name, value] of counting(params)) {
    if (base[name] === value) continue;
    const option = name.replaceAll("_", "-");
    if (typeof value === "boolean") words.push(value ? `--${option}` : `--no-${option}`);
    else words.push(`--${option}=${written(name, value)}`);
  }
  return words.map(quoted).join(" ");
}

/**
 * A parameter file.
 * @param {Choice} choice
 * @param {1 | 2} ros
 */
export function parameterFile({ params, targetFrame }, ros) {
  const rows = [...(targetFrame ? [["target_frame", targetFrame]] : []), ...counting(params)];
  const indent = ros === 2 ? "    " : "";
  const head = ros === 2 ? "pointcloud_to_laserscan:\n  ros__parameters:\n" : "";
  const lines = rows.map(([name, value]) => {
    const text = typeof value === "string" ? JSON.stringify(value) : written(String(name), value);
    return `${indent}${name}: ${text}\n`;
  });
  return head + lines.join("");
}

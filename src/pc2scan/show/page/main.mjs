// The entry point of the page.

import { showClouds } from "./clouds.mjs";
import { description } from "./data.mjs";
import { element } from "./page.mjs";
import { showScans } from "./scans.mjs";

const recording = description();
document.body.dataset.kind = recording.kind;
document.title = `${recording.title} - pc2scan`;
element("title", HTMLElement).textContent = recording.title;
element("subtitle", HTMLElement).textContent = recording.subtitle;
const note = element("note", HTMLElement);
note.hidden = !recording.notes.length;
note.textContent = recording.notes.join(" ");
if (recording.kind === "clouds") void showClouds(recording);
else void showScans(recording);

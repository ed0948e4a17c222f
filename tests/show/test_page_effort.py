"""What a redraw of the page costs while a parameter changes, as work that is counted, run by node: no clock is read."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from show.page_modules import needs_node, node

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = needs_node

_CODE = """
import { Raster } from "page:raster.mjs";
import { Projector } from "page:project.mjs";
globalThis.ImageData = class { constructor(width, height) { this.data = new Uint8ClampedArray(4 * width * height); } };
const POINTS = 131072;
const axis = (scale, of) => Float32Array.from({ length: POINTS }, (_, n) => scale * of(n * 0.7391));
const cloud = { x: axis(9, Math.cos), y: axis(6, Math.sin), z: axis(1.5, (n) => Math.sin(3 * n)) };
const params = { min_height: -1, max_height: 1, range_min: 0, range_max: 30, angle_min: -3.14, angle_max: 3.14,
  angle_increment: 0.0175, use_inf: true, inf_epsilon: 1, geometry: "upstream", beams: 0, no_return: "", reduce: "min",
  min_points: 1, intensity_field: "", angle_rounding: "correct" };
const effort = { angles: 0, bytes: 0, located: 0 };
const { atan2 } = Math;
Math.atan2 = (y, x) => { effort.angles += 1; return atan2(y, x); };
const { locate } = Raster.prototype;
Raster.prototype.locate = function (...given) { effort.located += 1; return locate.apply(this, given); };
for (const name of ["Uint8Array", "Uint32Array", "Int32Array", "Float32Array", "Float64Array"]) {
  globalThis[name] = new Proxy(globalThis[name], {
    construct(kind, given) { const made = new kind(...given); effort.bytes += made.byteLength; return made; },
  });
}
const projector = new Projector();
const raster = new Raster();
raster.resize(600, 400);
projector.place(cloud);
const colours = new Uint32Array(POINTS).fill(0xff0000ff);
let [scale, shown] = [30, cloud];
function redraw(changes) {
  Object.assign(effort, { angles: 0, bytes: 0, located: 0 });
  const scan = projector.scan({ ...params, ...changes });
  const view = { right: [scale, 0, 0, 300], down: [0, -scale, 0, 200], near: [0, 0, 1] };
  raster.draw(shown, view, 1, colours, FRONT ? scan.outcomes : null);
  return { ...effort };
}
const told = { first: redraw({}) };
told.narrower = redraw({ max_height: 0.5 });
told.wider = redraw({ max_height: 1.2 });
told.sector = redraw({ angle_min: -1, range_max: 7 });
scale = 31;
told.zoomed = redraw({});
shown = { ...cloud };
told.moved = redraw({});
console.log(JSON.stringify(told));
"""


@pytest.mark.parametrize("front", ["true", "false"], ids=["by outcome", "the nearest in front"])
def test_a_redraw_repeats_no_work(tmp_path: Path, front: str) -> None:
    told: dict[str, Any] = json.loads(node(tmp_path, _CODE.replace("FRONT", front)))
    within = told["first"]["angles"]
    assert 60_000 < within < 131_072
    for change in ("narrower", "sector", "zoomed", "moved"):
        # Angles are known; what is allocated has the size of a scan, not of the cloud.
        assert told[change]["angles"] == 0, change
        assert told[change]["bytes"] < 16_000, change
    # Only those of the points that come into the band.
    assert 0 < told["wider"]["angles"] < 131_072 - within
    located = {change: effort["located"] for change, effort in told.items()}
    assert located == {"first": 1, "narrower": 0, "wider": 0, "sector": 0, "zoomed": 1, "moved": 1}

"""What the page draws over the points, run by node with a pen that records its calls."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from show.page_modules import needs_node, node

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = needs_node

_CODE = """
import { frameMarks } from "page:draw.mjs";
const texts = [];
const nothing = () => {};
const pen = { beginPath: nothing, moveTo: nothing, lineTo: nothing, stroke: nothing, strokeText: nothing,
  measureText: (text) => ({ width: 6 * text.length }), fillText: (...told) => texts.push(told) };
const frames = ["odom", "base_link", "imu"].map((name, n) => ({ name, x: 0.02 * n, y: 0, z: 0 }));
frames.push({ name: "far", x: 9, y: 0, z: 0 }, { name: "nowhere", x: NaN, y: NaN, z: NaN });
frameMarks(pen, (x, y) => [100 * x, 100 * y], frames, 1, { getPropertyValue: () => "" });
console.log(JSON.stringify(texts));
"""


def test_names_of_frames_do_not_lie_over_each_other(tmp_path: Path) -> None:
    texts = json.loads(node(tmp_path, _CODE))
    assert [name for name, _, _ in texts] == ["odom", "base_link", "imu", "far", "nowhere"]
    heights = {name: y for name, _, y in texts}
    # Upwards, where one would lie over another; where there is room, beside the cross.
    assert heights["odom"] == heights["far"] == -7
    assert heights["base_link"] <= -19
    assert heights["imu"] <= heights["base_link"] - 12

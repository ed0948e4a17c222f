"""The pixels of a cloud, run by node: which point each of them shows, against a reference that draws point by point."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from show.page_modules import needs_node, node

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = needs_node

WIDTH, HEIGHT = 17, 11
COLOURS = [1000 + n for n in range(400)]

#: From above, from the side, and turned; right, down and near.
VIEWS = {
    "above": ([3, 0, 0, 8], [0, -3, 0, 5], [0, 0, 1]),
    "side": ([3, 0, 0, 8], [0, 0, -4, 5.5], [0, -1, 0]),
    "turned": ([2, 1.5, 0, 8], [0.5, -1, -2, 5], [0.6, 0.3, 0.74]),
}

_CODE = """
import { Raster } from "page:raster.mjs";
globalThis.ImageData = class { constructor(width, height) { this.data = new Uint8ClampedArray(4 * width * height); } };
const { width, height, cloud, colours, ranks, view: [right, down, near], sizes } = CASE;
const raster = new Raster();
raster.resize(width, height);
const axes = cloud.map((values) => Float32Array.from(values, Number));
const drawn = sizes.map((size) => {
  raster.draw({ x: axes[0], y: axes[1], z: axes[2] }, { right, down, near }, size, Uint32Array.from(colours),
    ranks && Uint8Array.from(ranks));
  return { points: [...raster.points], pixels: [...raster.pixels] };
});
console.log(JSON.stringify(drawn));
"""


def reference(cloud: Any, view: Any, size: int, ranks: list[int] | None) -> list[int]:
    """The points of the pixels, plus one: the last of rank 0, else the last; without ranks the nearest."""
    points, depths = np.zeros((HEIGHT, WIDTH), int), np.full((HEIGHT, WIDTH), -np.inf)
    right, down, near = view
    # The value of an axis along which the view looks does not matter.
    seen = [bool(a or b) for a, b in zip(right[:3], down[:3], strict=True)]

    def along(row: list[float], x: float, y: float, z: float) -> float:
        return row[0] * x + row[1] * y + row[2] * z

    for n, point in enumerate(cloud.tolist()):
        flat = [value if shown else 0.0 for value, shown in zip(point, seen, strict=True)]
        left, top = (along(row, *flat) + row[3] + (1 - size) / 2 for row in (right, down))
        if 0 <= left < WIDTH - size + 1 and 0 <= top < HEIGHT - size + 1:
            box = np.s_[int(top) : int(top) + size, int(left) : int(left) + size]
            depth = float(ranks[n] == 0) if ranks else along(near, *point)
            front = ~(depth < depths[box])
            points[box][front], depths[box][front] = n + 1, np.float32(depth)
    return [int(point) for point in points.flat]


@pytest.mark.parametrize("by_rank", [True, False], ids=["by rank", "the nearest"])
@pytest.mark.parametrize("name", VIEWS)
def test_each_pixel_shows_its_point(tmp_path: Path, name: str, by_rank: bool) -> None:
    rng = np.random.default_rng(7)
    # Crowded, so that pixels have several points; some outside, some at whole pixels, and some without a place.
    cloud = rng.uniform(-4, 4, (400, 3)).astype(np.float32)
    cloud[::5] = np.round(cloud[::5])
    cloud[::31, rng.integers(0, 3, 13)] = np.nan
    cloud[::37, 0] = np.inf
    cloud[3::41, 2] = -np.inf
    ranks = rng.integers(0, 3, 400).tolist() if by_rank else None
    case: dict[str, Any] = {
        "width": WIDTH,
        "height": HEIGHT,
        "cloud": [[str(value).replace("inf", "Infinity") for value in axis] for axis in cloud.T],
        "colours": COLOURS,
        "ranks": ranks,
        "view": VIEWS[name],
        "sizes": [1, 2, 3, 1],
    }
    for size, drawn in zip(
        case["sizes"], json.loads(node(tmp_path, _CODE.replace("CASE", json.dumps(case)))), strict=True
    ):
        expected = reference(cloud, VIEWS[name], size, ranks)
        assert sum(point > 0 for point in expected) > 40
        assert drawn["points"] == expected, size
        assert drawn["pixels"] == [COLOURS[point - 1] if point else 0 for point in expected]

"""The page's projection, run by node, against pc2scan's on random clouds and parameters: the same bits."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pc2scan.core import kernel
from pc2scan.core.params import ProjectionParams
from pc2scan.core.project import Projector
from pc2scan.core.rigid import Rigid
from pc2scan.errors import ParameterError
from show.page_modules import needs_node, node

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = needs_node

POINTS = 1500

_CODE = """
import fs from "node:fs";
import { Projector, transformed } from "page:project.mjs";
import { matrixOfMount } from "page:transform.mjs";
import { problemOf } from "page:params.mjs";
const cases = JSON.parse(fs.readFileSync("cases.json"));
const bytes = fs.readFileSync("clouds.bin");
const numbers = new Float32Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
const hex = (array) => Buffer.from(array.buffer).toString("hex");
let at = 0;
let before = cases[0].params;
const next = (length) => numbers.slice(at, (at += length));
const results = cases.map(({ params, mount, points }) => {
  let cloud = { x: next(points), y: next(points), z: next(points) };
  const problem = problemOf(params);
  if (problem) throw new Error(JSON.stringify([problem, params]));
  if (mount) {
    const [x, y, z, roll, pitch, yaw] = mount;
    cloud = transformed(cloud, matrixOfMount({ x, y, z, roll, pitch, yaw }));
  }
  // As in the page, after other parameters: what is kept of them must not matter.
  const projector = new Projector(cloud);
  projector.scan(before);
  before = params;
  const scan = projector.scan(params);
  return { ranges: hex(scan.ranges), counts: scan.counts };
});
console.log(JSON.stringify(results));
"""


def _random_params(rng: np.random.Generator) -> ProjectionParams:
    def one_of(*values: Any) -> Any:
        return values[rng.integers(len(values))]

    while True:
        values: dict[str, Any] = {
            "min_height": one_of(-1.0, 2.2250738585072014e-308, -0.3, -1e300),
            "max_height": one_of(1.0, 1.7976931348623157e308, 0.5),
            "geometry": one_of("upstream", "centered", "half-open", "symmetric"),
            "reduce": one_of("min", "min", "max", "mean", "median", "kth=1", "kth=2", "kth=3", "surface"),
            "min_points": one_of(1, 1, 2, 3),
            "no_return": one_of("", "inf", "range-max-plus", "range-max-minus", "nan", "zero"),
            "use_inf": one_of(True, False),
            "inf_epsilon": one_of(1.0, 0.5, 1e-9, 0.0, -1.0, -5.0),
            "range_min": one_of(0.0, 0.1, 0.45, float(rng.uniform(0, 3))),
            "range_max": one_of(1.7976931348623157e308, 100.0, 4.0, float(rng.uniform(3, 9))),
            "angle_rounding": one_of("correct", "glibc-2.40"),
        }
        if rng.random() < 0.5:
            values |= {"angle_min": float(rng.uniform(-3.1, 0)), "angle_max": float(rng.uniform(0.01, 3.1))}
        if rng.random() < 0.3:
            values["beams"] = int(rng.integers(2, 3000))
        else:
            values["angle_increment"] = one_of(
                math.pi / 180, math.pi / 360, 0.0087, 0.005, float(rng.uniform(0.001, 0.3))
            )
        try:
            return ProjectionParams(**values)
        except ParameterError:
            continue


def _random_cloud(rng: np.random.Generator) -> np.ndarray[Any, np.dtype[np.float32]]:
    points = rng.normal(0, 3, (POINTS, 3))
    match rng.integers(3):
        case 0:
            points = np.round(points, 1)
        case 1:
            points *= (1, 1e-7, 0.1)
    cloud = points.astype(np.float32)
    cloud[rng.random(POINTS) < 0.02] = np.nan
    cloud[rng.random(POINTS) < 0.01, 0] = 0
    cloud[rng.random(POINTS) < 0.01, 1] = -0.0
    cloud[rng.random(POINTS) < 0.003, 0] = np.inf
    return cloud


def test_every_parameter_means_the_same(tmp_path: Path) -> None:
    rng = np.random.default_rng(18)
    cases, expected = [], []
    with (tmp_path / "clouds.bin").open("wb") as file:
        for _ in range(150):
            params, cloud = _random_params(rng), _random_cloud(rng)
            mount = rng.uniform(-1, 1, 6).tolist() if rng.random() < 0.5 else None
            rigid = None if mount is None else Rigid.from_rpy(mount[3], mount[4], mount[5], mount[:3]).as_float32()
            x, y, z = cloud.T
            expected.append(Projector(params)(x, y, z, rigid, None))
            shown = {field.name: getattr(params, field.name) for field in fields(ProjectionParams)}
            cases.append({"params": shown, "mount": mount, "points": POINTS})
            file.write(cloud.T.tobytes())
    (tmp_path / "cases.json").write_text(json.dumps(cases))
    for case, scan, found in zip(cases, expected, json.loads(node(tmp_path, _CODE)), strict=True):
        counts = scan.counts
        assert found["counts"] == [
            counts.used, counts.nan, counts.height, counts.range, counts.angle, counts.past_end, 0
        ], case["params"]  # fmt: skip
        values = np.frombuffer(bytes.fromhex(found["ranges"]), np.float32)
        assert np.array_equal(values, scan.ranges, equal_nan=True), case["params"]


@pytest.mark.parametrize(("function", "glibc"), [("correctAngle", False), ("olderGlibcAngle", True)])
def test_angles(tmp_path: Path, function: str, glibc: bool) -> None:
    rng = np.random.default_rng(40)
    x, y = (rng.normal(0, 10, 200_000) * 10.0 ** rng.integers(-30, 20, 200_000) for _ in range(2))
    x, y = x.astype(np.float32), y.astype(np.float32)
    special = np.array([0, -0.0, 1, -1, np.inf, -np.inf, 1e-45, 3e38], np.float32)
    x, y = np.concatenate([x, np.repeat(special, 8)]), np.concatenate([y, np.tile(special, 8)])
    expected = np.empty_like(x)
    kernel.angles(x, y, expected, glibc)
    (tmp_path / "x.bin").write_bytes(x.tobytes())
    (tmp_path / "y.bin").write_bytes(y.tobytes())
    code = f"""
    import fs from "node:fs";
    import {{ {function} }} from "page:angles.mjs";
    const read = (name) => new Float32Array(new Uint8Array(fs.readFileSync(name)).buffer);
    const [x, y] = [read("x.bin"), read("y.bin")];
    console.log(Buffer.from(Float32Array.from(x, (_, n) => {function}(y[n], x[n])).buffer).toString("hex"));
    """
    found = np.frombuffer(bytes.fromhex(node(tmp_path, code).strip()), np.float32)
    assert found.tobytes() == expected.tobytes()

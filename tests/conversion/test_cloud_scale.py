"""Clouds in another unit: multiplied, they give what the same clouds in metres give, through every door."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from support.builders import CLOUD, T0, Recording, Stream, item, write_mcap, write_rosbag1
from support.clouds import LIVOX, OLD_CLOUD, livox, livox_points, old_cloud, structured

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

HEIGHTS: dict[str, Any] = {"min_height": -20.0, "max_height": 20.0}
MAKE: dict[str, Callable[[Any, int], bytes]] = {CLOUD: structured, OLD_CLOUD: old_cloud, LIVOX[1]: livox}


def points(kind: str, scale: float) -> Any:
    """Whole millimetres, as such if ``scale`` is 1000, else in metres; of a CustomMsg those of a Livox."""
    found = livox_points(1)
    if kind != "livox":
        numbers = np.dtype([*((axis, kind) for axis in "xyz"), ("intensity", "<f4")])
        found = np.zeros(300, numbers)
    for index, axis in enumerate("xyz"):
        millimetres = np.random.default_rng(index).integers(-8000, 8000, 300)
        found[axis] = millimetres if scale == 1000 else millimetres * 0.001
    return found


def recorded(path: Path, msgtype: str, kind: str, scale: float) -> Path:
    one = points(kind, scale)
    content = item(Stream("/points", msgtype), T0, lambda version, _: MAKE[msgtype](one, version))
    return (write_mcap if path.suffix == ".mcap" else write_rosbag1)(path, Recording((content.stream,), (content,)))


@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
@pytest.mark.parametrize(
    ("msgtype", "kind", "metres"),
    [
        (CLOUD, "<f4", "<f4"),
        (CLOUD, "<f8", "<f8"),
        (CLOUD, "<i2", "<f4"),
        (OLD_CLOUD, "<f4", "<f4"),
        (LIVOX[1], "livox", "livox"),
    ],
)
def test_scaled_clouds_are_those_in_metres(msgtype: str, kind: str, metres: str, suffix: str, tmp_path: Path) -> None:
    sources = (
        recorded(tmp_path / f"wrong{suffix}", msgtype, kind, 1000),
        recorded(tmp_path / f"right{suffix}", msgtype, metres, 1),
    )
    factors = 0.001, 1
    results = tmp_path / "wrong.mcap.mcap", tmp_path / "right.mcap.mcap"
    for source, factor, result in zip(sources, factors, results, strict=True):
        pc2scan.convert(source, result, keep_clouds=True, cloud_scale=factor, **HEIGHTS)
    assert pc2scan.diff(*results).exit_status == 0
    wrong, right = (
        next(iter(pc2scan.scans(source, "/points", cloud_scale=factor, **HEIGHTS)))
        for source, factor in zip(sources, factors, strict=True)
    )
    assert np.array_equal(wrong.ranges, right.ranges)
    assert np.isfinite(right.ranges).sum() > 100
    wrong_cloud, right_cloud = (
        next(iter(pc2scan.clouds(source, cloud_scale=factor))) for source, factor in zip(sources, factors, strict=True)
    )
    assert np.array_equal(wrong_cloud.xyz(), right_cloud.xyz())
    assert set(wrong_cloud.fields) == set(right_cloud.fields)
    wrong_info, right_info = (
        pc2scan.info(source, cloud_scale=factor) for source, factor in zip(sources, factors, strict=True)
    )
    assert wrong_info.clouds[0].limits == right_info.clouds[0].limits

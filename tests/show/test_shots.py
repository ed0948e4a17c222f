"""Clouds for pictures are those that a conversion projects."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.core.project import Projector
from pc2scan.request.options import ConvertOptions, ScanSpec
from pc2scan.request.where import Where
from pc2scan.show.recording import open_recording
from pc2scan.show.shots import take_shots
from support import ROOT

if TYPE_CHECKING:
    from numpy.typing import NDArray

HALL = ROOT / "fixtures" / "hall.mcap"
PARAMS = pc2scan.ProjectionParams(min_height=-0.3, max_height=1.0, target_frame="base_link")


def ranges_of_shots(**asked: Any) -> list[NDArray[np.float32]]:
    options = ConvertOptions(scans=(ScanSpec(params=PARAMS, **asked),))
    with open_recording([HALL], options) as recording:
        taken = take_shots(recording, options, count=100, at_ns=[], level=True)
    found = []
    for shot in taken.shots:
        points = np.stack([shot.columns[axis] for axis in "xyz"], axis=1)
        if shot.filtered is not None:
            points = points[shot.filtered == 0]
        rigid = shot.place.target_from_source
        found.append(Projector(PARAMS)(*(points if rigid is None else rigid.apply(points)).T).ranges)
    return found


def alike(a: list[NDArray[np.float32]], b: list[NDArray[np.float32]]) -> float:
    """The share of the beams that are equal, but for float32's last bits."""
    assert len(a) == len(b) >= 4
    return float(np.isclose(np.concatenate(a), np.concatenate(b), rtol=1e-5, atol=1e-5).mean())


@pytest.mark.parametrize(
    ("stamp", "level", "filters"), [("header", False, (Where("ring in (2, 3)"),)), ("end", True, ())]
)
def test_clouds_are_deskewed_as_by_a_conversion(stamp: str, level: bool, filters: tuple[Where, ...]) -> None:
    asked: dict[str, Any] = {"deskew": True, "fixed_frame": "odom", "stamp": stamp, "level": level}
    scans = pc2scan.scans(HALL, "/points", params=PARAMS, filters=filters, **asked)
    with pytest.warns(pc2scan.RecordingWarning):
        converted = [scan.ranges for scan in scans]
    found = ranges_of_shots(filters=filters, **asked)[-len(converted) :]
    # Rounded to float32 twice, a few points change their beam.
    assert alike(found, converted) > 0.99
    assert alike(ranges_of_shots(filters=filters)[-len(converted) :], converted) < 0.9

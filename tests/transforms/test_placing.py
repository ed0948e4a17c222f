from __future__ import annotations

import pytest

from pc2scan.errors import TransformError
from pc2scan.transforms.placing import FrameOptions, Placement, Placer
from transforms.recorded import frames, made, row


def test_no_target_frame_leaves_everything_in_its_place() -> None:
    assert Placer().place("lidar", 5) == Placement("lidar", None)


@pytest.mark.parametrize("own", ["base", "/base"])
def test_a_message_that_is_in_the_target_frame_stays(own: str) -> None:
    known, _ = frames([])
    assert known.place(own, 5) == Placement("base", None)


def test_the_source_frame_is_overridden() -> None:
    recording = made(("/tf_static", [row("base", "lidar", 0, 0.5)]))
    known, _ = frames([recording], FrameOptions(source_frame="lidar"))
    assert known.place("", 5).target_from_source is not None
    assert Placer(source_frame="lidar").place("wrong", 5) == Placement("lidar", None)


def test_the_tolerance_takes_the_nearest_transform() -> None:
    recording = made(("/tf", [row("base", "lidar", 100, 1.0), row("base", "lidar", 200, 2.0)]))
    strict, _ = frames([recording])
    with pytest.raises(TransformError, match="too early"):
        strict.place("lidar", 95)
    lenient, _ = frames([recording], tolerance_ns=5)
    place = lenient.place("lidar", 95)
    assert place.target_from_source is not None
    assert place.target_from_source.translation.tolist() == [1, 0, 0]
    with pytest.raises(TransformError):
        lenient.place("lidar", 94)

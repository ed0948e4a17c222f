from __future__ import annotations

import pytest

from pc2scan.errors import RecordingError
from pc2scan.tf.builder import TransformBuilder
from tf.small_buffers import at, refusal, row, x_of


class TestBuilder:
    def test_builder_goes_on_after_building(self) -> None:
        builder = TransformBuilder()
        builder.add([row("a", "b", 0, x=1)], static=False)
        first = builder.build()
        builder.add([row("a", "b", 2, x=3)], static=False)
        second = builder.build()
        assert (len(first), len(second), len(builder)) == (1, 2, 2)
        assert x_of(second, "a", "b", at(1)) == 2
        assert "is not known at" in refusal(first, "a", "b", at(1)).message

    def test_more_frames_than_a_robot_has_are_refused(self) -> None:
        builder = TransformBuilder()
        with pytest.raises(RecordingError, match="more than 100,000 frames"):
            builder.add((row(f"f{n}", f"f{n + 1}", 0) for n in range(100_000)), static=True)

    def test_more_pairs_of_frames_than_a_robot_has_are_refused(self) -> None:
        builder = TransformBuilder()
        with pytest.raises(RecordingError, match="200,000 pairs"):
            builder.add((row(f"f{n % 500}", f"g{n // 500}", n) for n in range(200_001)), static=False)

"""Transforms that tf2 does not take."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from pc2scan.transforms.builder import MAX_REJECTIONS
from pc2scan.transforms.frames import RejectedTransforms
from transforms.small_buffers import at, built, refusal, row, x_of

if TYPE_CHECKING:
    from pc2scan.core.rigid import TransformRow


class TestRejections:
    GOOD = row("odom", "base", 0, x=1)

    @pytest.mark.parametrize(
        ("entry", "reason"),
        [
            (row("a", "a", 7), "TF_SELF_TRANSFORM"),
            (row("/a", "a", 7), "TF_SELF_TRANSFORM"),
            (row("a", "", 7), "TF_NO_CHILD_FRAME_ID"),
            (row("", "a", 7), "TF_NO_FRAME_ID"),
            (row("a", "b", 7, x=math.nan), "TF_NAN_INPUT"),
            (row("a", "b", 7, x=-math.inf), "TF_NAN_INPUT"),
            (row("a", "b", 7, norm=math.nan), "TF_NAN_INPUT"),
            (row("a", "b", 7, norm=0), "TF_DENORMALIZED_QUATERNION"),
        ],
    )
    def test_offender_is_named_and_the_rest_used(self, entry: TransformRow, reason: str) -> None:
        buffer = built([self.GOOD, entry, entry])
        (rejection,) = buffer.rejections
        assert rejection.reason.startswith(reason + ": ")
        assert rejection == RejectedTransforms(
            entry[1].removeprefix("/"), entry[0].removeprefix("/"), at(7), rejection.reason, 2
        )
        assert buffer.rejected == 2
        assert buffer.frames == ("odom", "base")
        assert x_of(buffer, "odom", "base", at(0)) == 1

    @pytest.mark.parametrize("norm", [1.0, 1.001, 0.998, -1.0, 2.0, 1e-200, 1e200, 1.006, 0.994])
    def test_quaternions_are_taken_as_they_are_or_refused(self, norm: float) -> None:
        entry = row("a", "b", 0, yaw=0.5, norm=norm)
        buffer = built([self.GOOD, entry])
        if abs(abs(norm) - 1) < 0.005:
            assert buffer.rejected == 0
            assert buffer.lookup("a", "b", at(0)).quaternion.tolist() == list(entry[6:])
            return
        (rejection,) = buffer.rejections
        assert rejection.reason == (
            "TF_DENORMALIZED_QUATERNION: the squared norm of the quaternion differs from 1 by 0.01 or more"
        )
        assert "[b] in [a] was rejected: TF_DENORM" in refusal(buffer, "a", "b", at(0)).message

    def test_list_is_bounded_and_in_order_and_the_count_is_not(self) -> None:
        rows = [row("a", f"f{number}", number, norm=0) for number in range(MAX_REJECTIONS + 50)]
        buffer = built(rows[::-1] + rows)
        assert len(buffer.rejections) == MAX_REJECTIONS
        assert buffer.rejected == 2 * len(rows)
        assert [entry.child for entry in buffer.rejections[:2]] == ["f149", "f148"]
        assert {entry.count for entry in buffer.rejections} == {2}
        assert buffer.frames == ()

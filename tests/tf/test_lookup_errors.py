"""What a lookup says where there is no transform."""

from __future__ import annotations

import pytest

from pc2scan.tf.lookup_errors import MAX_NAMES
from tf.small_buffers import SECOND, at, built, refusal, row


class TestRefusal:
    def test_unknown_frame_names_the_ones_there_are(self) -> None:
        error = refusal(built(static=[row("base", "lidar", 0)]), "base", "velodyne", at(1))
        assert error.message == (
            "no transform has the source frame 'velodyne'; the 2 frames with transforms are base, lidar"
        )
        assert error.stamp_ns == at(1)
        assert "`source_frame`" in str(error.hint)

    def test_unknown_target(self) -> None:
        error = refusal(built(static=[row("base_link", "lidar", 0)]), "Base-Link", "lidar", at(1))
        assert "no transform has the frame 'Base-Link'" in error.message
        assert str(error.hint).startswith("did you mean base_link? ")

    def test_names_are_not_endless(self) -> None:
        buffer = built(static=[row("base", f"f{number:03}", 0) for number in range(100)])
        message = refusal(buffer, "base", "x", at(1)).message
        assert message.count(",") == MAX_NAMES - 1
        assert message.endswith("f018 and 81 more")

    def test_no_transforms_at_all(self) -> None:
        assert "there are no transforms" in refusal(built(), "a", "b", at(1)).message

    def test_unknown_for_having_been_rejected(self) -> None:
        buffer = built([row("odom", "base", 0), row("base", "lidar", 0, norm=0)])
        assert refusal(buffer, "odom", "lidar", at(0)).message.endswith(
            "; [lidar] in [base] was rejected: TF_DENORMALIZED_QUATERNION: the quaternion is zero"
        )

    @pytest.mark.parametrize("names", [("", "a"), ("a", ""), ("", ""), ("/", "a")])
    def test_empty_names(self, names: tuple[str, str]) -> None:
        assert "frame has no name" in refusal(built(static=[row("a", "b", 0)]), *names, at(0)).message

    def test_not_connected_describes_both_trees(self) -> None:
        buffer = built(static=[row("map", "odom", 0), row("base", "lidar", 0), row("base", "imu", 0)])
        error = refusal(buffer, "odom", "lidar", at(0))
        assert error.message == (
            "no transforms connect [lidar] with [odom]: [odom] is in the tree of [map] (map, odom), "
            "[lidar] in the tree of [base] (base, imu, lidar)"
        )

    def test_too_late(self) -> None:
        buffer = built([row("odom", "base", second) for second in (1, 2)], [row("base", "lidar", 0)])
        assert refusal(buffer, "odom", "lidar", at(2.25), SECOND // 100).message == (
            "the transform from [lidar] to [odom] is not known at 1700000002.250000000: [base] in [odom] is known from "
            "1700000001.000000000 to 1700000002.000000000, the time is 0.250000000 s too late, the "
            "tolerance is 0.010000000 s"
        )

    def test_too_early(self) -> None:
        error = refusal(built([row("odom", "base", second) for second in (1, 2)]), "odom", "base", at(0.5))
        assert "is not known at 1700000000.500000000" in error.message
        assert "0.500000000 s too early" in error.message
        assert "`transform_tolerance=0.5` uses the nearest transform" in str(error.hint)

    @pytest.mark.parametrize(
        ("second", "hint"),
        [(30, "the nearest transform is 28 s away"), (20_000, "the clocks differ by 6 hours: one of them was not set")],
    )
    def test_no_tolerance_helps_where_transforms_are_far_away(self, second: float, hint: str) -> None:
        error = refusal(built([row("odom", "base", second) for second in (1, 2)]), "odom", "base", at(second))
        assert str(error.hint).startswith(hint)
        assert "tolerance" not in str(error.hint)

    def test_only_one_sample(self) -> None:
        message = refusal(built([row("odom", "base", 1)]), "odom", "base", at(2)).message
        assert "not known at 1700000002.000000000: [base] in [odom] is known only at 1700000001.000000000" in message

    def test_of_several_frames_the_farthest_is_named(self) -> None:
        buffer = built([row("a", "b", 5), row("b", "c", 1), row("c", "d", 3)])
        assert "[c] in [b] is known" in refusal(buffer, "a", "d", at(6)).message

    def test_loops(self) -> None:
        edges = [("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")]
        buffer = built(static=[row(parent, child, 0) for parent, child in edges])
        for target, source in [("a", "b"), ("b", "a"), ("a", "d"), ("d", "c")]:
            assert "contains a loop" in refusal(buffer, target, source, at(0)).message
            assert "contains a loop" in refusal(buffer, target, source, 0).message
        assert "[d] to [a]: [c] in [b] in [a] in [c]" in refusal(buffer, "a", "d", at(0)).message

    def test_two_frames_in_each_other(self) -> None:
        buffer = built([row(*pair, second) for second in (0, 1) for pair in (("a", "b"), ("b", "a"))])
        assert "[b] in [a] in [b]" in refusal(buffer, "a", "b", at(0.5)).message

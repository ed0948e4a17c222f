"""The transform buffer's rules, one by one; tests/tf/test_tf2_agreement.py holds them to tf2 itself."""

from __future__ import annotations

import math
import pickle
import struct
from bisect import bisect_right
from dataclasses import FrozenInstanceError
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.rigid import Rigid, TransformRow, interpolate, interpolate_poses
from pc2scan.errors import RecordingError, TransformError
from pc2scan.messages.tfmessage import decode_transforms
from pc2scan.tf.buffer import (
    MAX_NAMES,
    MAX_REJECTIONS,
    FrameInfo,
    Rejection,
    TransformBuffer,
    TransformBuilder,
    Tree,
)
from support import GOLDEN

SECOND = 1_000_000_000
EPOCH = 1_700_000_000 * SECOND


def row(parent: str, child: str, second: float, x: float = 0.0, yaw: float = 0.0, *, norm: float = 1.0) -> TransformRow:
    z, w = math.sin(yaw / 2) * norm, math.cos(yaw / 2) * norm
    return (parent, child, EPOCH + round(second * SECOND), x, 0.0, 0.0, 0.0, 0.0, z, w)


def at(second: float) -> int:
    return EPOCH + round(second * SECOND)


def built(dynamic: list[TransformRow] | None = None, static: list[TransformRow] | None = None) -> TransformBuffer:
    builder = TransformBuilder()
    builder.add(static or [], static=True)
    builder.add(dynamic or [], static=False)
    return builder.build()


def x_of(buffer: TransformBuffer, target: str, source: str, stamp_ns: int, tolerance_ns: int = 0) -> float:
    return float(buffer.lookup(target, source, stamp_ns, tolerance_ns).translation[0])


def refusal(buffer: TransformBuffer, target: str, source: str, stamp_ns: int, tolerance_ns: int = 0) -> TransformError:
    with pytest.raises(TransformError) as caught:
        buffer.lookup(target, source, stamp_ns, tolerance_ns)
    return caught.value


class TestLookup:
    def test_direction_is_target_from_source(self) -> None:
        buffer = built(static=[row("base", "lidar", 0, x=1, yaw=math.pi / 2)])
        forward = np.array([[2.0, 0.0, 0.0]])
        np.testing.assert_allclose(buffer.lookup("base", "lidar", 1).apply(forward), [[1, 2, 0]], atol=1e-15)
        np.testing.assert_allclose(
            buffer.lookup("lidar", "base", 1).apply(np.array([[1.0, 2.0, 0.0]])), forward, atol=1e-15
        )

    def test_between_samples_translation_is_lerp_and_rotation_slerp(self) -> None:
        buffer = built([row("odom", "base", 10, x=1, yaw=0.2), row("odom", "base", 12, x=5, yaw=1.0)])
        found = buffer.lookup("odom", "base", at(10.5))
        np.testing.assert_allclose(found.translation, [2, 0, 0], atol=1e-15)
        np.testing.assert_allclose(found.matrix, Rigid.from_rpy(0, 0, 0.4).matrix, atol=1e-15)

    def test_a_nanosecond_counts(self) -> None:
        buffer = built([row("odom", "base", 0, x=0), row("odom", "base", 1, x=1e9)])
        assert x_of(buffer, "odom", "base", at(0.5) + 1) == pytest.approx(500_000_001, abs=1e-3)

    def test_the_ratio_is_that_of_seconds_in_float64(self) -> None:
        # 1e-9 times 3 is not 3e-9: what tf2 returns, in tests/parity too.
        buffer = built([row("odom", "base", 0, x=0), ("odom", "base", EPOCH + 7, 1.0, 0, 0, 0, 0, 0, 1)])
        found = x_of(buffer, "odom", "base", EPOCH + 3)
        assert found == (1e-9 * 3) / (1e-9 * 7) != 3 / 7

    def test_the_first_and_the_last_sample_are_given_as_they_are(self) -> None:
        rows = [row("odom", "base", second, x=0.1 * second, yaw=0.3 * second) for second in range(5)]
        buffer = built(rows)
        for entry in (rows[0], rows[-1]):
            assert buffer.lookup("odom", "base", entry[2]).pose == entry[3:]
        # Those between them with the ratio 0, which tf2's slerp may round away from them.
        for entry, after in pairwise(rows[1:]):
            found = buffer.lookup("odom", "base", entry[2]).pose
            assert found == interpolate_poses(entry[3:], after[3:], 0.0)
            assert found == pytest.approx(entry[3:], rel=1e-15)

    def test_up_and_down_again(self) -> None:
        buffer = built(
            [row("odom", "base", second, x=second) for second in (0, 10)],
            [row("base", "left", 0, x=1), row("base", "mount", 0, x=2), row("mount", "right", 0, x=4)],
        )
        assert x_of(buffer, "odom", "right", at(5)) == pytest.approx(11)
        assert x_of(buffer, "left", "right", at(5)) == pytest.approx(5)
        assert x_of(buffer, "right", "left", at(5)) == pytest.approx(-5)
        assert x_of(buffer, "right", "odom", at(5)) == pytest.approx(-11)

    def test_above_the_common_ancestor_nothing_need_be_known(self) -> None:
        buffer = built([row("odom", "base", 0)], [row("base", "left", 0, x=1), row("base", "right", 0, x=2)])
        assert x_of(buffer, "left", "right", at(1000)) == 1

    def test_static_holds_at_any_time_and_the_last_one_counts(self) -> None:
        buffer = built(static=[row("a", "b", 50, x=1), row("c", "b", 40, x=2)])
        assert [x_of(buffer, "c", "b", stamp_ns) for stamp_ns in (1, at(0), at(99))] == [2, 2, 2]
        # As in tf2 the parent of the overwritten one is known, but connected to nothing.
        assert "not part of the same tree" in refusal(buffer, "a", "b", at(0)).message

    def test_one_leading_slash_is_stripped_everywhere(self) -> None:
        buffer = built([row("/odom", "//base", 0, x=3)])
        assert buffer.frames == ("odom", "/base")
        assert x_of(buffer, "/odom", "//base", at(0)) == 3

    def test_equal_names_are_the_identity_known_or_not(self) -> None:
        assert built().lookup("any", "/any", 0).pose == Rigid.identity().pose

    def test_order_of_arrival_does_not_matter_and_of_equal_stamps_the_first_is_kept(self) -> None:
        buffer = built([row("a", "b", second, x=x) for second, x in [(3, 3), (1, 1), (2, 2), (1, 9), (3, 9)]])
        assert [x_of(buffer, "a", "b", at(second)) for second in (1, 1.5, 2, 3)] == [1, 1.5, 2, 3]
        (info,) = buffer.infos
        assert (info.transforms, info.received) == (3, 5)

    def test_a_new_parent_holds_from_its_first_sample_on(self) -> None:
        buffer = built([row("a", "b", 1, x=1), row("c", "b", 3, x=5), row("c", "b", 5, x=7)])
        assert x_of(buffer, "a", "b", at(2.9)) == 1
        assert x_of(buffer, "c", "b", at(3)) == 5
        assert x_of(buffer, "c", "b", at(4)) == 6
        assert "at this time [a] leads up to [a], [b] to [c]" in refusal(buffer, "a", "b", at(3)).message

    def test_what_comes_first_decides_whether_a_frame_is_static(self) -> None:
        builder = TransformBuilder()
        builder.add([row("a", "b", 1, x=1)], static=False)
        builder.add([row("a", "b", 3, x=3)], static=True)
        buffer = builder.build()
        assert x_of(buffer, "a", "b", at(2)) == 2
        assert "extrapolation" in refusal(buffer, "a", "b", at(4)).message

        builder = TransformBuilder()
        builder.add([row("a", "b", 1, x=math.nan)], static=False)  # rejected, so it decides nothing
        builder.add([row("a", "b", 3, x=3)], static=True)
        builder.add([row("a", "b", 2, x=2)], static=False)
        assert x_of(builder.build(), "a", "b", at(9)) == 2

    def test_a_stamp_of_zero_asks_for_the_latest_common_time(self) -> None:
        buffer = built(
            [row("map", "odom", second, x=10 * second) for second in range(4)]
            + [row("odom", "base", second / 2, x=second / 2) for second in range(12)],
            [row("base", "lidar", 99, x=100)],
        )
        assert x_of(buffer, "map", "lidar", 0) == 133
        assert x_of(buffer, "odom", "lidar", 0) == 105.5
        assert x_of(buffer, "base", "lidar", 0) == 100

    def test_negative_stamps_are_times_like_others(self) -> None:
        buffer = built([("a", "b", stamp_ns, *Rigid.identity().pose) for stamp_ns in (-5, 5)])
        assert x_of(buffer, "a", "b", -5) == 0
        assert "from -0.000000005 to 0.000000005" in refusal(buffer, "a", "b", -6).message


class TestTolerance:
    BUFFER = built(
        [row("odom", "base", second, x=second) for second in (1, 2, 3)]
        + [row("base", "lidar", second, x=10 * second) for second in (1.2, 2.8)]
    )

    @pytest.mark.parametrize(
        ("second", "tolerance", "expected"),
        [
            (2, 0, 22),  # known
            (2.8, 0, 30.8),
            (2.9, 0.1, 30.9),  # the lidar's last, the base interpolated
            (3.1, 0.3, 31),  # both their last
            (1, 0.2, 13),
            (0.9, 0.3, 13),
        ],
    )
    def test_each_frame_of_the_chain_is_clamped_for_itself(
        self, second: float, tolerance: float, expected: float
    ) -> None:
        found = x_of(self.BUFFER, "odom", "lidar", at(second), round(tolerance * SECOND))
        assert found == pytest.approx(expected)

    @pytest.mark.parametrize(("second", "gap"), [(2.8 + 0.1, 0.1), (1.2 - 0.1, 0.1), (3.5, 0.7), (0.5, 0.7)])
    def test_one_nanosecond_less_is_refused(self, second: float, gap: float) -> None:
        tolerance_ns = round(gap * SECOND)
        self.BUFFER.lookup("odom", "lidar", at(second), tolerance_ns)
        message = refusal(self.BUFFER, "odom", "lidar", at(second), tolerance_ns - 1).message
        assert f"the time is {gap:.9f} s too {'late' if second > 2 else 'early'}" in message

    def test_changes_nothing_that_is_known_without_it(self) -> None:
        # b hangs below a until 1, a below b from 2 on: with a tolerance both ends would be known at 1.
        buffer = built([row("a", "b", 0, x=1), row("a", "b", 1, x=1), row("b", "a", 2, x=2), row("b", "a", 3, x=2)])
        assert x_of(buffer, "a", "b", at(1), SECOND) == 1
        assert x_of(buffer, "a", "b", at(2), SECOND) == -2

    def test_holds_for_children_with_several_parents(self) -> None:
        buffer = built([row("a", "b", 1, x=1), row("c", "b", 2, x=2)])
        assert x_of(buffer, "a", "b", at(0.9), SECOND // 10) == 1
        assert x_of(buffer, "c", "b", at(2.1), SECOND // 10) == 2
        assert "too late" in refusal(buffer, "c", "b", at(2.2), SECOND // 10).message


class TestRefusal:
    def test_unknown_frame_names_the_ones_there_are(self) -> None:
        error = refusal(built(static=[row("base", "lidar", 0)]), "base", "velodyne", at(1))
        assert error.message == (
            '"velodyne" passed to lookupTransform argument source_frame does not exist. '
            "The 2 frames with transforms are base, lidar"
        )
        assert error.stamp_ns == at(1)
        assert "`source_frame`" in str(error.hint)

    def test_unknown_target(self) -> None:
        assert '"map" passed to lookupTransform argument target_frame' in str(
            refusal(built(static=[row("base", "lidar", 0)]), "map", "lidar", at(1))
        )

    def test_names_are_not_endless(self) -> None:
        buffer = built(static=[row("base", f"f{number:03}", 0) for number in range(100)])
        message = refusal(buffer, "base", "x", at(1)).message
        assert message.count(",") == MAX_NAMES - 1
        assert message.endswith("f018 and 81 more")

    def test_no_transforms_at_all(self) -> None:
        assert "There are no transforms" in refusal(built(), "a", "b", at(1)).message

    def test_unknown_for_having_been_rejected(self) -> None:
        buffer = built([row("odom", "base", 0), row("base", "lidar", 0, norm=0)])
        assert refusal(buffer, "odom", "lidar", at(0)).message.endswith(
            "; [lidar] in [base] was rejected: TF_DENORMALIZED_QUATERNION: the quaternion is zero"
        )

    @pytest.mark.parametrize("names", [("", "a"), ("a", ""), ("", ""), ("/", "a")])
    def test_empty_names(self, names: tuple[str, str]) -> None:
        assert "cannot be empty" in refusal(built(static=[row("a", "b", 0)]), *names, at(0)).message

    def test_not_connected_describes_both_trees(self) -> None:
        buffer = built(static=[row("map", "odom", 0), row("base", "lidar", 0), row("base", "imu", 0)])
        error = refusal(buffer, "odom", "lidar", at(0))
        assert error.message == (
            "Could not find a connection between 'odom' and 'lidar' because they are not part of the same "
            "tree. Tf has two or more unconnected trees: [odom] is in the tree of [map] (map, odom), "
            "[lidar] in the tree of [base] (base, imu, lidar)"
        )

    def test_too_late(self) -> None:
        buffer = built([row("odom", "base", second) for second in (1, 2)], [row("base", "lidar", 0)])
        assert refusal(buffer, "odom", "lidar", at(2.25), SECOND // 100).message == (
            "Lookup would require extrapolation 0.250000000s into the future. Requested time "
            "1700000002.250000000 but the latest data is at time 1700000002.000000000, when looking up "
            "transform from frame [lidar] to frame [odom]: [base] in [odom] is known from "
            "1700000001.000000000 to 1700000002.000000000, the time is 0.250000000 s too late, the "
            "tolerance is 0.010000000 s"
        )

    def test_too_early(self) -> None:
        error = refusal(built([row("odom", "base", second) for second in (1, 2)]), "odom", "base", at(0.5))
        assert "0.500000000s into the past" in error.message
        assert "earliest data is at time 1700000001.000000000" in error.message
        assert "0.500000000 s too early" in error.message
        assert "at least 0.500000000 s" in str(error.hint)

    def test_only_one_sample(self) -> None:
        message = refusal(built([row("odom", "base", 1)]), "odom", "base", at(2)).message
        assert "at time 1700000002.000000000, but only time 1700000001.000000000 is in the buffer" in message

    def test_of_several_frames_the_farthest_is_named(self) -> None:
        buffer = built([row("a", "b", 5), row("b", "c", 1), row("c", "d", 3)])
        assert "[c] in [b] is known" in refusal(buffer, "a", "d", at(6)).message

    def test_loops(self) -> None:
        edges = [("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")]
        buffer = built(static=[row(parent, child, 0) for parent, child in edges])
        for target, source in [("a", "b"), ("b", "a"), ("a", "d"), ("d", "c")]:
            assert "contains a loop" in refusal(buffer, target, source, at(0)).message
            assert "contains a loop" in refusal(buffer, target, source, 0).message
        assert "[d] to frame [a]: [c] in [b] in [a] in [c]" in refusal(buffer, "a", "d", at(0)).message

    def test_two_frames_in_each_other(self) -> None:
        buffer = built([row(*pair, second) for second in (0, 1) for pair in (("a", "b"), ("b", "a"))])
        assert "[b] in [a] in [b]" in refusal(buffer, "a", "b", at(0.5)).message


class TestRejections:
    GOOD = row("odom", "base", 0, x=1)

    @pytest.mark.parametrize(
        ("entry", "reason"),
        [
            (row("a", "a", 7), "TF_SELF_TRANSFORM"),
            (row("/a", "a", 7), "TF_SELF_TRANSFORM"),
            (row("a", "", 7), "TF_NO_CHILD_FRAME_ID"),
            (row("", "a", 7), "TF_NO_FRAME_ID"),
            (row("/", "a", 7), "TF_NO_FRAME_ID"),
            (row("", "", 7), "TF_NO_CHILD_FRAME_ID"),
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
        assert rejection == Rejection(
            entry[1].removeprefix("/"), entry[0].removeprefix("/"), at(7), rejection.reason, 2
        )
        assert buffer.rejected == 2
        assert buffer.frames == ("odom", "base")
        assert x_of(buffer, "odom", "base", at(0)) == 1

    def test_a_nan_that_signals_is_a_nan_like_any_other(self) -> None:
        (signalling,) = struct.unpack("<d", bytes.fromhex("010000000000f47f"))
        entry = (*row("a", "b", 7)[:-1], signalling)
        (rejection,) = built([self.GOOD, entry]).rejections
        assert rejection.reason.startswith("TF_NAN_INPUT: ")

    @pytest.mark.parametrize("norm", [1.0, 1.001, 0.998, -1.0])
    def test_quaternions_that_tf2_takes_stay_as_they_are(self, norm: float) -> None:
        entry = row("a", "b", 0, yaw=0.5, norm=norm)
        buffer = built([entry])
        assert buffer.rejected == 0
        assert buffer.lookup("a", "b", at(0)).quaternion.tolist() == list(entry[6:])

    @pytest.mark.parametrize("norm", [2.0, 1e-200, 1e200, 1.006, 0.994])
    def test_quaternions_that_tf2_refuses_are_refused(self, norm: float) -> None:
        buffer = built([self.GOOD, row("a", "b", 0, yaw=0.5, norm=norm)])
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


class TestInfos:
    def test_dynamic_static_and_changing_frames(self) -> None:
        buffer = built(
            [row("odom", "base", second) for second in (0, 1, 2, 5, 6, 6)]
            + [row("odom", "cart", 3), row("base", "cart", 1), row("base", "cart", 2)],
            [row("base", "lidar", 4), row("base", "lidar", 9)],
        )
        base, cart, lidar = buffer.infos
        assert base == FrameInfo(
            child="base",
            parents=("odom",),
            static=False,
            transforms=5,
            received=6,
            first_ns=at(0),
            last_ns=at(6),
            rate_hz=4 * 1e9 / (6 * SECOND),
            largest_gap_ns=3 * SECOND,
            largest_gap_at_ns=at(2),
        )
        assert (cart.parents, cart.transforms) == (("base", "odom"), 3)
        assert (lidar.static, lidar.transforms, lidar.received, lidar.first_ns) == (True, 1, 2, at(9))
        assert (lidar.rate_hz, lidar.largest_gap_ns, lidar.largest_gap_at_ns) == (None, None, None)

    def test_trees(self) -> None:
        buffer = built(
            [row("map", "base", 0), row("odom", "base", 1), row("x", "y", 0), row("y", "x", 0)],
            [row("base", "lidar", 0), row("world", "camera", 0)],
        )
        assert buffer.trees == (
            Tree(roots=("map", "odom"), frames=("base", "lidar", "map", "odom")),
            Tree(roots=("world",), frames=("camera", "world")),
            Tree(roots=(), frames=("x", "y")),
        )

    def test_nothing(self) -> None:
        buffer = built()
        assert (buffer.infos, buffer.trees, buffer.frames, len(buffer)) == ((), (), (), 0)

    def test_history(self) -> None:
        buffer = built([row("a", "b", second, x=second) for second in (2, 1)], [row("b", "c", 0)])
        history = buffer.history("/b")
        assert history is not None
        assert history.stamps_ns.tolist() == [at(1), at(2)]
        assert history.translations.tolist() == [[1, 0, 0], [2, 0, 0]]
        assert history.quaternions.tolist() == [[0, 0, 0, 1]] * 2
        assert [buffer.frames[parent] for parent in history.parents] == ["a", "a"]
        assert history.stamps_ns.dtype == np.int64
        assert history.parents.dtype == np.int32
        assert buffer.history("a") is None
        assert buffer.history("unknown") is None


class TestBuffer:
    def test_is_frozen(self) -> None:
        buffer = built([row("a", "b", 0)])
        with pytest.raises(FrozenInstanceError):
            buffer.frames = ()  # type: ignore[misc]
        history = buffer.history("b")
        assert history is not None
        for values in (history.stamps_ns, history.poses, history.parents):
            with pytest.raises(ValueError, match="read-only"):
                values[0] = 0

    def test_travels_to_other_processes(self) -> None:
        buffer = built([row("a", "b", 0, x=1), row("a", "b", 2, x=3)])
        assert x_of(buffer, "a", "b", at(1)) == 2
        assert x_of(pickle.loads(pickle.dumps(buffer)), "a", "b", at(1)) == 2

    def test_builder_goes_on_after_building(self) -> None:
        builder = TransformBuilder()
        builder.add([row("a", "b", 0, x=1)], static=False)
        first = builder.build()
        builder.add([row("a", "b", 2, x=3)], static=False)
        second = builder.build()
        assert (len(first), len(second), len(builder)) == (1, 2, 2)
        assert x_of(second, "a", "b", at(1)) == 2
        assert "extrapolation" in refusal(first, "a", "b", at(1)).message

    @pytest.mark.parametrize("norm", [1.0049, 0.9951])
    def test_rotations_that_grow_beyond_all_bounds_are_no_crash(self, norm: float) -> None:
        # tf2 never normalises: of thousands of frames, each a little off, comes what no float32 or float64 holds.
        for depth in (18_000, 80_000):
            builder = TransformBuilder()
            builder.add((row(f"f{n}", f"f{n + 1}", 0, x=1, yaw=0.1, norm=norm) for n in range(depth)), static=True)
            for names in (("f0", f"f{depth}"), (f"f{depth}", "f0")):
                found = builder.build().lookup(*names, at(5))
                found.as_float32()
                assert len(found.rpy) == 3
                assert found.apply(np.ones((2, 3), np.float32)).shape == (2, 3)

    def test_a_very_deep_chain_neither_recurses_nor_stops(self) -> None:
        depth = 99_999
        builder = TransformBuilder()
        builder.add((row(f"f{n}", f"f{n + 1}", 0, x=1) for n in range(depth)), static=True)
        buffer = builder.build()
        assert x_of(buffer, "f0", f"f{depth}", at(5)) == depth
        assert x_of(buffer, f"f{depth}", "f0", at(5)) == -depth
        (tree,) = buffer.trees
        assert (tree.roots, len(tree.frames)) == (("f0",), depth + 1)

    def test_more_frames_than_a_robot_has_are_refused(self) -> None:
        builder = TransformBuilder()
        with pytest.raises(RecordingError, match="more than 100,000 frames"):
            builder.add((row(f"f{n}", f"f{n + 1}", 0) for n in range(100_000)), static=True)

    def test_more_pairs_of_frames_than_a_robot_has_are_refused(self) -> None:
        builder = TransformBuilder()
        with pytest.raises(RecordingError, match="200,000 pairs"):
            builder.add((row(f"f{n % 500}", f"g{n // 500}", n) for n in range(200_001)), static=False)

    @given(
        stamps=st.lists(st.integers(1, 60), min_size=1, max_size=25),
        asked=st.lists(st.integers(0, 61 * 4), min_size=1, max_size=10),
        tolerance_ns=st.integers(0, 3 * SECOND),
    )
    def test_follows_a_scalar_reference(self, stamps: list[int], asked: list[int], tolerance_ns: int) -> None:
        rows = [row("a", "b", stamp, x=n, yaw=0.3 * n) for n, stamp in enumerate(stamps)]
        buffer = built(rows)
        kept: dict[int, Rigid] = {}
        for entry in rows:
            kept.setdefault(entry[2], Rigid.from_pose(entry[3:]))
        known = sorted(kept)
        for quarter in asked:
            stamp_ns = at(quarter / 4)
            clamped = min(max(stamp_ns, known[0]), known[-1])
            if abs(stamp_ns - clamped) > tolerance_ns:
                refusal(buffer, "a", "b", stamp_ns, tolerance_ns)
                continue
            older = known[bisect_right(known, clamped) - 1]
            newer = known[min(bisect_right(known, clamped), len(known) - 1)]
            ratio = (clamped - older) / (newer - older) if newer > older else 0.0
            expected = interpolate(kept[older], kept[newer], ratio)
            found = buffer.lookup("a", "b", stamp_ns, tolerance_ns)
            np.testing.assert_allclose(found.translation, expected.translation, atol=1e-12)
            np.testing.assert_allclose(found.matrix, expected.matrix, atol=1e-12)
            back = buffer.lookup("b", "a", stamp_ns, tolerance_ns)
            np.testing.assert_allclose(found.compose(back).matrix, np.eye(3), atol=1e-12)
            np.testing.assert_allclose(found.compose(back).translation, 0, atol=1e-12)


@pytest.mark.parametrize("case", ["tf_static", "tf_dynamic", "scan_tf"])
def test_golden_cases_resolve(case: str) -> None:
    from rosbags.rosbag1 import Reader
    from ruamel.yaml import YAML

    from pc2scan.messages.wire import Cursor

    (section,) = YAML(typ="safe").load(GOLDEN / case / "params.yaml").values()
    target = section["ros__parameters"]["target_frame"]
    with Reader(GOLDEN / case / "input.bag") as reader, Reader(GOLDEN / case / "expected.bag") as expected:
        builder = TransformBuilder()
        clouds = []
        for connection, _, data in reader.messages():
            if connection.topic in {"/tf", "/tf_static"}:
                builder.add(decode_transforms(data, "ros1"), static=connection.topic == "/tf_static")
            else:
                clouds.append(Cursor(data, "ros1").header())
        converted = {Cursor(data, "ros1").header()[1] for _, _, data in expected.messages()}
    buffer = builder.build()
    assert buffer.rejected == 0
    found = set()
    for _, stamp_ns, frame in clouds:
        try:
            buffer.lookup(target, frame, stamp_ns, 10_000_000)
        except TransformError:
            continue
        found.add(stamp_ns)
    # The messages that upstream converted are those that resolve here, neither more nor fewer.
    assert found == converted
    assert converted

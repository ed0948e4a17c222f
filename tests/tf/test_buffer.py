"""The transform buffer's rules, one by one; tests/tf/test_tf2_agreement.py holds them to tf2 itself."""

from __future__ import annotations

import math
import pickle
from bisect import bisect_right
from dataclasses import FrozenInstanceError
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.core.rigid import Rigid, interpolate, interpolate_poses
from pc2scan.errors import TransformError
from pc2scan.messages.tfmessage import decode_transforms
from pc2scan.tf.builder import TransformBuilder
from support import GOLDEN
from tf.small_buffers import EPOCH, SECOND, at, built, refusal, row, x_of


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

    def test_how_long_it_interpolates(self) -> None:
        moving = [row("odom", "base", second, x=second) for second in (10, 12, 13)]
        buffer = built([*moving, row("base", "arm", 10, x=0), row("base", "arm", 12.5, x=0)])
        found = [buffer.between_ns("odom", "base", at(second), SECOND) for second in (9.5, 10, 11, 12, 12.4, 13, 13.5)]
        assert found == [0, 0, 2 * SECOND, 0, SECOND, 0, 0]
        assert buffer.between_ns("arm", "odom", at(12.4)) == 2.5 * SECOND
        assert buffer.between_ns("odom", "base", 0) == buffer.between_ns("odom", "odom", at(11)) == 0
        with pytest.raises(TransformError):
            buffer.between_ns("odom", "base", at(9.5))

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
        assert "no transforms connect" in refusal(buffer, "a", "b", at(0)).message

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
        assert "is not known at" in refusal(buffer, "a", "b", at(4)).message

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


class TestBuffer:
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

"""Transforms as they are collected: in memory and in a temporary file they are the same."""

from __future__ import annotations

import errno
import math
import os
import pickle
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.errors import RecordingError, TransformError
from pc2scan.tf import builder, stored
from pc2scan.tf.builder import TransformBuilder
from pc2scan.tf.history import Samples
from tf.small_buffers import EPOCH, SECOND, at, row, x_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pc2scan.core.rigid import TransformRow
    from pc2scan.tf.buffer import TransformBuffer

#: Transforms in the order of their arrival, and whether they are static.
Arrivals = list[tuple["TransformRow", bool]]


def collected(arrivals: Iterable[tuple[TransformRow, bool]], most: int, removed: Iterable[str] = ()) -> TransformBuffer:
    """Collect transforms of which so many are in memory at most, in runs of three, and a few are read at a time."""
    with (
        mock.patch.multiple(builder, MOST_IN_MEMORY=most, _AT_ONCE=5),
        mock.patch.multiple(stored, _RUN=3, _PART=4, _NEAR=1),
    ):
        made = TransformBuilder()
        for entry, static in arrivals:
            made.add([entry], static=static)
        made.remove(list(removed))
        return made.build()


@st.composite
def arrivals(draw: st.DrawFn) -> Arrivals:
    rows: Arrivals = []
    for number in range(draw(st.integers(1, 60))):
        parent, child = draw(
            st.sampled_from([("a", "b"), ("a", "c"), ("/b", "c"), ("b", "/c"), ("c", "a"), ("a", "a")])
        )
        # Most come in the order of their stamps, some late, or twice.
        stamp = number + draw(st.sampled_from([0, 0, 0, 0, -1, -7, 5]))
        norm = draw(st.sampled_from([1.0] * 9 + [0.0]))
        rows.append(
            (row(parent, child, stamp, x=number, yaw=0.1 * number, norm=norm), draw(st.booleans()) and number < 6)
        )
    return rows


def expected(arrivals: Arrivals, removed: Iterable[str]) -> dict[str, list[tuple[int, str, tuple[float, ...]]]]:
    """Return the stamps, parents and poses of each child as tf2 keeps them, by plain lists."""
    good = [
        (child[-1], (stamp_ns, parent[-1], tuple(pose)), static)
        for (parent, child, stamp_ns, *pose), static in arrivals
        if child[-1] not in removed and parent != child and any(pose[3:])
    ]
    kept = {}
    for child, group in groupby(sorted(good, key=itemgetter(0)), key=itemgetter(0)):
        entries = list(group)
        if entries[0][2]:
            kept[child] = [entries[-1][1]]
            continue
        first: dict[int, tuple[int, str, tuple[float, ...]]] = {}
        for _, entry, _ in entries:
            first.setdefault(entry[0], entry)
        kept[child] = [first[stamp_ns] for stamp_ns in sorted(first)]
    return kept


def kept(buffer: TransformBuffer) -> dict[str, list[tuple[int, str, tuple[float, ...]]]]:
    found = {}
    for child in buffer.frames:
        if (history := buffer.history(child)) is not None:
            found[child] = [
                (stamp_ns, buffer.frames[parent], tuple(pose))
                for part in history.parts()
                for stamp_ns, parent, pose in zip(
                    part.stamps_ns.tolist(), part.parents.tolist(), part.poses.tolist(), strict=True
                )
            ]
    return found


def answer(buffer: TransformBuffer, target: str, source: str, stamp_ns: int, tolerance_ns: int) -> object:
    try:
        return (
            buffer.lookup(target, source, stamp_ns, tolerance_ns).pose,
            buffer.between_ns(target, source, stamp_ns, tolerance_ns),
        )
    except TransformError as err:
        return err.message


def sampled(buffer: TransformBuffer, target: str, source: str, begin_ns: int, end_ns: int) -> object:
    try:
        stamps, rows, gap_ns = buffer.rows(target, source, begin_ns, end_ns, SECOND // 2, lambda *_: SECOND // 3)
    except TransformError as err:
        return err.message
    return stamps.tobytes(), rows.tobytes(), gap_ns


@given(arrivals(), st.sets(st.sampled_from("abc"), max_size=1), st.integers(0, 40), st.data())
def test_transforms_in_a_file_are_those_in_memory(
    rows: Arrivals, removed: set[str], most: int, data: st.DataObject
) -> None:
    whole, buffer = collected(rows, 1_000, removed), collected(rows, most, removed)
    assert kept(whole) == kept(buffer) == expected(rows, removed)
    for made in (whole, buffer):
        assert (made.frames, made.rejections, made.rejected) == (whole.frames, whole.rejections, whole.rejected)
        assert (made.infos, made.trees, len(made)) == (whole.infos, whole.trees, sum(map(len, kept(whole).values())))
    with mock.patch.multiple(stored, _RUN=3, _PART=4, _NEAR=1):
        for child in kept(whole):
            one, other = whole.history(child), buffer.history(child)
            assert isinstance(one, Samples)
            assert other is not None
            assert (one.size, one.sole_parent, one.extent.tolist()) == (
                other.size,
                other.sole_parent,
                other.extent.tolist(),
            )
            chosen = np.array(data.draw(st.lists(st.integers(0, one.size - 1), max_size=9)), np.intp)
            assert one.poses_of(chosen).tolist() == other.poses_of(chosen).tolist()
            assert one.all_stamps().tolist() == other.all_stamps().tolist()
        # What one lookup has read is used by the next.
        for _ in range(10):
            names = data.draw(st.sampled_from(["ab", "ba", "bc", "ca", "ac"]))
            quarter, length = data.draw(st.integers(-8, 260)), data.draw(st.integers(0, 40))
            question = (*names, at(quarter / 4), data.draw(st.integers(0, 3)) * SECOND)
            assert answer(whole, *question) == answer(buffer, *question)
            asked = (*names, at(quarter / 4), at((quarter + length) / 4))
            assert sampled(whole, *asked) == sampled(buffer, *asked)
    # In another process, there is no file.
    assert kept(pickle.loads(pickle.dumps(buffer))) == kept(whole)


def test_more_are_added_after_transforms_were_looked_up() -> None:
    with mock.patch.object(builder, "MOST_IN_MEMORY", 100):
        made = TransformBuilder()
        made.add_poses("odom", "base", np.arange(EPOCH, EPOCH + 300), np.tile([1.0, 0, 0, 0, 0, 0, 1], (300, 1)))
        first = made.build()
        made.add((row("odom", "base", second, x=second) for second in range(1, 200)), static=False)
        made.add_poses("map", "odom", np.array([at(0), at(9)]), np.tile([2.0, 0, 0, 0, 0, 0, 1], (2, 1)))
        second = made.build()
    assert (len(first), len(second)) == (300, 501)
    assert x_of(first, "odom", "base", 0) == 1
    assert x_of(second, "odom", "base", 0) == 199
    assert x_of(second, "map", "base", at(4)) == 6
    assert made.parents_of({"base", "odom", "lidar"}) == {"base": "odom", "odom": "map"}


def test_few_transforms_touch_no_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored, "TransformFile", None)
    made = TransformBuilder()
    stamps = EPOCH + np.arange(builder.MOST_IN_MEMORY)
    made.add_poses("odom", "base", stamps, np.tile([1.0, 0, 0, 0, 0, 0, 1], (len(stamps), 1)))
    assert len(made.build()) == len(stamps)
    with pytest.raises(TypeError, match="not callable"):
        made.add([row("odom", "base", n) for n in range(10_000)], static=False)


def test_a_full_temporary_folder_is_an_error_with_a_hint(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(stored, "write_at", full)
    monkeypatch.setattr(builder, "MOST_IN_MEMORY", 10)
    made = TransformBuilder()
    with pytest.raises(RecordingError, match=r"temporary file in .*: No space left") as caught:
        made.add_poses("odom", "base", EPOCH + np.arange(20), np.tile([1.0, 0, 0, 0, 0, 0, 1], (20, 1)))
    assert "TMPDIR" in (caught.value.hint or "")


def test_a_window_has_the_neighbours_of_its_ends() -> None:
    rows = [(row("odom", "base", second, x=second, yaw=0.3 * second), False) for second in range(40)]
    history = collected(rows, 10).history("base")
    assert history is not None
    with mock.patch.multiple(stored, _RUN=3, _PART=4):
        for begin, end in ((-1, -1), (0, 0), (2.5, 3), (3, 3), (6, 14), (38.5, 38.5), (39, 39), (50, 60), (-5, 50)):
            near = history.near(at(begin), at(end))
            assert near.first_ns < at(begin) or near.first_ns == at(0)
            assert near.last_ns > at(end) or near.last_ns == at(39)
            assert near.size <= math.ceil(max(0, min(end, 39) - max(begin, 0))) + 8

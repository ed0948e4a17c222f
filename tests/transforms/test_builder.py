"""Transforms as they are collected, against plain lists."""

from __future__ import annotations

import pickle
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pc2scan.transforms import builder
from pc2scan.transforms.builder import TransformBuilder
from transforms.small_buffers import EPOCH, at, row, x_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pc2scan.core.rigid import TransformRow
    from pc2scan.transforms.buffer import TransformBuffer

#: Transforms in the order of their arrival, and whether they are static.
Arrivals = list[tuple["TransformRow", bool]]


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
                for stamp_ns, parent, pose in zip(
                    history.stamps_ns.tolist(), history.parents.tolist(), history.poses.tolist(), strict=True
                )
            ]
    return found


@pytest.mark.parametrize("at_once", [1, 5, 100])
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50)
@given(arrivals(), st.sets(st.sampled_from("abc"), max_size=1), st.integers(0, 60))
def test_what_is_collected_is_what_tf2_keeps(
    monkeypatch: pytest.MonkeyPatch, at_once: int, rows: Arrivals, removed: set[str], looked_up: int
) -> None:
    monkeypatch.setattr(builder, "_AT_ONCE", at_once)
    made = TransformBuilder()
    for number, (entry, static) in enumerate(rows):
        made.add([entry], static=static)
        if number == looked_up:
            made.build()
    made.remove(list(removed))
    buffer = made.build()
    assert kept(buffer) == kept(pickle.loads(pickle.dumps(buffer))) == expected(rows, removed)
    assert len(buffer) == sum(map(len, kept(buffer).values()))
    # Frames that were removed, and those of rejected transforms alone, are not there.
    good = [entry[:2] for entry, _ in rows if entry[1][-1] not in removed and entry[0] != entry[1] and any(entry[6:10])]
    assert set(buffer.frames) == {name[-1] for pair in good for name in pair}
    assert not made.parents_of(removed)
    for child in kept(buffer):
        history = buffer.history(child)
        assert history is not None
        parents = [parent for _, parent, _ in kept(buffer)[child]]
        assert [buffer.frames[parent] for parent in history.all_parents()] == list(dict.fromkeys(parents))
        assert (history.sole_parent < 0) == (len(set(parents)) > 1)


def test_more_are_added_after_transforms_were_looked_up() -> None:
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

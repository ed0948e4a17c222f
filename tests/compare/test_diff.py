"""Which messages of two recordings belong together."""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pc2scan.compare.diff import Match, TopicStream, match_messages
from pc2scan.compare.scan_text import ScanText
from pc2scan.messages.wire import Packer
from pc2scan.model import Connection, RawMessage

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

CONNECTION = Connection(0, "/scan", "sensor_msgs/msg/LaserScan", "cdr")


def header(stamp_ns: int) -> bytes:
    packer = Packer("cdr")
    packer.header(0, stamp_ns, "laser")
    return packer.finish()


def stream(stamps: Sequence[int | None], times: Sequence[int] = ()) -> TopicStream:
    """Messages by their stamps (None: no header can be read); ``sequence`` is the place of each."""
    places = count()
    content = [
        RawMessage(CONNECTION, time, b"\0\1" if stamp is None else header(stamp), time, next(places))
        for time, stamp in zip(times or range(100, 100 + len(stamps)), stamps, strict=True)
    ]
    return TopicStream(ScanText(Path("made"), [CONNECTION], content), (CONNECTION,))


def places(matches: Iterator[Match]) -> list[tuple[int | None, int | None, bool]]:
    return [(m.a.sequence if m.a else None, m.b.sequence if m.b else None, m.moved) for m in matches]


STAMPS = st.lists(st.integers(1, 6), max_size=12) | st.permutations(range(1, 9))


@given(STAMPS, STAMPS)
def test_every_message_once_with_the_partner_of_its_stamp(a: list[int], b: list[int]) -> None:
    found = places(match_messages(stream(a), stream(b)))
    assert [i for i, _, _ in found if i is not None] == list(range(len(a)))
    assert sorted(j for _, j, _ in found if j is not None) == list(range(len(b)))
    pairs = [(i, j, moved) for i, j, moved in found if i is not None and j is not None]
    assert len(pairs) == sum((Counter(a) & Counter(b)).values())
    # Of repeated stamps the first belongs to the first.
    in_a, in_b = ({s: [k for k, v in enumerate(side) if v == s] for s in set(side)} for side in (a, b))
    by_stamp: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
    for i, j, _ in pairs:
        assert a[i] == b[j]
        by_stamp[a[i]].append((i, j))
    for stamp, found_pairs in by_stamp.items():
        assert found_pairs == list(zip(in_a[stamp], in_b[stamp], strict=False))
    # What has moved comes before the partner of an earlier message, and the others are in order.
    assert [moved for _, _, moved in pairs] == [
        j < max(k for _, k, _ in pairs[: n + 1]) for n, (_, j, _) in enumerate(pairs)
    ]


@pytest.mark.parametrize(
    ("a", "b", "pairs"),
    [
        # Without a stamp by log time. The second is missing: those after it keep their partners all the same.
        (stream([0, 0, 0, 0], [10, 20, 30, 40]), stream([0, 0, 0], [10, 30, 40]), {(0, 0), (1, None), (2, 1), (3, 2)}),
        (stream([None, None], [1, 2]), stream([None, None], [1, 2]), {(0, 0), (1, 1)}),
        # A stamp is no log time.
        (stream([0], [500]), stream([500], [500]), {(0, None), (None, 0)}),
        # Equal log times are told apart when a message has moved.
        (stream([1, 2, 3], [5, 5, 5]), stream([3, 1, 2], [5, 5, 5]), {(0, 1), (1, 2), (2, 0)}),
    ],
)
def test_stamps_and_log_times(a: TopicStream, b: TopicStream, pairs: set[tuple[int | None, int | None]]) -> None:
    assert {(i, j) for i, j, _ in places(match_messages(a, b))} == pairs

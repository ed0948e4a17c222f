"""The note of a damaged chunk."""

from __future__ import annotations

from pathlib import Path

import pytest

from pc2scan.bags.chunks import Segment
from pc2scan.bags.damage import DamageLog
from pc2scan.bags.salvage import SalvagedMessages, clamp_times, note_salvaged
from pc2scan.errors import DamageError
from pc2scan.model import Connection, RawMessage

SEGMENT = Segment(40, 100, 1_000, start_ns=5, end_ns=9, compression="lz4")
MESSAGE = RawMessage(Connection(1, "/a", "std_msgs/msg/String", "cdr"), 7, b"", 7)


@pytest.mark.parametrize(
    ("size", "left", "expected"),
    [
        # All of it came out: only messages of unknown channels are lost.
        (1_000, SalvagedMessages([MESSAGE], 0, 0), (0, 0, 5, 9)),
        (1_000, SalvagedMessages([MESSAGE], 0, 3), (0, 3, 5, 9)),
        # Bytes between records are lost. It is unknown how many messages were in them.
        (1_000, SalvagedMessages([MESSAGE], 20, 3), (20, None, 5, 9)),
        # What is cut off follows the last message.
        (400, SalvagedMessages([MESSAGE], 20, 0), (620, None, 7, 9)),
        (400, SalvagedMessages([], 20, 0), (620, None, 5, 9)),
        # More came out than is declared.
        (1_200, SalvagedMessages([MESSAGE], 0, 0), (0, 0, 5, 9)),
    ],
)
def test_what_is_lost_and_when(size: int, left: SalvagedMessages, expected: tuple[int, int | None, int, int]) -> None:
    log = DamageLog(strict=False)
    note_salvaged(log, DamageError("is broken", path=Path("x")), SEGMENT, 40, size, left, None, counted=True)
    (damage,) = log.found
    assert (damage.bytes_lost, damage.messages_lost, damage.first_ns, damage.last_ns) == expected
    assert damage.offset == 40


@pytest.mark.parametrize(
    ("indexed", "unknown", "counted", "lost"),
    [
        (None, 0, True, 0),
        (1, 0, False, 0),
        (3, 0, False, 2),
        (3, 0, True, 2),
        # Nothing tells whether messages are missing: there is no index, or not all of it.
        (None, 0, False, None),
        (0, 0, False, None),
        (0, 0, True, 0),
        (None, 4, False, 4),
    ],
)
def test_messages_that_only_the_index_has_are_lost(
    indexed: int | None, unknown: int, counted: bool, lost: int | None
) -> None:
    log = DamageLog(strict=False)
    left = SalvagedMessages([MESSAGE], 0, unknown)
    note_salvaged(log, DamageError("is broken", path=Path("x")), SEGMENT, 40, 1_000, left, indexed, counted=counted)
    assert [damage.messages_lost for damage in log.found] == [lost]


@pytest.mark.parametrize(("times", "lost"), [((6, 8), 0), ((6, 10), 0), ((3, 10), None), ((10, 11), None)])
def test_several_strange_times_may_be_another_chunk(times: tuple[int, ...], lost: int | None) -> None:
    log = DamageLog(strict=False)
    left = SalvagedMessages([MESSAGE._replace(log_time_ns=time) for time in times], 0, 0)
    note_salvaged(log, DamageError("is broken", path=Path("x")), SEGMENT, 40, 1_000, left, None, counted=True)
    assert [damage.messages_lost for damage in log.found] == [lost]


@pytest.mark.parametrize(
    ("times", "expected"), [((6, 4), (6, 5)), ((4, 6, 3), (5, 6, 5)), ((3, 4, 6), (3, 4, 6)), ((12, 11), (12, 11))]
)
def test_times_are_kept_where_the_declared_ones_are_wrong(times: tuple[int, ...], expected: tuple[int, ...]) -> None:
    messages = [MESSAGE._replace(log_time_ns=time) for time in times]
    assert tuple(message.log_time_ns for message in clamp_times(messages, (5, 9))) == expected

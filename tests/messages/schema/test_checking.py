"""Types that are refused, each with its topic."""

from __future__ import annotations

from pathlib import Path

import pytest

from messages.twins import SEPARATOR, of_kind, ros1, ros2
from pc2scan.errors import DecodeError
from pc2scan.messages.transcode import transcoder
from pc2scan.model import Connection
from support.tables import rows

TABLES = Path(__file__).with_name("impossible.txt")


@pytest.mark.parametrize(
    ("connection", "message"),
    [
        *((of_kind(kind, text), message) for kind, text, message in rows(TABLES, "impossible types")),
        (Connection(1, "/t", "pkg/msg/Unknown", "cdr"), "type pkg/msg/Unknown is defined neither"),
        (Connection(1, "/t", "pkg/Unknown", "ros1"), "type pkg/msg/Unknown is defined neither"),
        (
            Connection(1, "/t", "foxglove.Log", "protobuf"),
            "serialised as 'protobuf', expected 'ros1' or 'cdr'",
        ),
        (ros2("syntax", encoding="protobuf"), "is defined in 'protobuf', expected ros1msg"),
        (ros1("".join(f"uint8 f{i}\n" for i in range(2_001))), "more than 2000 fields"),
        (ros1("#" * (1 << 20) + "\n"), "definition of 1048577 bytes, allowed are 1048576"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_impossible_types_fail_their_topic(connection: Connection, message: str) -> None:
    with pytest.raises(DecodeError, match=message) as caught:
        transcoder(connection, 3 - (connection.ros_version or 1))
    assert caught.value.topic == connection.topic


def test_doubling_and_deep_types_are_refused_at_once() -> None:
    def chain(length: int, line: str) -> str:
        sections = "".join(f"{SEPARATOR}\nMSG: pkg/T{i}\n{line.format(i + 1)}" for i in range(length))
        return f"T0 a\n{sections}{SEPARATOR}\nMSG: pkg/T{length}\nuint8 x\n"

    with pytest.raises(DecodeError, match="more than 100000 fields when written out"):
        transcoder(ros1(chain(40, "T{0} a\nT{0} b\n")), 2)
    with pytest.raises(DecodeError, match="nested more than 64 levels deep"):
        transcoder(ros1(chain(64, "T{0} a\n")), 2)
    transcoder(ros1(chain(62, "T{0} a\n")), 2)

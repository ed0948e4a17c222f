"""Types that are refused, each with its topic."""

from __future__ import annotations

import pytest

from messages.twins import SEPARATOR, ros1, ros2
from pc2scan.errors import DecodeError
from pc2scan.messages.transcode import transcoder
from pc2scan.model import Connection


@pytest.mark.parametrize(
    ("connection", "message"),
    [
        (Connection(1, "/t", "pkg/msg/Unknown", "cdr"), "type pkg/msg/Unknown is defined neither"),
        (Connection(1, "/t", "pkg/Unknown", "ros1"), "type pkg/msg/Unknown is defined neither"),
        (ros1("Missing m\n"), r"type pkg/msg/Missing \(needed by pkg/msg/Type\) is defined neither"),
        (
            Connection(1, "/t", "foxglove.Log", "protobuf"),
            "serialised as 'protobuf', expected 'ros1' or 'cdr'",
        ),
        (ros2("syntax", encoding="protobuf"), "is defined in 'protobuf', expected ros1msg"),
        (ros2("wstring text\n"), "text is a wstring, which ROS 1 cannot carry"),
        (ros1("uint8[0] none\n"), "none is an array of 0 elements"),
        (ros1("uint8[99999999999] many\n"), "size of 11 digits"),
        (ros1("uint8[-1] many\n"), "line 1 of its definition is not a field"),
        (ros1("uint8 x 5\n"), "line 1 of its definition is not a field"),
        (ros1("pkg/Type self\n"), "pkg/msg/Type contains itself"),
        (
            ros1(f"A a\n{SEPARATOR}\nMSG: pkg/A\nB b\n{SEPARATOR}\nMSG: pkg/B\nA[] a\n"),
            "pkg/msg/A contains itself",
        ),
        (ros1("".join(f"uint8 f{i}\n" for i in range(2_001))), "more than 2000 fields"),
        (ros1("string[2001] many\n"), "more than 2000 fields"),
        (ros1("#" * (1 << 20) + "\n"), "definition of 1048577 bytes, allowed are 1048576"),
        (ros1(f"uint8 a\n{SEPARATOR}\nuint8 b\n"), "section 1 does not begin with MSG"),
        (
            ros1("Header header\n" + f"{SEPARATOR}\nMSG: std_msgs/Header\nstring s\n"),
            "defined as .string s., expected a stamp",
        ),
        (ros2("module p {", encoding="ros2idl"), "its IDL cannot be read"),
        (ros2("module p { const long X = ((1)); };", encoding="ros2idl"), "nested parentheses"),
        (ros2("module p { const long X = 1 << 2; };", encoding="ros2idl"), "a shift"),
        (ros2("struct S { sequence<sequence<long>> a; };", encoding="ros2idl"), "a sequence of sequences"),
        (ros2('const string X = "', encoding="ros2idl"), "a string without an end"),
        (ros2('const string X = "\\\\";', encoding="ros2idl"), "an escaped backslash"),
        (ros2("struct S { @optional long a; };", encoding="ros2idl"), "an optional member"),
        (ros2("uint8 structure_needs_at_least_one_member\nuint8 b\n"), "is ROS 2's own"),
        (ros1("pkg/Item X=1\n"), "the constant X has the type 'pkg/Item'"),
        (ros1("a/b/c/d x\n"), "x has the unknown type 'a/b/c/d'"),
        (
            ros2(
                'module pkg { module msg { module Type_Constants { const string X = "a\nb"; };'
                " struct Type { long a; }; }; };",
                encoding="ros2idl",
            ),
            "the constant X runs over several lines",
        ),
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

from __future__ import annotations

import pytest

from messages.twins import SEPARATOR, Twin, check_both_ways, parsed, ros1, ros2
from pc2scan.errors import DecodeError
from pc2scan.messages.transcode import transcoder


def test_bounds_defaults_and_constants_reach_ros1() -> None:
    text = """\
string<=5 name "a # b"
int32<=3 refused
"""
    with pytest.raises(DecodeError, match="refused is a int32 with a bound"):
        transcoder(ros2(text), 1)
    text = """\
string WORD='single # quotes'   # comment
uint8[<=4] few [1, 2]
string<=5 name "a # b"
string<=5[<=2] names
float32 x 0.5  # default
char c
Other other
@key
int32 id
---"""
    other = f"\n{SEPARATOR}\nMSG: pkg/Other\nint64 a\n"
    with pytest.raises(DecodeError, match="line 10 of its definition is not a field: '---'"):
        transcoder(ros2(text + other), 1)
    plan = transcoder(ros2(text.removesuffix("---") + other), 1)
    assert plan.connection.definition.text == (
        "string WORD=single # quotes\nuint8[] few\nstring name\nstring[] names\nfloat32 x\nchar c\n"
        f"pkg/Other other\nint32 id\n{SEPARATOR}\nMSG: pkg/Other\nint64 a\n"
    )
    structs = parsed(ros2(text.removesuffix("---") + other))
    twin = Twin(structs, "pkg/msg/Type", 3)
    assert bytes(plan.encode(twin.cdr)) == twin.ros1


def test_definitions_as_people_write_them() -> None:
    """rosbags' own parser refuses each of these lines."""
    text = (
        "int32 lower_case=3\r\nstring VERSION=1.2.3\r\nfloat32 Kp=1e3\r\nuint8 TRAILING_=1\r\n"
        "\tuint8\t x \t# tab\r\nuint8 lower_case\r\nuint8 class\r\nuint8 from_\r\n"
    )
    connection = ros1(text)
    check_both_ways(connection, "pkg/msg/Type", parsed(connection), 1)
    assert [field.name for field in parsed(connection)["pkg/msg/Type"].fields] == [
        "x",
        "lower_case",
        "class",
        "from_",
    ]

"""Messages that pass through between ROS versions, held to an independent serialiser written out in twins.py."""

from __future__ import annotations

import builtins
from contextlib import suppress
from functools import cache
from hashlib import md5
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from messages.twins import CODES, SEPARATOR, Twin, check_both_ways, of_kind, ros1, ros2
from pc2scan.errors import DecodeError
from pc2scan.messages import transcode
from pc2scan.messages.transcode import transcoder
from pc2scan.model import Connection, ros1_type
from support import sampled
from support.tables import rows

TABLES = Path(__file__).with_name("damaged.txt")

typestore = cache(get_typestore)

# --- every type that both ROS versions know ---


@cache
def common_types() -> list[str]:
    noetic, jazzy = transcode.known_types(1), transcode.known_types(2)
    return sorted(name for name in noetic if transcode.same_layout(noetic, jazzy, name) and name in jazzy)


@pytest.mark.parametrize("name", sampled(common_types(), 14))
def test_common_types_go_there_and_back(name: str) -> None:
    structs = transcode.known_types(1)
    connection = Connection(1, "/topic", ros1_type(name), "ros1")
    for seed in range(5):
        check_both_ways(connection, name, structs, seed)
    # It is what rosbags makes of the objects.
    jazzy, noetic = typestore(Stores.ROS2_JAZZY), typestore(Stores.ROS1_NOETIC)
    plan = transcoder(connection, 2)
    encoded = plan.encode(bytes(Twin(structs, name, 7).ros1))
    message = jazzy.deserialize_cdr(bytes(encoded), name)
    assert bytes(jazzy.serialize_cdr(message, name, little_endian=True)) == encoded
    # And has the other ROS version's identity.
    there = plan.connection
    assert (there.msgtype, there.serialization, there.definition.encoding) == (name, "cdr", "ros2msg")
    # ROS 2's IDL makes a uint8 of a char; rosbags hashes it as IDL's char.
    char = "RIHS01_3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9"
    assert there.digest == (char if name == "std_msgs/msg/Char" else jazzy.hash_rihs01(name))
    back = transcoder(there, 1).connection
    assert (back.msgtype, back.serialization, back.definition.encoding) == (ros1_type(name), "ros1", "ros1msg")
    if name in noetic.fielddefs:
        assert back.digest == noetic.generate_msgdef(name, ros_version=1)[1]


# --- types of the recording's own ---

NESTED = f"""\
# A type with everything that moves bytes about.
Header header
Item[] items
Item[3] three
uint8 flag
float64[] numbers
byte b
string[] names
string[2] pair
char c
time stamp
duration[] spans
nav/Nothing nothing
uint16[3] shorts
bool[] bits
{SEPARATOR}
MSG: pkg/Item
uint8 kind
std_msgs/Header header
float64 value
{SEPARATOR}
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
{SEPARATOR}
MSG: nav/Nothing
"""


WORDS = [*CODES, "string", "time", "duration", "Header", "pkg/Inner", "pkg/Deep", "pkg/Void"]


@st.composite
def ros1_definitions(draw: st.DrawFn) -> str:
    def fields(words: list[str], most: int) -> str:
        drawn = draw(st.lists(st.tuples(st.sampled_from(words), st.sampled_from(["", "[]", "[3]"])), max_size=most))
        # A sequence of messages without fields is refused: it is not bounded by the message's size.
        return "".join(
            f"{word}{'' if word == 'pkg/Void' and shape == '[]' else shape} f{index}\n"
            for index, (word, shape) in enumerate(drawn)
        )

    inner = "uint8 first\n" + fields([*CODES, "string", "time", "pkg/Deep"], 4)
    deep = fields([*CODES, "string", "Header"], 4) + "int8 last\n"
    return "".join(
        [
            fields(WORDS, 8),
            *(
                f"{SEPARATOR}\nMSG: pkg/{name}\n{text}"
                for name, text in (("Inner", inner), ("Deep", deep), ("Void", ""))
            ),
        ]
    )


@given(text=ros1_definitions(), seed=st.integers(0, 1 << 32))
def test_any_type_goes_there_and_back(text: str, seed: int) -> None:
    connection = ros1(text)
    structs = transcode.known_types(1) | transcode.parse(connection.definition, connection.msgtype)
    check_both_ways(connection, "pkg/msg/Type", structs, seed)


# --- what cannot be ---


@given(data=st.binary(max_size=120), ros_version=st.sampled_from([1, 2]))
def test_arbitrary_bytes_are_re_encoded_or_refused(data: bytes, ros_version: int) -> None:
    there = transcoder(ros1(NESTED), 2)
    plan = there if ros_version == 1 else transcoder(there.connection, 1)
    with suppress(DecodeError):
        plan.encode(data)


@pytest.mark.parametrize(
    ("connection", "message"),
    [
        *((of_kind(kind, text), message) for kind, text, message in rows(TABLES, "impossible types")),
        (Connection(1, "/t", "pkg/msg/Unknown", "cdr"), "type pkg/msg/Unknown is defined neither"),
        (Connection(1, "/t", "pkg/Unknown", "ros1"), "type pkg/msg/Unknown is defined neither"),
        (ros2("syntax", encoding="protobuf"), "is defined in 'protobuf', expected ros1msg"),
        (ros1("".join(f"uint8 f{i}\n" for i in range(2_001))), "more than 2000 fields"),
        (ros1("#" * (1 << 18) + "\n"), "definition of 262145 bytes, allowed are 262144"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_impossible_types_fail_their_topic(connection: Connection, message: str) -> None:
    with pytest.raises(DecodeError, match=message):
        transcoder(connection, 3 - (connection.ros_version or 1))


@pytest.mark.parametrize(("kind", "text", "data", "message"), rows(TABLES, "damaged messages"))
def test_damaged_messages_are_refused(kind: str, text: str, data: bytes, message: str) -> None:
    plan = transcoder(of_kind(kind, text), 2 if kind == "ros1" else 1)
    with pytest.raises(DecodeError, match=message):
        plan.encode(data)


def test_constants_keep_their_text_of_which_ros_1_makes_its_hash() -> None:
    text = "uint8 low_er = 0x0A # ten\r\nstring s='a b'\r\nfloat32 F=0.50\r\nuint8 x\r\n"
    expected = b"uint8 low_er=0x0A\nstring s=a b\nfloat32 F=0.50\nuint8 x"
    assert transcoder(ros2(text), 1).connection.digest == md5(expected).hexdigest()
    assert 'string s="a b"\n' in transcoder(ros1(text), 2).connection.definition.text


def test_doubling_and_deep_types_are_refused_at_once() -> None:
    def chain(length: int, line: str) -> str:
        sections = "".join(f"{SEPARATOR}\nMSG: pkg/T{i}\n{line.format(i + 1)}" for i in range(length))
        return f"T0 a\n{sections}{SEPARATOR}\nMSG: pkg/T{length}\nuint8 x\n"

    with pytest.raises(DecodeError, match="more than 100000 fields when written out"):
        transcoder(ros1(chain(40, "T{0} a\nT{0} b\n")), 2)
    with pytest.raises(DecodeError, match="nested more than 64 levels deep"):
        transcoder(ros1(chain(64, "T{0} a\n")), 2)
    transcoder(ros1(chain(62, "T{0} a\n")), 2)


# --- rosbags executes code that it generates ---

EVIL = "x: __import__('os').system('touch /tmp/pwned')"


@pytest.fixture
def executed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Collect the source of everything that is given to exec."""
    sources: list[str] = []
    original = exec

    def spy(source: Any, *args: Any) -> None:
        if isinstance(source, str):
            sources.append(source)
        original(source, *args)

    monkeypatch.setattr(builtins, "exec", spy)
    return sources


@pytest.mark.parametrize(
    "connection",
    [
        ros1(f"uint8 {EVIL}\n"),
        ros1(f"uint8 a\nuint8 {EVIL}=1\n"),
        ros1("uint8 a\n", "pkg/Type:\n    import os#"),
        ros1("uint8 a\n", f"pkg/{EVIL}"),
        ros1("uint8 a\n", "pkg/T'ype"),
        ros1(f'pkg/T"+str(print(1))+" a\n{SEPARATOR}\nMSG: pkg/T"+str(print(1))+"\nuint8 b\n'),
        ros1(f"1/2 a\n{SEPARATOR}\nMSG: 1/2\nuint8 b\n"),
        ros1("uint8 a\nuint8 b‿c\n"),
    ],
    ids=repr,
)
def test_hostile_names_are_refused_before_any_code_is_made(connection: Connection, executed: list[str]) -> None:
    with pytest.raises(DecodeError):
        transcoder(connection, 3 - (connection.ros_version or 1))
    assert not [source for source in executed if "__import__('os')" in source or "import rosbags" in source]
    assert not [source for source in executed if "f0" in source]

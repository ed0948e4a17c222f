from __future__ import annotations

import pytest

from messages.twins import SEPARATOR, Twin, parsed, ros2
from pc2scan.errors import DecodeError
from pc2scan.messages import schema
from pc2scan.messages.transcode import transcoder

IDL = f"""\
{SEPARATOR}
IDL: pkg/msg/Type
// generated from rosidl_adapter/resource/msg.idl.em
#include "pkg/msg/Item.idl"
#include "std_msgs/msg/Header.idl"

module pkg {{
  module msg {{
    typedef double double__3[3];
    module Type_Constants {{
      @verbatim (language="comment", text=
        "((nested)) \\"quoted\\"" "\\n" "text")
      const uint8 HIGH = 7;
      const string WORD = "a b";
    }};
    @verbatim (language="comment", text="A type.")
    struct Type {{
      std_msgs::msg::Header header;
      @default (value=TRUE)
      boolean flag;
      double__3 xyz;
      sequence<pkg::msg::Item> items;
      @unit (value="m")
      octet b;
      string<8> name;
    }};
  }};
}};

{SEPARATOR}
IDL: pkg/msg/Item
module pkg {{ module msg {{ struct Item {{ uint8 structure_needs_at_least_one_member; }}; }}; }};
"""


def test_idl() -> None:
    idl = IDL.replace("sequence<pkg::msg::Item> items", "pkg::msg::Item items")
    plan = transcoder(ros2(idl, encoding="ros2idl"), 1)
    assert plan.connection.definition.text == (
        "uint8 HIGH=7\nstring WORD=a b\nstd_msgs/Header header\nbool flag\nfloat64[3] xyz\npkg/Item items\n"
        f"byte b\nstring name\n{SEPARATOR}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
        f"{SEPARATOR}\nMSG: pkg/Item\n"
    )
    structs = dict(schema.known_types("ros2_jazzy")) | parsed(ros2(idl, encoding="ros2idl"))
    twin = Twin(structs, "pkg/msg/Type", 5)
    assert bytes(plan.encode(twin.cdr)) == twin.ros1_unnumbered


def test_sequence_of_messages_without_fields_is_refused() -> None:
    with pytest.raises(DecodeError, match="items is a sequence of messages without fields"):
        transcoder(ros2(IDL, encoding="ros2idl"), 1)


@pytest.mark.parametrize("text", ['\\"' * 500_000, '"\\' * 500_000, "/* " * 300_000, '@a("\\"' * 100_000])
def test_texts_without_an_end_take_no_time(text: str) -> None:
    """Looking for the end of each would take the square of their number: hours."""
    with pytest.raises(DecodeError, match=r"without an end|cannot be read|parentheses"):
        transcoder(ros2(text, encoding="ros2idl"), 1)

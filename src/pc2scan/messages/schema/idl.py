"""Reads IDL as ROS 2 generates it, with rosbags' parser; IDL that would take the parser long is refused."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from pc2scan.errors import DecodeError

from .message_sets import structs_of
from .types import excerpt

if TYPE_CHECKING:
    from .types import Struct

_IDL_STRING = r'"(?:\\.|[^"\\])*"'
_IDL_TOKENS = re.compile(
    rf'(?P<string>{_IDL_STRING})|/\*.*?\*/|//[^\n]*|(?P<open>"|/\*)|'
    rf'@(?P<annotation>\w+)(?:\s*\((?:{_IDL_STRING}|[^()"])*\))?',
    re.DOTALL,
)


def parse_idl(text: str, name: str) -> dict[str, Struct]:
    """Read IDL as ROS 2 generates it."""
    from rosbags.typesys import TypesysError, get_types_from_idl  # noqa: PLC0415

    try:
        return structs_of(get_types_from_idl(_plain_idl(text, name)))
    except (
        TypesysError,
        ArithmeticError,
        AssertionError,
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as err:
        raise DecodeError(f"{name}: its IDL cannot be read: {excerpt(str(err))}") from err


def _plain_idl(text: str, name: str) -> str:
    r"""Strip comments, annotations and includes, and refuse what ROS 2 does not generate.

    rosbags' parser needs 64 times as long for every nested parenthesis and twice as long for every nested
    sequence, and a shift can ask for any number of bits. ``\\`` is refused because rosbags' parser and this function
    disagree on where such a string ends, and an optional member because it is not plain CDR.
    """

    def keep(match: re.Match[str]) -> str:
        if match["annotation"] == "optional":
            raise DecodeError(f"{name}: its IDL has an optional member")
        if match["open"]:
            # Raises at the first: searching the end of each would take quadratic time.
            raise DecodeError(
                f"{name}: its IDL has a {'string' if match['open'] == chr(34) else 'comment'} without an end"
            )
        return match["string"] or " "

    text = re.sub(r"^[ \t]*#.*$", "", text, flags=re.MULTILINE)
    text = _IDL_TOKENS.sub(keep, text)
    bare = re.sub(_IDL_STRING, " ", text)
    for pattern, what in (
        (r"\([^)]*\(", "nested parentheses"),
        (r"<<", "a shift"),
        (r"sequence\s*<\s*sequence", "a sequence of sequences"),
        (r'"', "a string without an end"),
    ):
        if re.search(pattern, bare):
            raise DecodeError(f"{name}: its IDL has {what}")
    if "\\\\" in text:
        raise DecodeError(f"{name}: its IDL has an escaped backslash")
    return text

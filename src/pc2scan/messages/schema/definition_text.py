"""Reads the definition texts of recordings: ``ros1msg``, ``ros2msg``, and IDL as ROS 2 generates it (``ros2idl``).

IDL is read with rosbags' parser; IDL that would take the parser long is refused.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from pc2scan.errors import DecodeError

from .message_sets import structs_of
from .types import (
    BUILTIN,
    HEADER,
    PRIMITIVES,
    ROS2_ONLY,
    Constant,
    Field,
    Shape,
    Struct,
    canonical_type,
    excerpt,
    without_sequence_number,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.model import Definition

MAX_BYTES = 1 << 20

_SEPARATOR = re.compile(r"^=+[ \t]*$", re.MULTILINE)
_SECTION = re.compile(r"\s*(MSG|IDL):[ \t]*([^\s]+)[ \t]*(?:\n|\Z)")
_LINE = re.compile(
    r"(?P<type>[A-Za-z][A-Za-z0-9_/]*)(?:<=(?P<bound>[0-9]+))?"
    r"(?P<array>\[(?P<most><=)?(?P<size>[0-9]*)\])?"
    r"[ \t]+(?P<name>[A-Za-z][A-Za-z0-9_]*)[ \t]*(?P<rest>.*)",
    re.ASCII,
)

_ROS1_WORDS = {word: name for name, (word, _) in BUILTIN.items()}


def parse(definition: Definition, msgtype: str) -> dict[str, Struct]:
    """Read a recording's definition text.

    Parameters
    ----------
    definition
        ``ros1msg``, ``ros2msg`` or ``ros2idl``: the type's own text, then those it depends on, each under a
        line of ``=`` and a line ``MSG: package/Name`` (or ``IDL: package/msg/Name``).
    msgtype
        The type that the text begins with.

    Returns
    -------
    dict of str to Struct
        Every type in the text, used or not, by canonical name; nested types may be missing.

    Raises
    ------
    DecodeError
        If the text is of another encoding, beyond 1 MB, or not a definition.
    """
    if definition.encoding not in {"ros1msg", "ros2msg", "ros2idl"}:
        raise DecodeError(f"{msgtype} is defined in {definition.encoding!r}, expected ros1msg, ros2msg or ros2idl")
    if len(definition.data) > MAX_BYTES:
        raise DecodeError(f"{msgtype}: definition of {len(definition.data)} bytes, allowed are {MAX_BYTES}")
    ros1 = definition.encoding == "ros1msg"
    structs: dict[str, Struct] = {}
    for kind, name, text in _sections(definition, msgtype):
        if kind == "IDL":
            structs.update(parse_idl(text, name))
        else:
            structs[canonical_type(name)] = _parse_msg(text, canonical_type(name), ros1=ros1)
    return {name: without_sequence_number(name, struct) for name, struct in structs.items()}


def _sections(definition: Definition, msgtype: str) -> Iterator[tuple[str, str, str]]:
    """Split at the lines of ``=``: kind (MSG or IDL), type, text."""
    kind = "IDL" if definition.encoding == "ros2idl" else "MSG"
    text = definition.text.replace("\r\n", "\n")
    for index, part in enumerate(_SEPARATOR.split(text)):
        heading = _SECTION.match(part)
        if heading:
            yield heading[1], heading[2], part[heading.end() :]
        elif index == 0:
            # An IDL text may begin with a separator, so that its first part is empty.
            if kind == "MSG" or part.strip():
                yield kind, msgtype, part
        elif part.strip():
            raise DecodeError(f"{msgtype}: definition section {index} does not begin with MSG: or IDL:")


def _parse_msg(text: str, owner: str, *, ros1: bool) -> Struct:
    """Read one type's ``.msg`` text."""
    fields: list[Field] = []
    constants: list[Constant] = []
    for number, raw in enumerate(text.split("\n"), 1):
        line = raw.strip().removeprefix("@key").lstrip()
        if not line or line.startswith("#"):
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            raise DecodeError(f"{owner}: line {number} of its definition is not a field: {excerpt(line)}")
        rest = match["rest"]
        if rest.startswith("=") and not match["array"]:
            value = rest[1:].strip()
            # Only a ROS 1 string runs to the end of the line; elsewhere # begins a comment.
            if not (ros1 and match["type"] == "string"):
                value = _strip_comment(value)
            constants.append(Constant(match["name"], match["type"], value))
        elif not rest or rest.startswith("#") or not ros1:
            # In ROS 2 a default value may follow the name; it takes no place in a message.
            fields.append(_field(match, owner, ros1=ros1))
        else:
            raise DecodeError(f"{owner}: line {number} of its definition is not a field: {excerpt(line)}")
    return Struct(tuple(fields), tuple(constants))


def _field(match: re.Match[str], owner: str, *, ros1: bool) -> Field:
    """Make a field from a matched line."""
    shape: Shape = "scalar"
    size = _number(match["size"] or "0")
    if match["array"]:
        shape = "sequence" if match["most"] or not match["size"] else "array"
    bound = _number(match["bound"] or "0")
    if match["bound"] and match["type"] not in {"string", "wstring"}:
        raise DecodeError(f"{owner}: {match['name']} is a {match['type']} with a bound")
    return Field(match["name"], _resolve(match["type"], owner, ros1=ros1), shape, size, bound)


def _resolve(word: str, owner: str, *, ros1: bool) -> str:
    """Turn a type in ``owner``'s definition into a primitive or a full name."""
    if word in PRIMITIVES or word in ROS2_ONLY:
        return word
    if word in _ROS1_WORDS:
        return _ROS1_WORDS[word]
    if "/" in word:
        return canonical_type(word)
    if word == "Header" and ros1:
        return HEADER
    return canonical_type(f"{owner.rpartition('/')[0]}/{word}")


def _strip_comment(value: str) -> str:
    """Remove a comment, unless the ``#`` is within quotes."""
    quoted = re.match(r"'(?:\\.|[^'\\])*'|\"(?:\\.|[^\"\\])*\"", value)
    return quoted[0] if quoted else value.split("#", 1)[0].rstrip()


def _number(digits: str) -> int:
    """Read a size; far fewer digits are allowed than Python's own limit."""
    if len(digits) > 10:
        raise DecodeError(f"size of {len(digits)} digits in a definition")
    return int(digits)


# --- IDL ---

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

"""Message definitions as data: read from text, checked, compared, written, identified.

A `Schema` spells types as ROS 2 does, whichever generation it came from, and says only what both
generations share: ``std_msgs/msg/Header`` has no sequence number, ROS 1's ``time`` and ``duration`` are
``builtin_interfaces``'s. ROS 1's spelling returns when it is written (`render`, `md5sum`).

Definitions come from files that anyone may have made: `parse` and `closure` accept plain identifiers only
and bound sizes, depth and recursion, so that nothing downstream grows or loops without end.

Sources: http://wiki.ros.org/msg, https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html,
https://mcap.dev/spec/registry (how ``ros1msg``, ``ros2msg`` and ``ros2idl`` concatenate definitions),
genmsg's ``gentools.py`` (the md5sum), REP 2016 (RIHS01).
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

from pc2scan.errors import DecodeError
from pc2scan.model import normalized_type, ros1_type

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from pc2scan.model import Definition

__all__ = [
    "HEADER",
    "PRIMITIVES",
    "Constant",
    "Field",
    "Schema",
    "Struct",
    "builtin",
    "canonical",
    "closure",
    "fielddefs",
    "known",
    "least_bytes",
    "md5sum",
    "parse",
    "render",
    "rihs01",
    "same_layout",
]

HEADER = "std_msgs/msg/Header"

#: What both generations can carry. ``byte`` and ``char`` are 8 bits wide in both.
PRIMITIVES = frozenset({"bool", "byte", "char", "string", "float32", "float64"}) | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
#: What only ROS 2 knows.
ROS2_ONLY = frozenset({"wstring", "wchar", "float128"})

MAX_BYTES = 1 << 20
MAX_DEPTH = 64
#: Declared fields, each of which takes rosbags up to a millisecond and 45 kB to compile; each element of a fixed
#: array of strings or messages counts, as rosbags unrolls them.
MAX_FIELDS = 2_000
#: Fields of one message when everything nested is written out, the elements of sequences once.
MAX_LEAVES = 100_000
#: A message in a sequence may have so many fields, and so many more for each byte that it takes: fields without bytes
#: take time, and any number of them fits into a short message.
MAX_LEAVES_BESIDE_BYTES, MAX_LEAVES_A_BYTE = 64, 4

RENAMED = {"roslib/msg/Header": HEADER, "tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
#: What ROS 2's IDL generator puts into a message without fields, since IDL has no empty struct.
PLACEHOLDER = "structure_needs_at_least_one_member"

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_SEPARATOR = re.compile(r"^=+[ \t]*$", re.MULTILINE)
_SECTION = re.compile(r"\s*(MSG|IDL):[ \t]*([^\s]+)[ \t]*(?:\n|\Z)")
_LINE = re.compile(
    r"(?P<type>[A-Za-z][A-Za-z0-9_/]*)(?:<=(?P<bound>[0-9]+))?"
    r"(?P<array>\[(?P<most><=)?(?P<size>[0-9]*)\])?"
    r"[ \t]+(?P<name>[A-Za-z][A-Za-z0-9_]*)[ \t]*(?P<rest>.*)",
    re.ASCII,
)

Shape = Literal["scalar", "array", "sequence"]


@dataclass(frozen=True, slots=True)
class Field:
    """A member of a message.

    Attributes
    ----------
    name
        As defined.
    type
        One of `PRIMITIVES` or a message type in ROS 2's spelling.
    shape
        ``array`` has a fixed number of elements, ``sequence`` is preceded by their number.
    size
        Elements of an array; the bound of a sequence, 0 for none.
    bound
        The bound of a string in bytes, 0 for none.
    """

    name: str
    type: str
    shape: Shape = "scalar"
    size: int = 0
    bound: int = 0


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant: it names a value and takes no place in a message. ``value`` is text, as defined."""

    name: str
    type: str
    value: str


@dataclass(frozen=True, slots=True)
class Struct:
    """A message type."""

    fields: tuple[Field, ...] = ()
    constants: tuple[Constant, ...] = ()


#: A message type and all that it is made of, by name, in the order of first use, itself first.
Schema = dict[str, Struct]

_STAMP = Struct((Field("sec", "int32"), Field("nanosec", "uint32")))
_BUILTIN = {
    "builtin_interfaces/msg/Time": ("time", _STAMP),
    "builtin_interfaces/msg/Duration": ("duration", _STAMP),
}
_ROS1_WORDS = {word: name for name, (word, _) in _BUILTIN.items()}


def builtin(name: str) -> bool:
    """Whether a type is one of the two that ROS 1 has as primitives: a time and a duration."""
    return name in _BUILTIN


def canonical(msgtype: str) -> str:
    """Spell a type as ROS 2 does, under the name it has today.

    >>> canonical("tf/tfMessage"), canonical("sensor_msgs/PointCloud2")
    ('tf2_msgs/msg/TFMessage', 'sensor_msgs/msg/PointCloud2')
    """
    name = normalized_type(msgtype)
    return RENAMED.get(name, name)


# --- reading ---


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
        Every type in the text, used or not, by canonical name; what they refer to may be missing.

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
            structs.update(_parse_idl(text, name))
        else:
            structs[canonical(name)] = _parse_msg(text, canonical(name), ros1=ros1)
    return {name: _without_sequence_number(name, struct) for name, struct in structs.items()}


def _sections(definition: Definition, msgtype: str) -> Iterator[tuple[str, str, str]]:
    """Split at the lines of ``=``: kind (MSG or IDL), type, text."""
    kind = "IDL" if definition.encoding == "ros2idl" else "MSG"
    text = definition.text.replace("\r\n", "\n")
    for index, part in enumerate(_SEPARATOR.split(text)):
        heading = _SECTION.match(part)
        if heading:
            yield heading[1], heading[2], part[heading.end() :]
        elif index == 0:
            # The first section of an IDL text may be preceded by a separator, leaving nothing before it.
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
            raise DecodeError(f"{owner}: line {number} of its definition is not a field: {_excerpt(line)}")
        rest = match["rest"]
        if rest.startswith("=") and not match["array"]:
            value = rest[1:].strip()
            # Only a ROS 1 string runs to the end of the line; elsewhere # begins a comment.
            if not (ros1 and match["type"] == "string"):
                value = _uncommented(value)
            constants.append(Constant(match["name"], match["type"], value))
        elif not rest or rest.startswith("#") or not ros1:
            # What follows the name in ROS 2 is a default value, which takes no place in a message.
            fields.append(_field(match, owner, ros1=ros1))
        else:
            raise DecodeError(f"{owner}: line {number} of its definition is not a field: {_excerpt(line)}")
    return Struct(tuple(fields), tuple(constants))


def _field(match: re.Match[str], owner: str, *, ros1: bool) -> Field:
    """Make a field of a matched line."""
    shape: Shape = "scalar"
    size = _number(match["size"] or "0")
    if match["array"]:
        shape = "sequence" if match["most"] or not match["size"] else "array"
    bound = _number(match["bound"] or "0")
    if match["bound"] and match["type"] not in {"string", "wstring"}:
        raise DecodeError(f"{owner}: {match['name']} is a {match['type']} with a bound")
    return Field(match["name"], _resolve(match["type"], owner, ros1=ros1), shape, size, bound)


def _resolve(word: str, owner: str, *, ros1: bool) -> str:
    """Turn a type as written in ``owner``'s definition into a primitive or a full name."""
    if word in PRIMITIVES or word in ROS2_ONLY:
        return word
    if word in _ROS1_WORDS:
        return _ROS1_WORDS[word]
    if "/" in word:
        return canonical(word)
    if word == "Header" and ros1:
        return HEADER
    return canonical(f"{owner.rpartition('/')[0]}/{word}")


def _uncommented(value: str) -> str:
    """Cut a comment off, unless the ``#`` is within quotes."""
    quoted = re.match(r"'(?:\\.|[^'\\])*'|\"(?:\\.|[^\"\\])*\"", value)
    return quoted[0] if quoted else value.split("#", 1)[0].rstrip()


def _number(digits: str) -> int:
    """Read a size; the limit keeps it far from where Python's own conversion fails."""
    if len(digits) > 10:
        raise DecodeError(f"size of {len(digits)} digits in a definition")
    return int(digits)


def _excerpt(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")


def _without_sequence_number(name: str, struct: Struct) -> Struct:
    """Drop ``seq`` from ROS 1's Header, after making sure that it is a Header."""
    if name != HEADER:
        return struct
    kinds = [(field.type, field.shape) for field in struct.fields]
    expected = [("builtin_interfaces/msg/Time", "scalar"), ("string", "scalar")]
    if kinds == [("uint32", "scalar"), *expected]:
        return replace(struct, fields=struct.fields[1:])
    if kinds == expected:
        return struct
    names = ", ".join(f"{field.type} {field.name}" for field in struct.fields)
    raise DecodeError(f"{name} is defined as ({names}), expected a stamp and a frame_id")


# --- IDL, by rosbags ---

_IDL_STRING = r'"(?:\\.|[^"\\])*"'
_IDL_TOKENS = re.compile(
    rf'(?P<string>{_IDL_STRING})|/\*.*?\*/|//[^\n]*|(?P<open>"|/\*)|'
    rf'@(?P<annotation>\w+)(?:\s*\((?:{_IDL_STRING}|[^()"])*\))?',
    re.DOTALL,
)


def _parse_idl(text: str, name: str) -> dict[str, Struct]:
    """Read IDL as ROS 2 generates it."""
    from rosbags.typesys import TypesysError, get_types_from_idl  # noqa: PLC0415

    try:
        return _structs(get_types_from_idl(_plain_idl(text, name)))
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
        raise DecodeError(f"{name}: its IDL cannot be read: {_excerpt(str(err))}") from err


def _plain_idl(text: str, name: str) -> str:
    r"""Strip comments, annotations and includes, and refuse what ROS 2 does not generate.

    rosbags' parser repeats its work 64-fold for every nested parenthesis and twice for every nested
    sequence, and a shift can ask for any number of bits. ``\\`` is refused because the two of us would see
    a string end in different places, and an optional member because it is not plain CDR.
    """

    def keep(match: re.Match[str]) -> str:
        if match["annotation"] == "optional":
            raise DecodeError(f"{name}: its IDL has an optional member")
        if match["open"]:
            # The first is enough: looking for the end of each would take the square of the text's length.
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


# --- rosbags' own message sets ---


@lru_cache(maxsize=16)
def known(store: str) -> Mapping[str, Struct]:
    """Read one of rosbags' message sets, by the value of its ``Stores`` name: ``ros2_jazzy``.

    ``tf2_msgs/msg/TFMessage``, which rosbags' set for ROS 1 lacks, is added.
    """
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    structs = _structs(get_typestore(Stores(store)).fielddefs)
    structs = {name: _without_sequence_number(name, struct) for name, struct in structs.items()}
    transforms = Field("transforms", "geometry_msgs/msg/TransformStamped", "sequence")
    structs.setdefault("tf2_msgs/msg/TFMessage", Struct((transforms,)))
    return structs


def _structs(typesdict: Mapping[str, Any]) -> dict[str, Struct]:
    """Turn rosbags' parse trees into structs."""
    return {
        canonical(name): Struct(
            tuple(_from_rosbags(field, desc) for field, desc in fields if field != PLACEHOLDER),
            tuple(Constant(constant, word, str(value)) for constant, word, value in constants),
        )
        for name, (constants, fields) in typesdict.items()
    }


def _from_rosbags(name: str, desc: Any) -> Field:
    """Turn rosbags' field description into a field."""
    from rosbags.interfaces import Nodetype  # noqa: PLC0415

    shapes: dict[int, Shape] = {Nodetype.ARRAY: "array", Nodetype.SEQUENCE: "sequence"}
    kind, content = desc
    if kind in shapes:
        inner, size = content
        return replace(_from_rosbags(name, inner), shape=shapes[kind], size=size)
    if kind == Nodetype.NAME:
        return Field(name, canonical(content))
    word, bound = content
    return Field(name, word, bound=bound)


def fielddefs(
    schema: Schema, type_name: Callable[[str], str], field_name: Callable[[int, Field], str]
) -> dict[str, Any]:
    """Turn a schema into rosbags' parse trees, without constants, naming types and fields as told."""
    from rosbags.interfaces import Nodetype  # noqa: PLC0415

    shapes = {"array": Nodetype.ARRAY, "sequence": Nodetype.SEQUENCE}

    def describe(field: Field) -> Any:
        if field.type in PRIMITIVES:
            # ROS 2's IDL, from which its hashes are made, has uint8 for char.
            inner: Any = (Nodetype.BASE, ("uint8" if field.type == "char" else field.type, field.bound))
        else:
            inner = (Nodetype.NAME, type_name(field.type))
        return inner if field.shape == "scalar" else (shapes[field.shape], (inner, field.size))

    return {
        type_name(name): (
            [],
            [(field_name(index, field), describe(field)) for index, field in enumerate(struct.fields)],
        )
        for name, struct in schema.items()
    }


# --- checking ---


def closure(root: str, lookup: Callable[[str], Struct | None]) -> Schema:
    """Collect a type and all that it is made of.

    Parameters
    ----------
    root
        Canonical name.
    lookup
        Finds a type by its canonical name.

    Returns
    -------
    Schema
        In the order of first use, depth first.

    Raises
    ------
    DecodeError
        If a type is missing or contains itself; if a name is not an identifier; beyond 64 levels, 2,000
        fields or 100,000 fields with everything nested written out; for what only one generation can carry
        (wstring, an array of length 0).
    """
    schema: Schema = {}
    leaves: dict[str, int] = {}
    declared = 0

    def visit(name: str, path: tuple[str, ...]) -> int:
        nonlocal declared
        if name in path:
            raise DecodeError(f"{root}: {name} contains itself")
        if name in leaves:
            return leaves[name]
        if len(path) >= MAX_DEPTH:
            raise DecodeError(f"{root}: nested more than {MAX_DEPTH} levels deep")
        _check_name(name, name.split("/"))
        struct = _BUILTIN[name][1] if builtin(name) else lookup(name)
        if struct is None:
            within = f" (needed by {path[-1]})" if path else ""
            raise DecodeError(
                f"type {name}{within} is defined neither in the recording nor in ROS's message sets",
                hint="record with definitions (MCAP does), or choose another message set with `ros_distro`",
            )
        schema[name] = struct
        declared += sum(_width(field) for field in struct.fields) + len(struct.constants)
        if declared > MAX_FIELDS:
            raise DecodeError(f"{root}: more than {MAX_FIELDS} fields")
        total = 1
        for field in struct.fields:
            _check_field(name, field)
            nested = 1 if field.type in PRIMITIVES else visit(field.type, (*path, name))
            if field.shape == "sequence" and field.type not in PRIMITIVES and _empty(schema, field.type):
                raise DecodeError(f"{name}: {field.name} is a sequence of messages without fields")
            if (
                field.shape == "sequence"
                and nested > MAX_LEAVES_BESIDE_BYTES
                and nested > MAX_LEAVES_BESIDE_BYTES + MAX_LEAVES_A_BYTE * least_bytes(schema, field.type, 1)
            ):
                raise DecodeError(f"{name}: {field.name} is a sequence of messages with {nested} fields and few bytes")
            total += _width(field) * nested
            if total > MAX_LEAVES:
                raise DecodeError(f"{root}: more than {MAX_LEAVES} fields when written out")
        for constant in struct.constants:
            _check_constant(name, constant)
        leaves[name] = total
        return total

    visit(root, ())
    return schema


def _width(field: Field) -> int:
    """How many elements rosbags' conversion handles one by one."""
    return (
        max(field.size, 1) if field.shape == "array" and (field.type not in PRIMITIVES or field.type == "string") else 1
    )


def _empty(schema: Schema, name: str) -> bool:
    """Whether a message takes no bytes in ROS 1, so that any number of them fits everywhere."""
    return all(
        field.shape != "sequence" and field.type not in PRIMITIVES and _empty(schema, field.type)
        for field in schema[name].fields
    )


#: Bytes of the primitives that have a fixed size.
_WIDTHS = {"bool": 1, "byte": 1, "char": 1, "float32": 4, "float64": 8} | {
    f"{sign}int{bits}": bits // 8 for sign in ("", "u") for bits in (8, 16, 32, 64)
}


def least_bytes(schema: Mapping[str, Struct], name: str, generation: int) -> int:
    """Count the bytes that every message of a type takes: sequences and strings empty, no padding.

    Parameters
    ----------
    schema
        Has the type and all that it is made of; no type contains itself.
    generation
        Whose wire format: 1 or 2.
    """
    known: dict[str, int] = {}

    def least(name: str) -> int:
        if name not in known:
            fields = _fields(name, schema[name], generation)
            # ROS 2 puts one byte into a message without fields.
            known[name] = sum(map(of_field, fields)) if fields else generation - 1
        return known[name]

    def of_field(field: Field) -> int:
        if field.shape == "sequence":
            return 4
        if field.type == "string":
            # ROS 2's have a NUL at the end.
            size = 3 + generation
        else:
            size = _WIDTHS[field.type] if field.type in PRIMITIVES else least(field.type)
        return size * field.size if field.shape == "array" else size

    return least(name)


def _check_name(owner: str, names: Iterable[str]) -> None:
    for name in names:
        if not _IDENTIFIER.fullmatch(name) or len(name) > 255:
            raise DecodeError(f"{_excerpt(owner)}: {_excerpt(name)} is not a name")


def _check_constant(owner: str, constant: Constant) -> None:
    _check_name(owner, [constant.name])
    if constant.type not in PRIMITIVES | ROS2_ONLY:
        raise DecodeError(f"{owner}: the constant {constant.name} has the type {_excerpt(constant.type)}")
    if "\n" in constant.value or "\r" in constant.value:
        raise DecodeError(f"{owner}: the constant {constant.name} runs over several lines")


def _check_field(owner: str, field: Field) -> None:
    _check_name(owner, [field.name])
    if field.name == PLACEHOLDER:
        raise DecodeError(f"{owner}: the field name {PLACEHOLDER} is ROS 2's own")
    if field.type in ROS2_ONLY:
        raise DecodeError(f"{owner}: {field.name} is a {field.type}, which ROS 1 cannot carry")
    if field.type not in PRIMITIVES and field.type.count("/") != 2:
        raise DecodeError(f"{owner}: {field.name} has the unknown type {_excerpt(field.type)}")
    if field.shape == "array" and not 0 < field.size < 1 << 32:
        raise DecodeError(f"{owner}: {field.name} is an array of {field.size} elements")


# --- comparing ---


def same_layout(ours: Mapping[str, Struct], theirs: Mapping[str, Struct], name: str) -> bool:
    """Whether both have a type with the same bytes on the wire and the same names.

    Names are compared without case and underscores (ROS 1's ``CameraInfo.D`` is ROS 2's ``d``); bounds and
    constants do not count, nor whether a byte is called ``byte``, ``char`` or ``uint8``.
    """
    if builtin(name):
        return True
    if name not in ours or name not in theirs:
        return False
    left, right = ours[name].fields, theirs[name].fields
    return len(left) == len(right) and all(
        _wire(a) == _wire(b) and (a.type in PRIMITIVES or same_layout(ours, theirs, a.type))
        for a, b in zip(left, right, strict=True)
    )


def _wire(field: Field) -> tuple[str, str, str, int]:
    kind = "uint8" if field.type in {"byte", "char"} else field.type
    size = field.size if field.shape == "array" else 0
    return field.name.lower().replace("_", ""), kind, field.shape, size


# --- writing ---


def render(schema: Schema, generation: int) -> str:
    """Write a schema as ``ros1msg`` or ``ros2msg`` text: its first type, then the others in sections."""
    names = list(schema)
    parts = [_render_struct(names[0], schema[names[0]], generation)]
    for name in names[1:]:
        if generation == 1 and builtin(name):
            continue
        parts.append(f"{'=' * 80}\nMSG: {ros1_type(name)}\n{_render_struct(name, schema[name], generation)}")
    return "".join(parts)


def _render_struct(name: str, struct: Struct, generation: int) -> str:
    lines = [*_constant_lines(struct, generation)]
    lines += [f"{_type_word(field, generation)} {field.name}" for field in _fields(name, struct, generation)]
    return "".join(f"{line}\n" for line in lines)


def _fields(name: str, struct: Struct, generation: int) -> tuple[Field, ...]:
    """Return the fields, with ROS 1's sequence number where it belongs."""
    return (Field("seq", "uint32"), *struct.fields) if generation == 1 and name == HEADER else struct.fields


def _constant_lines(struct: Struct, generation: int) -> Iterator[str]:
    for constant in struct.constants:
        value = constant.value
        if constant.type == "string":
            bare = value[1:-1] if len(value) > 1 and value[0] == value[-1] and value[0] in "'\"" else value
            # In ROS 1 quotes would be part of the value; in ROS 2 they keep a # from beginning a comment.
            value = bare if generation == 1 else _quoted(bare)
        yield f"{constant.type} {constant.name}={value}"


def _quoted(value: str) -> str:
    return f"'{value}'" if '"' in value and "'" not in value else '"' + value.replace('"', '\\"') + '"'


def _type_word(field: Field, generation: int) -> str:
    """Write a field's type; ROS 1 has no bounds."""
    if field.type in PRIMITIVES:
        word = f"{field.type}<={field.bound}" if field.bound and generation == 2 else field.type
    elif generation == 1 and builtin(field.type):
        word = _BUILTIN[field.type][0]
    else:
        word = ros1_type(field.type)
    return word + _suffix(field, generation)


def _suffix(field: Field, generation: int) -> str:
    if field.shape == "scalar":
        return ""
    if field.shape == "array":
        return f"[{field.size}]"
    return f"[<={field.size}]" if field.size and generation == 2 else "[]"


# --- identifying ---


def md5sum(schema: Schema) -> str:
    """Compute ROS 1's identity of a schema's first type: the MD5 of its text, nested types as their sums."""
    sums: dict[str, str] = {}

    def identify(name: str) -> str:
        if name not in sums:
            lines = [*_constant_lines(schema[name], 1)]
            for field in _fields(name, schema[name], 1):
                plain = field.type in PRIMITIVES or builtin(field.type)
                lines.append(f"{_type_word(field, 1) if plain else identify(field.type)} {field.name}")
            sums[name] = hashlib.md5("\n".join(lines).encode(), usedforsecurity=False).hexdigest()
        return sums[name]

    return identify(next(iter(schema)))


def rihs01(schema: Schema) -> str:
    """Compute ROS 2's identity of a schema's first type."""
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    store = get_typestore(Stores.EMPTY)
    # Only the parse trees are needed, so nothing is registered and no code is made of the names.
    store.fielddefs = fielddefs(schema, str, lambda _, field: field.name)
    return store.hash_rihs01(next(iter(schema)))

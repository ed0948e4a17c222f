"""Where the parameters of a conversion come from: command line, ``--param name:=value``, parameter files.

Every source yields `Setting` values, which say where they were written. `resolve` lets the stronger
setting win, checks names, types and values, and builds `ProjectionParams`. An error names the parameter,
the value and its origin.
"""

from __future__ import annotations

import ast
import difflib
import math
import operator
import re
from contextlib import suppress
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NoReturn, get_args

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
    from pathlib import Path

__all__ = [
    "PARAMETERS",
    "Direction",
    "Parameter",
    "ParamsFile",
    "ResolvedParams",
    "Setting",
    "load_params_file",
    "parse_param",
    "render_params_file",
    "resolve",
]

#: Upstream's two nodes; the name of the node is the name of the direction.
Direction = Literal["pointcloud_to_laserscan", "laserscan_to_pointcloud"]

#: A parameter file is a page of text. Whatever is larger was given by mistake.
MAX_FILE_BYTES = 1_000_000

#: Deeper nesting than any namespace has; it stops an alias that contains itself.
MAX_DEPTH = 50


@dataclass(frozen=True, slots=True)
class Parameter:
    """One of upstream's parameters, as `PARAMETERS` lists it.

    Attributes
    ----------
    name
        The ROS name.
    kind
        ``float``, ``bool``, ``int`` or ``str``.
    unit
        ``m``, ``rad``, ``s`` or empty.
    help
        One or two sentences for ``--help``; they mention neither the unit nor the default.
    default
        That of `ProjectionParams`.
    directions
        The nodes that have it.
    """

    name: str
    kind: str
    unit: str
    help: str
    default: float | bool | str
    directions: frozenset[Direction]

    @property
    def option(self) -> str:
        """The command line's spelling: ``--range-min``."""
        return f"--{self.name.replace('_', '-')}"


@dataclass(frozen=True, slots=True)
class Setting:
    """A parameter's value as one source gives it, not yet checked.

    Attributes
    ----------
    name
        The ROS name; ``concurrency_level`` (ROS 1) means ``queue_size``.
    value
        As read: bool, int, float, str, or None for nothing.
    origin
        For the user: ``--range-min``, ``--param range_min:=5``, or
        ``params.yaml, line 3, pointcloud_to_laserscan.ros__parameters.range_min``.
    """

    name: str
    value: object
    origin: str


@dataclass(frozen=True, slots=True)
class ParamsFile:
    """What `load_params_file` took from a file.

    Attributes
    ----------
    direction
        Told by the node's name, or for a renamed node by its parameters; None if neither tells.
    settings
        One for each parameter, in the order of the file.
    node
        Fully qualified name of the node (or the wildcard) whose section was taken; ``/`` for the
        flat mapping of a ROS 1 file.
    ignored
        Origins of what was read and left aside: names of topics, wildcard parameters that are
        another node's, a ``concurrency_level`` beside a ``queue_size``. Worth telling the user.
    """

    direction: Direction | None
    settings: tuple[Setting, ...]
    node: str
    ignored: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ResolvedParams:
    """The parameters of a run and where each comes from.

    Attributes
    ----------
    params
        Checked.
    origin
        For each name of `PARAMETERS`, the origin of the setting that won, or ``default``.
    """

    params: ProjectionParams
    origin: Mapping[str, str]


# The table ---------------------------------------------------------------------------------------------

_SHARED: frozenset[str] = frozenset({"target_frame", "transform_tolerance", "queue_size"})

_HELP: dict[str, tuple[str, str]] = {
    "target_frame": (
        "",
        "Frame that the cloud is transformed into first; the scan is in it. Empty: the cloud's own frame.",
    ),
    "transform_tolerance": ("s", "How far a stamp may lie outside the recorded transforms."),
    "min_height": (
        "m",
        (
            "Lowest z that counts, in the target frame, inclusive. "
            "The default, the smallest positive number, drops every point at z <= 0."
        ),
    ),
    "max_height": ("m", "Highest z that counts, in the target frame, inclusive."),
    "angle_min": ("rad", "Where the scan begins; 0 is straight ahead, positive is to the left."),
    "angle_max": ("rad", "Where the scan ends; see angle_min."),
    "angle_increment": ("rad", "Angle from one beam to the next."),
    "scan_time": ("s", "Time between scans. Copied into the scan, nothing else."),
    "range_min": ("m", "Shortest horizontal distance that counts, inclusive."),
    "range_max": ("m", "Longest horizontal distance that counts, inclusive."),
    "use_inf": ("", "Whether a beam without a return reads inf; otherwise range_max + inf_epsilon."),
    "inf_epsilon": ("m", "Added to range_max for a beam without a return, when use_inf is off."),
    "queue_size": (
        "",
        "Most messages in work at one time; 0: as many as there are processor cores. Nothing is dropped.",
    ),
}


def _table() -> Mapping[str, Parameter]:
    """Join the table above with the defaults of `ProjectionParams`, in its order."""
    both: frozenset[Direction] = frozenset(get_args(Direction))
    rows = {}
    for spec in fields(ProjectionParams):
        default: Any = spec.default
        unit, text = _HELP[spec.name]
        rows[spec.name] = Parameter(
            name=spec.name,
            kind=type(default).__name__,
            unit=unit,
            help=text,
            default=default,
            directions=both if spec.name in _SHARED else frozenset({"pointcloud_to_laserscan"}),
        )
    return MappingProxyType(rows)


#: Every parameter by its ROS name, in upstream's order.
PARAMETERS: Mapping[str, Parameter] = _table()

#: ROS 1's names for parameters that ROS 2 renamed.
_ALIASES = {"concurrency_level": "queue_size"}

#: Topics. Upstream's own ROS 1 sample lists them among the parameters; later ROS 2 versions declare the
#: last two.
_TOPICS = frozenset({"cloud_in", "scan", "scan_in", "cloud", "point_cloud_topic", "scan_topic"})

#: Parameters that every ROS 2 node has.
_EVERY_NODE = frozenset({"use_sim_time", "start_type_description_service", "qos_overrides"})

_SCALAR_PARAMETERS = PARAMETERS.keys() | _ALIASES.keys()


def _is_every_nodes(name: str) -> bool:
    return name.partition(".")[0] in _EVERY_NODE


def _names(direction: Direction | None) -> list[str]:
    """The parameters of a node; all of them when the direction is not known."""
    return [p.name for p in PARAMETERS.values() if direction is None or direction in p.directions]


def _unknown(name: str, origin: str, direction: Direction | None) -> ParameterError:
    """Say that there is no such parameter, and which there are."""
    known = _names(direction)
    hint = f"The parameters are {', '.join(known)}."
    if name in _TOPICS:
        hint = "Topics are not parameters here; choose them with --topic."
    elif "<<" in re.split(r"[./]", name):
        hint = "YAML's merge key (<<) is not supported; write the parameters out."
    if name in PARAMETERS:
        message = f"{direction} has no parameter {name!r} (from {origin})"
    else:
        message = f"unknown parameter {name!r} (from {origin})"
        close = difflib.get_close_matches(name.replace("-", "_"), [*known, *_ALIASES], n=1)
        if close:
            message += f"; did you mean {close[0]!r}?"
    return ParameterError(message, name=name, hint=hint)


# Scalars -----------------------------------------------------------------------------------------------

_TRUE = frozenset(["y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"])
_FALSE = frozenset(["n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"])
_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_INTEGER = re.compile(r"[-+]?([1-9][0-9]*|0[0-7]*|0[xX][0-9a-fA-F]+)")
_FLOAT = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_SPECIAL = re.compile(r"([-+]?)\.?(inf|Inf|INF|nan|NaN|NAN)")
_ANGLE = re.compile(r"(deg|rad)\((.*)\)")


def _plain_scalar(text: str) -> bool | int | float | str | None:
    """Read an unquoted scalar as ROS 2 does.

    Source of the rule: ``get_value`` of rcl_yaml_param_parser/src/parse.c tries YAML 1.1's booleans, then
    ``strtol`` with base 0, then ``strtod``; the rest is text. So ``1e5`` is a number, unlike in YAML 1.1.
    """
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if text in _NULL:
        return None
    if _INTEGER.fullmatch(text):
        return _integer(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    special = _SPECIAL.fullmatch(text)
    return float("".join(special.groups())) if special else text


def _integer(text: str) -> int | str:
    digits = text.lstrip("+-")
    base = 16 if digits[:2] in {"0x", "0X"} else 8 if digits[0] == "0" else 10
    try:
        return int(text, base)
    except ValueError:  # more digits than Python converts
        return text


_OPERATORS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


def _angle(unit: str, expression: str) -> float:
    """Radians of rosparam's ``deg(...)`` and ``rad(...)``.

    Numbers, ``pi``, parentheses and ``+ - * /`` are understood. Nothing is executed.
    Source of the rule: ``construct_angle_degrees`` and ``construct_angle_radians`` of ros_comm's rosparam.

    Raises
    ------
    ValueError
        If the expression is anything else.
    """
    if len(expression) > 100:
        raise ValueError(expression)
    try:
        value = _arithmetic(ast.parse(expression.strip(), mode="eval").body)
    except (SyntaxError, ArithmeticError) as err:
        raise ValueError(expression) from err
    # rosparam's order of operations, so that the last bit is the same.
    return value * math.pi / 180.0 if unit == "deg" else value


def _arithmetic(node: ast.expr) -> float:
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return float(number)
        case ast.Name(id="pi"):
            return math.pi
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_arithmetic(operand)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _arithmetic(operand)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_arithmetic(left), _arithmetic(right))
    raise ValueError(ast.dump(node))


def _written_angle(text: str) -> float | None:
    """Value of a text such as ``rad(pi/2)``; None if it is no such text or cannot be computed."""
    written = _ANGLE.fullmatch(text.strip())
    if written is None:
        return None
    try:
        return _angle(*written.groups())
    except ValueError:
        return None


# YAML --------------------------------------------------------------------------------------------------

_YAML_TAG = "tag:yaml.org,2002:"
#: What YAML itself makes of plain text; every other tag was written by hand.
_PLAIN_TAGS = frozenset(
    _YAML_TAG + kind for kind in ("str", "int", "float", "bool", "null", "timestamp", "merge", "value")
)
_ROS1_ANGLE_TAGS = {"!degrees": "deg", "!radians": "rad"}


def _compose(text: str, place: str) -> Any:
    """Parse YAML into ruamel's nodes, which know their lines; None for an empty document.

    Nodes instead of values: aliases stay shared (no expansion), tags construct nothing, and scalars
    are read by ROS's rules.
    """
    from ruamel.yaml import YAML  # noqa: PLC0415 - imported when a file or --param is given
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415

    # ROS 2's parser takes tabs between tokens, ruamel does not; in indentation both refuse them.
    spaced = re.sub(r"(?m)(?<=[^ \t\n])[ \t]*\t[ \t]*", lambda tabs: " " * len(tabs.group()), text)
    yaml = YAML(typ="safe", pure=True)
    # An anchor that is used again is legal, and no business of the user of one section.
    yaml.composer.warn_double_anchors = False
    try:
        return yaml.compose(spaced)
    except YAMLError as err:
        problem = getattr(err, "problem", None) or getattr(err, "reason", None) or "a syntax error"
        hint = "Indent with spaces, not with tabs." if r"'\t'" in str(problem) else None
        message = f"{place}, {_yaml_position(err, spaced)}: not valid YAML: {problem}"
        raise ParameterError(message, hint=hint) from err
    except RecursionError as err:
        raise ParameterError(f"{place}: nested too deeply") from err


def _yaml_position(err: Exception, text: str) -> str:
    """`line 3, column 5` of a YAML error: most carry a mark, unreadable characters only an index."""
    mark = getattr(err, "problem_mark", None)
    if mark is not None:
        return f"line {mark.line + 1}, column {mark.column + 1}"
    before = text[: getattr(err, "position", 0)]
    return f"line {before.count(chr(10)) + 1}, column {len(before) - before.rfind(chr(10))}"


def _at(node: Any) -> str:
    return f"line {node.start_mark.line + 1}, column {node.start_mark.column + 1}"


def _is_mapping(node: Any) -> bool:
    return bool(node.id == "mapping")


def _is_scalar(node: Any) -> bool:
    return bool(node.id == "scalar")


def _is_empty(node: Any) -> bool:
    """Whether nothing, or an empty mapping, was written."""
    return (_is_mapping(node) and not node.value) or (_is_scalar(node) and not node.style and not node.value)


def _scalar_value(node: Any, name: str, origin: str, *, ros1: bool) -> object:
    """Value of a scalar node.

    Raises
    ------
    ParameterError
        If it is a list or a mapping, or bears a tag that means more than plain text.
    """
    if not _is_scalar(node):
        found = "a mapping" if _is_mapping(node) else "a list"
        raise ParameterError(_expected(name, found, origin), name=name)
    if ros1 and node.tag in _ROS1_ANGLE_TAGS:
        unit = _ROS1_ANGLE_TAGS[node.tag]
        inner = _ANGLE.fullmatch(node.value.strip())
        try:
            return _angle(unit, inner[2] if inner else node.value)
        except ValueError as err:
            shown = f"{node.tag} {node.value}"
            raise ParameterError(_expected(name, shown, origin), name=name) from err
    if node.tag not in _PLAIN_TAGS:
        tag = node.tag.replace(_YAML_TAG, "!!")
        raise ParameterError(f"{name}: the YAML tag {tag} is not supported (from {origin})", name=name)
    if node.style:  # quoted, or a block of text
        return node.value
    angle = _written_angle(node.value) if ros1 else None
    return _plain_scalar(node.value) if angle is None else angle


# Types -------------------------------------------------------------------------------------------------

_EXPECTED = {"float": "a number", "bool": "true or false", "int": "a whole number", "str": "text"}


def _expected(name: str, found: str, origin: str) -> str:
    parameter = PARAMETERS.get(_ALIASES.get(name, name))
    expected = _EXPECTED[parameter.kind] if parameter else "a value"
    return f"{name}: expected {expected}, got {found} (from {origin})"


def _shown(value: object) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str | int | float):
        text = repr(value)
        return text if len(text) <= 80 else f"{text[:77]}..."
    return "a list" if isinstance(value, list | tuple) else repr(value)


def _typed(parameter: Parameter, setting: Setting) -> float | bool | str:
    """Value of a setting in the type of its parameter.

    A whole number is taken for a number; ROS 2 itself insists on ``30.0``. Nothing else is converted.
    """
    value = setting.value
    kind = parameter.kind
    if kind == "bool" and isinstance(value, bool):
        return value
    if kind == "str" and isinstance(value, str):
        return value
    if kind == "int" and isinstance(value, int) and not isinstance(value, bool):
        return value
    if kind == "float" and isinstance(value, int | float) and not isinstance(value, bool):
        # A whole number of 309 digits is no number that a parameter can have.
        with suppress(OverflowError):
            return float(value)
    raise ParameterError(
        _expected(setting.name, _shown(value), setting.origin),
        name=parameter.name,
        hint=_type_hint(parameter, value),
    )


def _type_hint(parameter: Parameter, value: object) -> str | None:
    if parameter.kind == "str" and isinstance(value, bool | int | float):
        return "YAML takes it for a number or a truth value; put it in quotes."
    if parameter.kind == "bool" and isinstance(value, int):
        return "Write true or false."
    if parameter.kind in {"float", "int"} and isinstance(value, str):
        angle = _written_angle(value)
        if angle is not None:
            return f"Only ROS 1 knows deg() and rad(); write {angle!r}."
        if not isinstance(_plain_scalar(value), str | bool | None):
            return "It is in quotes, which makes it text; leave them out."
    return None


# The sources -------------------------------------------------------------------------------------------


def parse_param(text: str) -> Setting:
    """Read ROS's notation for one parameter, ``name:=value``.

    Parameters
    ----------
    text
        As after ``--ros-args -p`` of ROS 2, where a node's name may come first (``node:name:=value``; it
        is not compared with anything), or as ROS 1 takes it (``_name:=value``). The value is a YAML
        scalar: ``1``, ``1.0``, ``.inf``, ``true``, ``"text"``; also ROS 1's ``deg(90)`` and
        ``rad(pi/2)``. Nothing after ``:=`` is the empty text.

    Returns
    -------
    Setting
        Its value is not checked; `resolve` does that.

    Raises
    ------
    ParameterError
        If there is no ``:=`` or no name, or the value is no YAML scalar.
    """
    rule, assigned, written = text.partition(":=")
    name = rule.rpartition(":")[2].strip().lstrip("_~")
    if not assigned:
        raise ParameterError(f"--param {text!r} has no ':='", hint="Write --param range_min:=0.5.")
    if not name:
        raise ParameterError(
            f"--param {text!r} has no name before ':='", hint="Write --param range_min:=0.5."
        )
    origin = f"--param {text}"
    if not written.strip():
        return Setting(name, "", origin)
    try:
        node = _compose(written, origin)
    except ParameterError as err:
        err.name = name
        raise
    value = None if node is None else _scalar_value(node, name, origin, ros1=True)
    return Setting(name, value, origin)


def load_params_file(path: Path, *, node: str | None = None) -> ParamsFile:
    """Read a ROS 2 parameter file or a ROS 1 YAML.

    A file with ``ros__parameters`` in it is ROS 2's: nodes by their names, with namespaces in the name or
    around it, ``/**`` and ``/*`` as wildcards. Anything else is ROS 1's: parameters, flat or
    below the name of the node, as ``rosparam load`` takes them, with ``deg(90)`` and ``rad(pi/2)``.

    The section taken is that of ``node``; or else of the only node with ``pointcloud_to_laserscan`` or
    ``laserscan_to_pointcloud`` in its name; or else the only section whose parameters are all upstream's.
    Sections with wildcards that match the node too are merged below it: the specific beats the wildcard
    (ROS 2 did so until Galactic; since Humble the later one in the file wins). What every ROS 2 node has
    (``use_sim_time``, ``qos_overrides``) is left out.

    Parameters
    ----------
    path
        The file: UTF-8, at most 1 MB.
    node
        Name of the node whose section is wanted, with or without its namespace.

    Returns
    -------
    ParamsFile
        Names are checked and known; types and values are not, `resolve` does that.

    Raises
    ------
    ParameterError
        If the file cannot be read or is not YAML (with line and column), a key is there twice, no section
        or several could be meant, a parameter is unknown to the node, or a value is not a scalar.
    """
    text = _read_text(path)
    root = _compose(text, str(path))
    if root is None or _is_empty(root):
        raise ParameterError(f"{path}: the file is empty")
    if not _is_mapping(root):
        found = "a list" if root.id == "sequence" else f"only the text {_shown(root.value)}"
        raise ParameterError(f"{path}: expected parameters as 'name: value', got {found}")
    leaves = []
    for leaf in _leaves(root, path, ()):
        leaves.append(leaf)
        if len(leaves) > len(text):  # impossible without aliases of aliases
            raise ParameterError(f"{path}: its aliases multiply to more values than the file has characters")
    ros1 = not any(_MARK in leaf.path for leaf in leaves)
    sections = _ros1_sections(leaves) if ros1 else _ros2_sections(leaves, path)
    target = _chosen(sections, node, path)
    if ros1:
        sections = _with_nested(sections, target)
    return _merged(sections, target, ros1=ros1)


def _read_text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except FileNotFoundError as err:
        raise ParameterError(f"{path}: there is no such file") from err
    except IsADirectoryError as err:
        raise ParameterError(f"{path}: this is a directory, not a parameter file") from err
    except OSError as err:
        raise ParameterError(f"{path}: cannot be read: {err.strerror or err}") from err
    if len(data) > MAX_FILE_BYTES:
        raise ParameterError(
            f"{path}: larger than {MAX_FILE_BYTES:,} bytes, which no parameter file is",
            hint="Was a recording given as --params-file?",
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        line = data.count(b"\n", 0, err.start) + 1
        raise ParameterError(
            f"{path}, line {line}: byte 0x{data[err.start]:02x} is not UTF-8 text",
            hint="Save the file as UTF-8.",
        ) from err


# Sections of a file ------------------------------------------------------------------------------------

_MARK = "ros__parameters"


@dataclass(frozen=True, slots=True)
class _Leaf:
    """A value in the file: the keys above it, its YAML node, and for the user its place."""

    path: tuple[str, ...]
    node: Any
    origin: str


#: Parameters by name, for each node by its fully qualified name (or pattern).
_Sections = dict[str, dict[str, _Leaf]]


def _leaves(mapping: Any, file: Path, above: tuple[str, ...]) -> Iterator[_Leaf]:
    """Every value below a mapping. Empty mappings count as values, and so does all that a parameter holds."""
    if len(above) > MAX_DEPTH:
        raise ParameterError(f"{file}, {_at(mapping)}: nested more than {MAX_DEPTH} levels deep")
    first_lines: dict[str, int] = {}
    for key, value in mapping.value:
        if not _is_scalar(key):
            raise ParameterError(f"{file}, {_at(key)}: a name must be plain text")
        name, line = str(key.value), key.start_mark.line + 1
        if name in first_lines:
            raise ParameterError(
                f"{file}, {_at(key)}: {name!r} is there twice, first in line {first_lines[name]}", name=name
            )
        first_lines[name] = line
        keys = (*above, name)
        if _is_mapping(value) and value.value and name not in _SCALAR_PARAMETERS:
            yield from _leaves(value, file, keys)
        else:
            yield _Leaf(keys, value, f"{file}, line {line}, {'.'.join(keys)}")


def _qualified(parts: Iterable[str]) -> str:
    """Fully qualified name of a node from the keys that lead to it."""
    return "/" + "/".join(token for part in parts for token in part.split("/") if token)


def _ros2_sections(leaves: Iterable[_Leaf], file: Path) -> _Sections:
    sections: _Sections = {}
    for leaf in leaves:
        if _MARK not in leaf.path:
            if _is_empty(leaf.node):
                continue
            raise ParameterError(
                f"{leaf.path[-1]!r} is outside of any ros__parameters (from {leaf.origin})",
                name=leaf.path[-1],
                hint="In a ROS 2 file the parameters of a node are below 'node_name: ros__parameters:'.",
            )
        mark = leaf.path.index(_MARK)
        section = sections.setdefault(_qualified(leaf.path[:mark]), {})
        name = ".".join(leaf.path[mark + 1 :])
        if name:
            section[name] = leaf
        elif not _is_empty(leaf.node):
            raise ParameterError(
                f"{file}, {_at(leaf.node)}: expected parameters below ros__parameters, got a single value"
            )
    return sections


def _ros1_sections(leaves: Iterable[_Leaf]) -> _Sections:
    """ROS 1 makes no difference between ``a: {b: 1}`` and ``a/b: 1``; the last part is the parameter."""
    sections: _Sections = {}
    for leaf in leaves:
        full = _qualified(key.removeprefix("~") for key in leaf.path)
        above, _, name = full.rpartition("/")
        if _is_empty(leaf.node) and name not in _SCALAR_PARAMETERS:
            sections.setdefault(full, {})
        else:
            sections.setdefault(above or "/", {})[name] = leaf
    return sections


def _with_nested(sections: _Sections, target: str) -> _Sections:
    """Add to a ROS 1 node what lies in namespaces below it: parameters too, by names with slashes."""
    below = target.rstrip("/") + "/"
    own = dict(sections[target])
    for full, parameters in sections.items():
        if full.startswith(below) and full != target:
            inner = full.removeprefix(below)
            own |= {f"{inner}/{name}": leaf for name, leaf in parameters.items()}
    return {target: own}


# Which section -----------------------------------------------------------------------------------------


def _chosen(sections: _Sections, node: str | None, file: Path) -> str:
    """Name of the node to take the parameters of: a key of ``sections``, or a name that wildcards match."""
    if node is not None:
        return _asked_for(sections, node, file)
    named = _most_specific([full for full in sections if _direction_of(full)])
    if len(named) == 1:
        return named[0]
    if named:
        raise ParameterError(
            f"{file}: several nodes could be meant: {', '.join(named)}",
            hint=f"Choose one with --node, for example --node {named[0]}.",
        )
    own = {full: _own_names(parameters) for full, parameters in sections.items()}
    upstreams = _most_specific([full for full, names in own.items() if _only_upstreams(names)])
    if len(upstreams) == 1:
        return upstreams[0]
    # Alone in the file and partly right, it is the one that was meant; its unknown names are told later.
    if len(own) == 1:
        [(only, names)] = own.items()
        if len(_foreign(names)) < len(names) or not names:
            return only
    raise ParameterError(
        f"{file}: no section is named pointcloud_to_laserscan or laserscan_to_pointcloud, and "
        f"{'several have' if upstreams else 'none has'} only their parameters; found {_listed(sections)}",
        hint="Choose one with --node." if upstreams else None,
    )


def _asked_for(sections: _Sections, node: str, file: Path) -> str:
    wanted = _qualified([node])
    if wanted in sections:
        return wanted
    if "/" not in node:
        ending = [full for full in sections if full.endswith(f"/{node}")]
        literal = _most_specific(ending)
        if len(literal) == 1:
            return literal[0]
        if literal:
            raise ParameterError(
                f"{file}: several nodes are named {node!r}: {', '.join(literal)}",
                hint="Give --node the whole name, with its namespace.",
            )
    if any(_matches(pattern, wanted) for pattern in sections):
        return wanted
    raise ParameterError(
        f"{file}: no section is for the node {node!r} (from --node); found {_listed(sections)}"
    )


def _listed(sections: Iterable[str]) -> str:
    names = sorted(sections)
    more = f" and {len(names) - 10} more" if len(names) > 10 else ""
    return (", ".join(names[:10]) or "none") + more


def _own_names(parameters: Iterable[str]) -> list[str]:
    return [name for name in parameters if not _is_every_nodes(name)]


def _foreign(names: Iterable[str]) -> list[str]:
    return [name for name in names if name not in _SCALAR_PARAMETERS and name not in _TOPICS]


def _only_upstreams(names: Collection[str]) -> bool:
    return not _foreign(names) and any(name in _SCALAR_PARAMETERS for name in names)


def _direction_of(full: str) -> Direction | None:
    """The direction that a node's name tells, whatever stands before or after upstream's name."""
    directions: tuple[Direction, ...] = get_args(Direction)
    last = full.rpartition("/")[2]
    return next((direction for direction in directions if direction in last), None)


def _vagueness(pattern: str) -> tuple[int, int, int]:
    """Sorts patterns: the less they say, the larger."""
    tokens = pattern.split("/")
    any_number, one = tokens.count("**"), tokens.count("*")
    return any_number, one, any_number + one - len(tokens)


def _matches(pattern: str, full: str) -> bool:
    """Whether a section is for a node: ``*`` is one part of the name, ``**`` any number of them.

    Source of the rule: ``parameter_map_from`` of rclcpp/src/rclcpp/parameter_map.cpp.
    """
    parts = {"*": "/[^/]+", "**": "(/[^/]+)*"}
    expression = "".join(parts.get(token, "/" + re.escape(token)) for token in pattern.split("/")[1:])
    return pattern == full or re.fullmatch(expression, full) is not None


def _most_specific(patterns: Collection[str]) -> list[str]:
    """The names without the wildcards that cover another of them."""
    return [
        one
        for one in patterns
        if not any(_vagueness(other) < _vagueness(one) and _matches(one, other) for other in patterns)
    ]


def _merged(sections: _Sections, target: str, *, ros1: bool) -> ParamsFile:
    """Merge what is meant for a node, wildcards below, and check the names."""
    # Stable, so that of two equally specific sections the later one wins, as in ROS 2.
    applying = sorted((s for s in sections if _matches(s, target)), key=_vagueness, reverse=True)
    direction = _direction_of(target)
    if direction is None and any(
        "laserscan_to_pointcloud" not in PARAMETERS[name].directions
        for section in applying
        for name in sections[section]
        if name in PARAMETERS
    ):
        direction = "pointcloud_to_laserscan"
    known = _names(direction)
    merged: dict[str, _Leaf] = {}
    ignored: list[str] = []
    for section in applying:
        parameters = sections[section]
        for written in _own_names(parameters):
            leaf = parameters[written]
            name = _ALIASES.get(written, written)
            if name in known and (name == written or name not in parameters):
                merged[name] = leaf
            elif written in _TOPICS or name in known or section != applying[-1]:
                ignored.append(leaf.origin)
            else:
                raise _unknown(written, leaf.origin, direction)
    settings = tuple(_file_setting(name, leaf, ros1=ros1) for name, leaf in merged.items())
    return ParamsFile(direction, settings, target, tuple(ignored))


def _file_setting(name: str, leaf: _Leaf, *, ros1: bool) -> Setting:
    value = _scalar_value(leaf.node, name, leaf.origin, ros1=ros1)
    # roscpp takes 0 and 1 for a bool; rclcpp refuses them.
    if ros1 and PARAMETERS[name].kind == "bool" and isinstance(value, int) and value in {0, 1}:
        value = bool(value)
    return Setting(name, value, leaf.origin)


# From settings to parameters ---------------------------------------------------------------------------


def resolve(
    settings_by_precedence: Iterable[Setting], *, direction: Direction = "pointcloud_to_laserscan"
) -> ResolvedParams:
    """Let the stronger setting win, check everything, and build the parameters.

    Parameters
    ----------
    settings_by_precedence
        The strongest first: command-line options, then ``--param`` **from the last to the first**, then
        the file's. Also those that lose are checked for name and type.
    direction
        The node that is replayed; ``laserscan_to_pointcloud`` has three of the parameters, and the
        others keep their defaults.

    Returns
    -------
    ResolvedParams
        What was not set has upstream's default.

    Raises
    ------
    ParameterError
        If a name is not one of the node's, a value has the wrong type or cannot be. The message names the
        parameter, the value and its origin; of limits that contradict each other, both origins.
    """
    known = _names(direction)
    values: dict[str, Any] = {}
    origin = dict.fromkeys(PARAMETERS, "default")
    for setting in settings_by_precedence:
        name = _ALIASES.get(setting.name, setting.name)
        if name not in known:
            raise _unknown(setting.name, setting.origin, direction)
        value = _typed(PARAMETERS[name], setting)
        if name not in values:
            values[name] = value
            origin[name] = setting.origin
    try:
        params = ProjectionParams(**values)
    except ParameterError as err:
        _raise_with_origin(err, origin)
    return ResolvedParams(params, origin)


def _raise_with_origin(err: ParameterError, origin: Mapping[str, str]) -> NoReturn:
    """Say where the values that an error is about were given."""
    named = [name for name in PARAMETERS if re.search(rf"\b{name}\b", err.message)]
    if all(origin[name] == "default" for name in named):
        # The default is innocent: what it does not fit is another parameter of its family.
        family = err.name.partition("_")[0]
        named = [name for name in origin if name.startswith(family) and origin[name] != "default"]
    if len(named) == 1 and named[0] == err.name:
        places = f"from {origin[err.name]}"
    else:
        places = "; ".join(
            f"{name} is the default" if origin[name] == "default" else f"{name} from {origin[name]}"
            for name in named
        )
    raise ParameterError(f"{err.message} ({places})", name=err.name, hint=err.hint) from err


# Writing a file ----------------------------------------------------------------------------------------


def render_params_file(params: ProjectionParams, *, direction: Direction = "pointcloud_to_laserscan") -> str:
    """Write a ROS 2 parameter file that reproduces a run, here or with upstream's node.

    Parameters
    ----------
    params
        Every value is written out, except a ``queue_size`` of 0: for pc2scan and, left out, for
        upstream it means the number of processor cores.
    direction
        Names the node, and leaves out what that node does not have.

    Returns
    -------
    str
        YAML that reads the same under YAML 1.1 and 1.2; floats keep every bit.
    """
    lines = [f"{direction}:", "  ros__parameters:"]
    for name in _names(direction):
        value = getattr(params, name)
        if name != "queue_size" or value:
            unit = PARAMETERS[name].unit
            lines.append(f"    {name}: {_rendered(value)}{f'  # {unit}' if unit else ''}")
    return "\n".join(lines) + "\n"


def _rendered(value: float | bool | str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{"".join(map(_escaped, value))}"'
    text = repr(value)
    if "inf" in text:
        return text.replace("inf", ".inf")
    # Without a dot, YAML 1.1 reads 1e+300 as text.
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _escaped(character: str) -> str:
    if character in '"\\':
        return f"\\{character}"
    return character if character.isprintable() else f"\\U{ord(character):08x}"

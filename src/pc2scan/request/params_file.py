"""Reads parameter files of ROS 2 and ROS 1, and launch files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, get_args

from pc2scan.errors import ParameterError, SeveralNodesError
from pc2scan.files.places import missing_hint
from pc2scan.files.source import open_bytes, refuse_pointer
from pc2scan.options.table import PARAMETERS
from pc2scan.text import did_you_mean, nearest

from .launch_file import is_launch_xml, launch_node
from .launch_node import ELSEWHERE, UnreadError
from .parameters import ALIASES, TOPICS, Direction, Setting, is_every_nodes, names_of, plain_scalar, unknown_parameter
from .redaction import may_quote, redact_file
from .yaml_nodes import compose, is_empty, is_mapping, is_scalar, place_of, scalar_value

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

    from .launch_node import LaunchNode, LaunchValue

#: Maximum size of a parameter file. A larger file was given by mistake.
MAX_FILE_BYTES = 1_000_000

#: Maximum number of levels of nesting. It also stops an alias that contains itself.
MAX_DEPTH = 50

#: The hint where no parameter file is found.
_EXAMPLE = "name a ROS parameter file or a launch file; each parameter is an option, too, such as `min_height=-0.3`"

#: Names that identify a section as one of upstream's nodes. pc2scan's own names (``geometry``, ``beams``) do not: any
#: node may use them, also for groups of parameters.
_OF_UPSTREAM = {name for name, parameter in PARAMETERS.items() if parameter.upstreams} | ALIASES.keys()


@dataclass(frozen=True, slots=True)
class ParamsFile:
    """The result of `load_params_file`.

    Attributes
    ----------
    direction
        The direction, by the node's name, or for a renamed node by its parameters; None if it is unknown.
    settings
        One for each parameter, in the order of the file.
    node
        Fully qualified name of the node (or the wildcard) whose section was read; ``/`` for the
        flat mapping of a ROS 1 file.
    ignored
        Origins of entries that were ignored: names of topics, wildcard parameters of another node, a
        ``concurrency_level`` together with a ``queue_size``. A warning lists them.
    remaps
        The remappings of a launch file, ``cloud_in:=/points``, of the node's topics and of the transforms'.
    files
        Other files that a launch file names, and that were read.
    hidden
        Files that the launch file names, whose content errors must not show, and the places that name them.
    """

    direction: Direction | None
    settings: tuple[Setting, ...]
    node: str
    ignored: tuple[str, ...] = ()
    remaps: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    hidden: tuple[tuple[str, str], ...] = ()


def load_params_file(
    path: Path,
    *,
    node: str | None = None,
    arguments: Mapping[str, str] | None = None,
    overridden: Collection[str] = (),
) -> ParamsFile:
    """Read a ROS 2 parameter file, a ROS 1 YAML, an XML launch file of either, or a Python launch file.

    A file with ``ros__parameters`` is one of ROS 2. It has nodes by their names, with namespaces in the name or as keys
    above it, and the wildcards ``/**`` and ``/*``. Any other file is one of ROS 1. It has parameters, flat or below the
    name of the node, like for ``rosparam load``, with ``deg(90)`` and ``rad(pi/2)``.

    The section of ``node`` is read. Without ``node``, it is the section of the only node with
    ``pointcloud_to_laserscan`` or ``laserscan_to_pointcloud`` in its name; otherwise the only section whose parameters
    are all upstream's. Sections with wildcards that match the node are merged into it; the specific section overrides
    the wildcard (like in ROS 2 until Galactic; since Humble, the later one in the file overrides). Parameters of every
    ROS 2 node (``use_sim_time``, ``qos_overrides``) are ignored.

    Parameters
    ----------
    path
        The file: UTF-8, at most 1 MB.
    node
        Name of the node whose section to read, with or without its namespace.
    arguments
        Arguments of a launch file; see `pc2scan.request.launch_file`.
    overridden
        Parameters, and topics in the node's names such as ``cloud_in``, whose values are given elsewhere: a launch file
        need not have them.

    Returns
    -------
    ParamsFile
        Names are checked; types and values are not, `resolve` checks them.

    Raises
    ------
    ParameterError
        If the file cannot be read or is not YAML (with line and column), a key appears twice, no section or several
        match, the node has no such parameter, or a value is not a scalar.
    """
    text = read_text(path)
    if path.suffix == ".py" or is_launch_xml(text):
        return _from_launch(text, path, node, arguments or {}, overridden)
    if arguments:
        raise ParameterError(f"{path}: only launch files have arguments", hint="remove `launch_args`")
    return _from_yaml(text, path, node)


def _from_yaml(text: str, path: Path, node: str | None) -> ParamsFile:
    root = compose(text, str(path))
    if root is None or is_empty(root):
        raise ParameterError(f"{path}: the file is empty")
    if not is_mapping(root):
        found = "a list" if root.id == "sequence" else "only a text"
        raise ParameterError(f"{path}: expected parameters as 'name: value', got {found}")
    leaves = []
    for leaf in _leaves(root, path, ()):
        leaves.append(leaf)
        if len(leaves) > len(text):  # only aliases of aliases can do this
            raise ParameterError(f"{path}: its aliases multiply to more values than the file has characters")
    ros1 = not any(_MARK in leaf.path for leaf in leaves)
    sections = _ros1_sections(leaves) if ros1 else _ros2_sections(leaves, path)
    target = _node_to_read(sections, node, path)
    if ros1:
        sections = _add_nested(sections, target)
    return _merge_sections(sections, target, ros1=ros1)


def _from_launch(
    text: str, path: Path, node: str | None, arguments: Mapping[str, str], overridden: Collection[str]
) -> ParamsFile:
    """Read a node's parameters from a launch file; a later value replaces an earlier one."""
    found, file = launch_node(text, path, arguments, node)
    remaps = found.remaps(path, overridden)
    settings: dict[str, Setting] = {}
    ignored = list(file.ignored)
    files: list[Path] = []
    hidden: list[tuple[str, str]] = []
    for param in found.values:
        place = f"{path}, line {param.line}"
        if param.kind == "remap":
            continue
        if isinstance(param.value, UnreadError):
            name = ALIASES.get(param.name, param.name)
            if param.kind != "value" or (name in PARAMETERS and name not in overridden):
                raise _unread(name, param.value, path)
            continue
        if param.kind == "file":
            loaded = _named_file(Path(param.value), place, found)
            files.append(Path(param.value))
            hidden.append((param.value, place))
            # Their names are content of the file.
            ignored += [re.sub(r"(, line \d+), .*", r"\1", origin) for origin in loaded.ignored]
            settings |= {setting.name: setting for setting in loaded.settings}
            continue
        for written, value in _launch_values(param, param.value, path, place):
            name, origin = ALIASES.get(written, written), f"{place}, {written}"
            if is_every_nodes(written):
                continue
            if name in names_of(found.direction):
                settings[name] = Setting(name, _as_bool(name, value), origin, "file")
            elif written not in TOPICS and nearest(written, PARAMETERS):
                raise unknown_parameter(written, origin, found.direction)
            else:
                # The node ignores a parameter that it does not declare.
                ignored.append(origin)
    return ParamsFile(
        found.direction,
        tuple(settings.values()),
        found.name,
        tuple(ignored),
        remaps,
        tuple(files),
        tuple(hidden),
    )


def _unread(name: str, err: UnreadError, path: Path) -> ParameterError:
    """Return the error about a value that is not read of a launch file."""
    hint = err.hint or (f"give its value: `{name}=...`" if name in PARAMETERS else ELSEWHERE)
    return ParameterError(f"{name}: {err.problem} (from {path}, line {err.line})", name=name, hint=hint)


def _named_file(file: Path, place: str, node: LaunchNode) -> ParamsFile:
    """Read a parameter file that a launch file names. Errors do not quote it, because it may be any file."""
    try:
        text = read_text(file)
        if not is_launch_xml(text):
            return _section_for(node.name, text, file)
    except ParameterError as err:
        if may_quote(err, file):
            raise redact_file(err, file, place) from None
        raise
    raise ParameterError(f"{file}: is a launch file, where parameters are expected (from {place})")


def _launch_values(param: LaunchValue, text: str, path: Path, place: str) -> list[tuple[str, object]]:
    """Return the names and values of a parameter of a launch file."""
    if param.kind != "yaml":
        return [(param.name, _launch_value(param, text))]
    root = compose(text, place)
    if root is None or not is_mapping(root):
        raise ParameterError(f"{place}: expected parameters as 'name: value' in <rosparam>")
    return [
        (".".join(leaf.path), scalar_value(leaf.node, leaf.path[-1], f"{place}, {'.'.join(leaf.path)}", ros1=True))
        for leaf in _leaves(root, path, ())
    ]


def _section_for(node: str, text: str, file: Path) -> ParamsFile:
    """Return the section of a node that a launch file starts, or the section that is read without a launch file."""
    try:
        return _from_yaml(text, file, node)
    except ParameterError:
        return _from_yaml(text, file, None)


def _launch_value(param: LaunchValue, written: str) -> object:
    text = written.strip()
    quoted = re.fullmatch(r"'(.*)'|\"(.*)\"", text)
    if quoted:
        return quoted[1] if quoted[1] is not None else quoted[2]
    parameter = PARAMETERS.get(ALIASES.get(param.name, param.name))
    if param.type in {"str", "string"} or (parameter and parameter.value.kind == "str"):
        return written
    return plain_scalar(text)


def _as_bool(name: str, value: object) -> object:
    """Read 0 and 1 as truth values, as roscpp does."""
    if PARAMETERS[name].value.kind == "bool" and isinstance(value, int) and value in {0, 1}:
        return bool(value)
    return value


def read_text(path: Path, example: str = _EXAMPLE) -> str:
    """Return the text of a parameter file; ``example`` is the hint if there is none."""
    try:
        with open_bytes(path) as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except FileNotFoundError as err:
        hint = missing_hint(path, (".yaml", ".yml")) or example
        raise ParameterError(f"{path}: does not exist", hint=hint) from err
    except IsADirectoryError as err:
        raise ParameterError(f"{path}: this is a directory, not a parameter file") from err
    except OSError as err:
        raise ParameterError(f"{path}: cannot be read: {err.strerror or err}") from err
    if len(data) > MAX_FILE_BYTES:
        raise ParameterError(
            f"{path}: larger than {MAX_FILE_BYTES:,} bytes, the maximum for parameter files",
            hint="was a recording given as the parameter file?",
        )
    refuse_pointer(data, path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        line = data.count(b"\n", 0, err.start) + 1
        raise ParameterError(
            f"{path}, line {line}: byte 0x{data[err.start]:02x} is not UTF-8 text",
            hint="save the file as UTF-8",
        ) from err


_MARK = "ros__parameters"


@dataclass(frozen=True, slots=True)
class _Leaf:
    """A value in the file: the keys above it, its YAML node, and its place as text."""

    path: tuple[str, ...]
    node: Any
    origin: str


#: For each node, by its fully qualified name or pattern: its parameters by name.
_Sections = dict[str, dict[str, _Leaf]]


def _leaves(mapping: Any, file: Path, above: tuple[str, ...]) -> Iterator[_Leaf]:
    """Yield every value below a mapping. Empty mappings and the values of parameters are not divided further."""
    if len(above) > MAX_DEPTH:
        raise ParameterError(f"{file}, {place_of(mapping)}: nested more than {MAX_DEPTH} levels deep")
    first_lines: dict[str, int] = {}
    for key, value in mapping.value:
        if not is_scalar(key):
            raise ParameterError(f"{file}, {place_of(key)}: a name must be plain text")
        name, line = str(key.value), key.start_mark.line + 1
        if name in first_lines:
            raise ParameterError(
                f"{file}, {place_of(key)}: {name!r} is given twice, first in line {first_lines[name]}",
                name=name,
            )
        first_lines[name] = line
        keys = (*above, name)
        if is_mapping(value) and value.value and name not in _OF_UPSTREAM:
            yield from _leaves(value, file, keys)
        else:
            yield _Leaf(keys, value, f"{file}, line {line}, {'.'.join(keys)}")


def _qualified(parts: Iterable[str]) -> str:
    """Return the fully qualified name of a node from the keys above it."""
    return "/" + "/".join(token for part in parts for token in part.split("/") if token)


def _ros2_sections(leaves: Iterable[_Leaf], file: Path) -> _Sections:
    sections: _Sections = {}
    for leaf in leaves:
        if _MARK not in leaf.path:
            if is_empty(leaf.node):
                continue
            raise ParameterError(
                f"{leaf.path[-1]!r} is outside of any ros__parameters (from {leaf.origin})",
                name=leaf.path[-1],
                hint="in a ROS 2 file the parameters of a node are below 'node_name: ros__parameters:'",
            )
        mark = leaf.path.index(_MARK)
        section = sections.setdefault(_qualified(leaf.path[:mark]), {})
        name = ".".join(leaf.path[mark + 1 :])
        if name:
            section[name] = leaf
        elif not is_empty(leaf.node):
            raise ParameterError(
                f"{file}, {place_of(leaf.node)}: expected parameters below ros__parameters, got a single value"
            )
    return sections


def _ros1_sections(leaves: Iterable[_Leaf]) -> _Sections:
    """Return the sections of a ROS 1 file, where ``a: {b: 1}`` equals ``a/b: 1``; the last part is the parameter."""
    sections: _Sections = {}
    for leaf in leaves:
        full = _qualified(key.removeprefix("~") for key in leaf.path)
        above, _, name = full.rpartition("/")
        if is_empty(leaf.node) and name not in _OF_UPSTREAM:
            sections.setdefault(full, {})
        else:
            sections.setdefault(above or "/", {})[name] = leaf
    return sections


def _add_nested(sections: _Sections, target: str) -> _Sections:
    """Add to a ROS 1 node the parameters in namespaces below it, whose names have slashes."""
    below = target.rstrip("/") + "/"
    own = dict(sections[target])
    for full, parameters in sections.items():
        if full.startswith(below) and full != target:
            inner = full.removeprefix(below)
            own |= {f"{inner}/{name}": leaf for name, leaf in parameters.items()}
    return {target: own}


def _node_to_read(sections: _Sections, node: str | None, file: Path) -> str:
    """Return the name of the node to read: a key of ``sections``, or a name that wildcards match."""
    if node is not None:
        return _asked_for(sections, node, file)
    named = _most_specific([full for full in sections if _direction_of(full)])
    if len(named) == 1:
        return named[0]
    if named:
        _raise_several(f"{file}: several nodes match: {', '.join(named)}", named)
    own = {full: _own_names(parameters) for full, parameters in sections.items()}
    upstreams = _most_specific([full for full, names in own.items() if _only_upstreams(names)])
    if len(upstreams) == 1:
        return upstreams[0]
    # A single section with some known names is used; its unknown names are reported later.
    if len(own) == 1:
        [(only, names)] = own.items()
        if len(_foreign(names)) < len(names) or not names:
            return only
    message = f"{file}: no section is named pointcloud_to_laserscan or laserscan_to_pointcloud, and "
    if upstreams:
        _raise_several(f"{message}several have only their parameters; found {_section_names(sections)}", upstreams)
    raise ParameterError(
        f"{message}none has only their parameters; found {_section_names(sections)}",
        hint=f"choose one, for example `node={min(sections)}`" if sections else None,
    )


def _raise_several(message: str, nodes: list[str]) -> NoReturn:
    """Raise because several nodes match. The error lists them as nodes of one conversion if all make scans."""
    hint = f"choose one, for example `node={nodes[0]}`"
    if any("*" in node or _direction_of(node) == "laserscan_to_pointcloud" for node in nodes):
        raise ParameterError(message, hint=hint)
    raise SeveralNodesError(message, nodes=tuple(nodes), hint=hint)


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
                hint="give the full name in `node`, with its namespace",
            )
    if any(_matches(pattern, wanted) for pattern in sections):
        return wanted
    near = did_you_mean(node, sections) or None
    raise ParameterError(
        f"{file}: no section is for the node {node!r} (from `node`); found {_section_names(sections)}", hint=near
    )


def _section_names(sections: Iterable[str]) -> str:
    names = sorted(sections)
    more = f" and {len(names) - 10} more" if len(names) > 10 else ""
    return (", ".join(names[:10]) or "none") + more


def _own_names(parameters: Iterable[str]) -> list[str]:
    return [name for name in parameters if not is_every_nodes(name)]


def _foreign(names: Iterable[str]) -> list[str]:
    return [name for name in names if name not in PARAMETERS and name not in ALIASES and name not in TOPICS]


def _only_upstreams(names: Collection[str]) -> bool:
    return not _foreign(names) and any(name in _OF_UPSTREAM for name in names)


def _direction_of(full: str) -> Direction | None:
    """Return the direction of a node whose name contains the name of one of upstream's nodes."""
    directions: tuple[Direction, ...] = get_args(Direction)
    last = full.rpartition("/")[2]
    return next((direction for direction in directions if direction in last), None)


def _vagueness(pattern: str) -> tuple[int, int, int]:
    """Return a sort key of patterns: larger for less specific ones."""
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
    """Return the names without wildcards that match another name."""
    return [
        one
        for one in patterns
        if not any(_vagueness(other) < _vagueness(one) and _matches(one, other) for other in patterns)
    ]


def _merge_sections(sections: _Sections, target: str, *, ros1: bool) -> ParamsFile:
    """Merge the sections that apply to a node, wildcards below, and check the names."""
    # The sort is stable, so that the later one of two equally specific sections is used, like in ROS 2.
    applying = sorted((s for s in sections if _matches(s, target)), key=_vagueness, reverse=True)
    direction = _direction_of(target)
    if direction is None and any(
        not PARAMETERS[name].is_shared
        for section in applying
        for name in sections[section]
        if name in PARAMETERS and PARAMETERS[name].upstreams
    ):
        direction = "pointcloud_to_laserscan"
    known = names_of(direction)
    merged: dict[str, _Leaf] = {}
    ignored: list[str] = []
    for section in applying:
        parameters = sections[section]
        for written in _own_names(parameters):
            leaf = parameters[written]
            name = ALIASES.get(written, written)
            # In a section for several nodes, an unknown name belongs to another node.
            named = section == applying[-1] or _direction_of(section) is not None
            ours = name in known and (named or PARAMETERS[name].upstreams)
            if ours and (name == written or name not in parameters):
                merged[name] = leaf
            elif written in TOPICS or name in known or section != applying[-1]:
                ignored.append(leaf.origin)
            else:
                raise unknown_parameter(written, leaf.origin, direction)
    settings = tuple(_file_setting(name, leaf, ros1=ros1) for name, leaf in merged.items())
    return ParamsFile(direction, settings, target, tuple(ignored))


def _file_setting(name: str, leaf: _Leaf, *, ros1: bool) -> Setting:
    value = scalar_value(leaf.node, name, leaf.origin, ros1=ros1)
    # roscpp reads 0 and 1 as a bool, rclcpp does not.
    return Setting(name, _as_bool(name, value) if ros1 else value, leaf.origin, "file")

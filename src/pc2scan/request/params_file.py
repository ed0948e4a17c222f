"""Reads parameter files of ROS 2 and ROS 1, and launch files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import ParameterError, name_list
from pc2scan.options.call import Options
from pc2scan.options.projection import SHARED, NodeParameters
from pc2scan.options.table import PARAMETERS
from pc2scan.text import did_you_mean, nearest

from .entries import Entry, entries_in, naming_place, read_text, scalar_value
from .launch import ELSEWHERE, LaunchFile, UnreadError, qualified
from .precedence import (
    ALIASES,
    TOPICS,
    is_every_nodes,
    plain_scalar,
    resolve,
    unknown_parameter,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    from .launch import LaunchNode, LaunchValue

#: The hint where no parameter file is found.
_EXAMPLE = "name a ROS parameter file or a launch file; each parameter is an option, too, such as `min_height=-0.3`"

#: Names that identify a section as one of upstream's nodes. pc2scan's own names (``geometry``, ``beams``) do not: any
#: node may use them, also for groups of parameters.
_OF_UPSTREAM = NodeParameters.__annotations__.keys() | ALIASES.keys()

#: Topics of the node whose remappings in launch files are read.
_REMAPPED = {"cloud_in", "scan", "tf", "tf_static"}


class ParamsFile(NamedTuple):
    """What is read of a parameter file or a launch file.

    Attributes
    ----------
    options
        The parameters, and where they are written.
    reverse
        Whether scans become clouds, by the node's name, or for a renamed node by its parameters; None if it is unknown.
    node
        Fully qualified name of the node (or the wildcard) whose section was read; ``/`` for the
        flat mapping of a ROS 1 file.
    ignored
        Origins of entries that were ignored: names of topics, wildcard parameters of another node, a
        ``concurrency_level`` together with a ``queue_size``. A warning lists them.
    remaps
        What a launch file remaps of the node's topics, such as ``cloud_in``, and of the transforms'.
    files
        Other files that a launch file names, and that were read.
    """

    options: Options
    reverse: bool | None = None
    node: str = ""
    ignored: tuple[str, ...] = ()
    remaps: Mapping[str, str] = {}
    files: tuple[Path, ...] = ()


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
    are all upstream's. Sections with wildcards that match the node apply, too; the later one in the file overrides.
    Parameters of every ROS 2 node (``use_sim_time``, ``qos_overrides``) are ignored.

    Parameters
    ----------
    path
        The file: UTF-8, at most 1 MB.
    node
        Name of the node whose section to read, with or without its namespace.
    arguments
        Arguments of a launch file; the others have the defaults in the file.
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
        If the file cannot be read or is not YAML (with its line), a key appears twice, no section or several
        match, the node has no such parameter, or a value is not a scalar.
    """
    text = read_text(path, _EXAMPLE)
    # No YAML file of parameters begins with ``<``.
    if path.suffix == ".py" or re.match(r"\s*<[?!a-zA-Z]", text):
        return _from_launch(text, path, node, arguments or {}, overridden)
    if arguments:
        raise ParameterError(f"{path}: only launch files have arguments", hint="remove `launch_args`")
    return _from_yaml(text, path, node)


def _from_launch(
    text: str, path: Path, node: str | None, arguments: Mapping[str, str], overridden: Collection[str]
) -> ParamsFile:
    """Read a node's parameters from a launch file; a later value replaces an earlier one."""
    chosen, file = _launch_node(text, path, arguments, node)
    values, origins = dict[str, object](), dict[str, str]()
    remaps: dict[str, str] = {}
    ignored, files = file.ignored, list[Path]()
    for param in chosen.values:
        place, name = f"{path}, line {param.line}", param.name.strip("~/")
        if param.kind == "remap" and name not in _REMAPPED:
            continue
        if isinstance(param.value, UnreadError):
            name = ALIASES.get(name, name)
            if name not in overridden and (param.kind != "value" or name in PARAMETERS):
                raise _unread(param, name, param.value, path)
        elif param.kind == "remap":
            remaps[name] = qualified(chosen.namespace, param.value)
        elif param.kind == "file":
            named = path.parent / param.value
            loaded = _named_file(named, place, chosen)
            files.append(named)
            # Their names are content of the file.
            ignored += [re.sub(r"(, line \d+), .*", r"\1", origin) for origin in loaded.ignored]
            values |= loaded.options.given
            origins |= loaded.options.origins
        else:
            for written, value in _launch_values(param, param.value, place):
                name, origin = ALIASES.get(written, written), f"{place}, {written}"
                if name in PARAMETERS:
                    values[name], origins[name] = _as_bool(name, value), origin
                elif written not in TOPICS and nearest(written, PARAMETERS):
                    raise unknown_parameter(written, origin)
                elif not is_every_nodes(written):
                    # The node ignores a parameter that it does not declare.
                    ignored.append(origin)
    options = Options("convert", values, origins)
    return ParamsFile(options, False, chosen.name, tuple(ignored), remaps, tuple(files))


def _launch_node(
    text: str, path: Path, arguments: Mapping[str, str], node: str | None
) -> tuple[LaunchNode, LaunchFile]:
    """Find the node of a launch file.

    Parameters
    ----------
    text, path
        The file: Python if its name ends in ``.py``, otherwise XML.
    arguments
        Values of its arguments; the others have the defaults in the file.
    node
        Name of the node, with or without its namespace; None: the only node in the file.

    Raises
    ------
    ParameterError
        If the text is not a launch file, a text that it needs is not read, there is no node of
        pointcloud_to_laserscan, or more than one.
    """
    try:
        file = LaunchFile(text, path, arguments)
    except (RecursionError, MemoryError) as err:
        raise ParameterError(f"{path}: nested too deeply") from err
    for unused in sorted(arguments.keys() - file.arguments):
        known = f"{did_you_mean(unused, file.arguments)} its arguments are {name_list(sorted(file.arguments))}"
        raise ParameterError(f"{path}: it has no argument {unused!r}", hint=known.strip())
    if not file.nodes and (file.ignored or not file.unread):
        hint = f"not followed: {name_list(file.ignored)}; name the file that has the node" if file.ignored else None
        raise ParameterError(f"{path}: no node of pointcloud_to_laserscan in it", hint=hint)
    for unread in file.unread:
        message = f"what may be the node or change it: {unread.problem} (from {path}, line {unread.line})"
        raise ParameterError(message, hint=unread.hint or ELSEWHERE)
    matches = [section for section in file.nodes if node is None or f"{section.name}/".endswith(f"/{node.strip('/')}/")]
    _refuse_several([section.name for section in matches], [section.name for section in file.nodes], node, path)
    chosen = matches[0]
    if chosen.doubt and node is None:
        message = f"{path}, line {chosen.line}: {chosen.name} is {chosen.doubt}"
        raise ParameterError(f"{message}, and read only if `node` names it", hint=f"`node={chosen.name}`")
    return chosen, file


def _refuse_several(matches: Sequence[str], names: Iterable[str], node: str | None, path: Path) -> None:
    """Raise if several of the nodes of a file match, or none."""
    nodes = sorted(matches or names)
    hint = f"choose one, for example `node={nodes[0]}`" if len({*nodes}) == len(nodes) else ELSEWHERE
    if len(matches) > 1:
        raise ParameterError(f"{path}: several nodes match: {name_list(matches)}", hint=hint)
    if not matches:
        what = "section is named pointcloud_to_laserscan or laserscan_to_pointcloud, and none has only their parameters"
        if node is not None:
            what, hint = f"node {node!r} (from `node`)", did_you_mean(node, nodes)
        raise ParameterError(f"{path}: no {what}; found {name_list(nodes, 10)}", hint=hint or None)


def _unread(param: LaunchValue, name: str, err: UnreadError, path: Path) -> ParameterError:
    """Return the error about a value that is not read of a launch file."""
    hint = f"give its value: `{name}=...`" if name in PARAMETERS else ELSEWHERE
    if param.kind == "remap":
        hint = f"give it: `remap={name}:=/TOPIC`"
    return ParameterError(f"{name}: {err.problem} (from {path}, line {err.line})", name=name, hint=err.hint or hint)


def _named_file(file: Path, place: str, node: LaunchNode) -> ParamsFile:
    """Read a parameter file that a launch file names. Errors do not quote it, because it may be any file."""
    with naming_place({}, "", [(file, place, "params_file")]):
        text = read_text(file, _EXAMPLE)
        try:
            params = _from_yaml(text, file, node.name)
        except ParameterError:
            params = _from_yaml(text, file, None)
        resolve([params.options])
        return params


def _launch_values(param: LaunchValue, text: str, place: str) -> list[tuple[str, object]]:
    """Return the names and values of a parameter of a launch file."""
    if param.kind == "yaml":
        return [(".".join(leaf.path), leaf.read(leaf.path[-1], ros1=True)) for leaf in _leaves_in(text, place)]
    if quoted := re.fullmatch(r"\s*(['\"])(.*)\1\s*", text):
        return [(param.name, quoted[2])]
    parameter = PARAMETERS.get(param.name)
    is_text = parameter is not None and parameter.value.kind == "str"
    return [(param.name, text if is_text else plain_scalar(text.strip()))]


def _as_bool(name: str, value: object) -> object:
    """Read 0 and 1 as truth values, as roscpp does."""
    if PARAMETERS[name].value.kind == "bool" and isinstance(value, int) and value in {0, 1}:
        return bool(value)
    return value


_MARK = "ros__parameters"


class _Leaf(NamedTuple):
    """A value in the file: the keys above it, the value, and its place as text."""

    path: tuple[str, ...]
    entry: Entry
    origin: str

    @property
    def is_empty(self) -> bool:
        """Whether it is null or an empty mapping."""
        value = self.entry.value
        return not value if isinstance(value, dict) else not isinstance(value, list) and self.entry.text is None

    def read(self, name: str, *, ros1: bool) -> object:
        """Return its value as that of a parameter."""
        value = self.entry.value
        return value if isinstance(value, dict | list) else scalar_value(value, name, self.origin, ros1=ros1)


#: For each node, by its fully qualified name or pattern: its parameters by name.
_Sections = dict[str, dict[str, _Leaf]]


def _from_yaml(text: str, path: Path, node: str | None) -> ParamsFile:
    leaves = list(_leaves_in(text, path))
    ros1 = not any(_MARK in leaf.path for leaf in leaves)
    sections: _Sections = {}
    for leaf in leaves:
        full, name = _ros1_name(leaf) if ros1 else _ros2_name(leaf)
        sections.setdefault(full, {})
        if name:
            sections[full][name] = leaf
    return _merge_sections(sections, _node_to_read(sections, node, path), ros1=ros1)


def _leaves_in(text: str, path: Path | str) -> Iterator[_Leaf]:
    """Return every value of a file."""
    root = entries_in(text, path, _EXAMPLE, scalar=lambda node, *_: node)
    if not isinstance(root.value, dict):
        kind = "a list" if isinstance(root.value, list) else "only a text"
        raise ParameterError(f"{path}: expected parameters as 'name: value', got {kind}")
    return _leaves(root, ())


def _leaves(mapping: Entry, above: tuple[str, ...]) -> Iterator[_Leaf]:
    """Yield every value below a mapping. Empty mappings and the values of parameters are not divided further."""
    for name, entry in mapping.value.items():
        keys = (*above, name)
        if isinstance(entry.value, dict) and entry.value and name not in _OF_UPSTREAM:
            yield from _leaves(entry, keys)
        else:
            yield _Leaf(keys, entry, f"{entry.place}, {'.'.join(keys)}")


def _full_name(parts: tuple[str, ...]) -> str:
    """Return the fully qualified name of a node from the keys above it."""
    return "/" + "/".join(token for part in parts for token in part.removeprefix("~").split("/") if token)


def _ros1_name(leaf: _Leaf) -> tuple[str, str]:
    """Return a node and its parameter; in ROS 1, ``a: {b: 1}`` equals ``a/b: 1``."""
    full = _full_name(leaf.path)
    above, _, name = full.rpartition("/")
    return (full, "") if leaf.is_empty and name not in _OF_UPSTREAM else (above or "/", name)


def _ros2_name(leaf: _Leaf) -> tuple[str, str]:
    """Return a node and its parameter."""
    if _MARK not in leaf.path and not leaf.is_empty:
        raise ParameterError(
            f"{leaf.path[-1]!r} is outside of any ros__parameters (from {leaf.origin})",
            name=leaf.path[-1],
            hint="in a ROS 2 file the parameters of a node are below 'node_name: ros__parameters:'",
        )
    mark = leaf.path.index(_MARK) if _MARK in leaf.path else len(leaf.path)
    name = ".".join(leaf.path[mark + 1 :])
    if not name and not leaf.is_empty:
        raise ParameterError(f"{leaf.entry.place}: expected parameters below ros__parameters, got a single value")
    return _full_name(leaf.path[:mark]), name


def _node_to_read(sections: _Sections, node: str | None, file: Path) -> str:
    """Return the name of the node to read: a key of ``sections``, or a name that wildcards match."""
    matches = _matching_nodes(sections, node)
    matches = [full for full in matches if "*" not in full] or matches
    _refuse_several(matches, sections, node, file)
    return matches[0]


def _matching_nodes(sections: _Sections, node: str | None) -> list[str]:
    """Return the nodes that may be read: the requested ones, or else those of pointcloud_to_laserscan."""
    if node is not None:
        full_name = _full_name((node,))
        ending = [full_name] if full_name in sections else [full for full in sections if full.endswith(f"/{node}")]
        return ending or [full_name] * any(_matches(pattern, full_name) for pattern in sections)
    own = {full: [name for name in parameters if not is_every_nodes(name)] for full, parameters in sections.items()}
    foreign = {full: [name for name in own[full] if name not in {*PARAMETERS, *ALIASES, *TOPICS}] for full in own}
    upstreams = [full for full in own if not foreign[full] and _OF_UPSTREAM.intersection(own[full])]
    # A single section with some known names is used; its unknown names are reported later.
    only = [full for full in own if len(own) == 1 and (not own[full] or len(foreign[full]) < len(own[full]))]
    return [full for full in sections if _reverses(full) is not None] or upstreams or only


def _reverses(full: str) -> bool | None:
    """Return whether a node makes clouds of scans; None if its name contains the name of neither node."""
    names = {"pointcloud_to_laserscan": False, "laserscan_to_pointcloud": True}
    return next((reverse for name, reverse in names.items() if name in full.rpartition("/")[2]), None)


def _matches(pattern: str, full: str) -> bool:
    """Whether a section is for a node: ``*`` is one part of the name, ``**`` any number of them.

    Source of the rule: ``parameter_map_from`` of rclcpp/src/rclcpp/parameter_map.cpp.
    """
    parts = {"*": "/[^/]+", "**": "(/[^/]+)*"}
    expression = "".join(parts.get(token, "/" + re.escape(token)) for token in pattern.split("/")[1:])
    return pattern == full or re.fullmatch(expression, full) is not None


def _merge_sections(sections: _Sections, target: str, *, ros1: bool) -> ParamsFile:
    """Merge the sections that apply to a node, and check the names; a later section overrides, as in ROS 2."""
    applying = {full: parameters for full, parameters in sections.items() if _matches(full, target)}
    given = {name for parameters in applying.values() for name in parameters} & PARAMETERS.keys()
    reverse = _reverses(target)
    if reverse is None and given & _OF_UPSTREAM - SHARED:
        reverse = False
    known = SHARED if reverse else PARAMETERS.keys()
    values, origins = dict[str, object](), dict[str, str]()
    ignored: list[str] = []
    for full, parameters in applying.items():
        # In a section for several nodes, an unknown name belongs to another node.
        is_own = full == target or _reverses(full) is not None
        for written, leaf in parameters.items():
            name = ALIASES.get(written, written)
            is_ours = name in known and (is_own or name in _OF_UPSTREAM)
            if is_ours and (name == written or name not in parameters):
                value = leaf.read(name, ros1=ros1)
                # roscpp reads 0 and 1 as a bool, rclcpp does not.
                values[name], origins[name] = _as_bool(name, value) if ros1 else value, leaf.origin
            elif written in TOPICS or name in PARAMETERS or not is_own:
                ignored += [leaf.origin] * (not is_every_nodes(written))
            elif not is_every_nodes(written):
                raise unknown_parameter(written, leaf.origin)
    return ParamsFile(Options("convert", values, origins), reverse, target, tuple(ignored))

"""Collects the parameters of a conversion from every place where a user can give them; reads ROS's ``name:=value``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.core.presets import PRESETS
from pc2scan.errors import ParameterError, UsageError
from pc2scan.options.table import PARAMETERS
from pc2scan.text import did_you_mean

from .entries import compose, scalar_value
from .options import TopicRequest
from .parameters import ALIASES, ParamsFile, Setting, expected_message, is_every_nodes, resolve
from .params_file import load_params_file

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence
    from pathlib import Path

    from .parameters import Direction, ResolvedParams


def resolve_sources(
    settings: Sequence[Setting],
    *,
    assignments: Sequence[str] = (),
    file: Path | None = None,
    node: str | None = None,
    launch_args: Sequence[str] = (),
    preset: str | None = None,
    reverse: bool = False,
    remapped: Collection[str] = (),
) -> ResolvedParams:
    """Resolve parameters: ``settings`` override ``assignments``, which override the file, which overrides the preset.

    Parameters
    ----------
    settings
        Parameters that are given as options or keywords.
    assignments
        Texts for `parse_params`; a later one overrides an earlier one.
    file, node
        A parameter file or a launch file, and the node whose section of it is read.
    launch_args
        Arguments of a launch file, ``name:=value``.
    preset
        The name of a consumer.
    reverse
        Whether scans become clouds. A section ``laserscan_to_pointcloud`` of the file has the same effect.
    remapped
        The node's topics, such as ``cloud_in``, that are given elsewhere.

    Raises
    ------
    UsageError
        If a parameter, the file or the preset is not valid, or the file is for the other direction.
    """
    merged = [*settings, *parse_params(assignments)]
    loaded = ParamsFile()
    if file is not None:
        given = {ALIASES.get(setting.name, setting.name) for setting in merged}
        arguments = _launch_arguments(launch_args)
        loaded = load_params_file(file, node=node, arguments=arguments, overridden={*given, *remapped})
        merged += loaded.settings
        if reverse and loaded.direction == "pointcloud_to_laserscan":
            raise UsageError(f"{loaded.node} is for pointcloud_to_laserscan, `reverse=True` is not", path=file)
        reverse = reverse or loaded.direction == "laserscan_to_pointcloud"
    if preset is not None:
        merged += [Setting(name, value, f"--preset {preset}", "preset") for name, value in PRESETS[preset].items()]
    direction: Direction = "laserscan_to_pointcloud" if reverse else "pointcloud_to_laserscan"
    return resolve(merged, direction=direction)._replace(file=loaded)


def _launch_arguments(texts: Sequence[str]) -> dict[str, str]:
    """Read arguments of a launch file; a later one overrides an earlier one."""
    arguments = {}
    for text in texts:
        name, assigned, value = text.partition(":=")
        if not assigned or not name:
            raise UsageError(f"`launch_args`: {text!r} is not an argument", hint="write `launch_args=name:=value`")
        arguments[name] = value
    return arguments


def parse_params(texts: Sequence[str]) -> list[Setting]:
    """Read parameters as `parse_param` does, the last one first, but for those that every node has."""
    settings = [parse_param(text) for text in reversed(texts)]
    return [setting for setting in settings if not is_every_nodes(setting.name)]


def parse_param(text: str) -> Setting:
    """Read ROS's notation for one parameter, ``name:=value``.

    Parameters
    ----------
    text
        ROS 2's form after ``--ros-args -p``, which may begin with a node's name (``node:name:=value``; the name is
        ignored), or ROS 1's form (``_name:=value``). The value is a YAML
        scalar: ``1``, ``1.0``, ``.inf``, ``true``, ``"text"``; also ROS 1's ``deg(90)`` and
        ``rad(pi/2)``. No text after ``:=`` means the empty text.

    Returns
    -------
    Setting
        Its value is not checked here; `resolve` does.

    Raises
    ------
    ParameterError
        If there is no ``:=`` or no name, or the value is not a YAML scalar.
    """
    rule, assigned, written = text.partition(":=")
    name = rule.rpartition(":")[2].strip().lstrip("_~")
    if not assigned:
        raise ParameterError(f"`param` {text!r} has no ':='", hint="write `param=range_min:=0.5`")
    if not name:
        raise ParameterError(f"`param` {text!r} has no name before ':='", hint="write `param=range_min:=0.5`")
    origin = f"--param {text}"
    if not written.strip():
        return Setting(name, "", origin, "param")
    try:
        node = compose(written, origin)
    except ParameterError as err:
        err.name = name
        raise
    if node is not None and node.id != "scalar":
        raise ParameterError(expected_message(name, f"a {node.id.replace('sequence', 'list')}", origin), name=name)
    value = None if node is None else scalar_value(node, name, origin, ros1=True)
    return Setting(name, value, origin, "param")


#: The nodes' names for the topic that they read and the topic that they write, by whether scans become clouds.
_NAMES = {False: ("cloud_in", "scan"), True: ("scan_in", "cloud")}

#: The topics of transforms, which may be remapped.
_TF = ("tf", "tf_static")


def read_remaps(texts: Iterable[str], *, reverse: bool = False) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Read remappings of the nodes' topics.

    Parameters
    ----------
    texts
        ``cloud_in:=/points``, ``scan:=/front/scan``, ``/tf:=/robot/tf``; a node's name in front is ignored. The names
        of ``laserscan_to_pointcloud`` are ``scan_in`` and ``cloud``.
    reverse
        Whether scans become clouds.

    Returns
    -------
    topics, tf_topics
        Topics to convert (a remapping of ``scan`` alone is for the only PointCloud2 topic), and those of transforms.

    Raises
    ------
    UsageError
        If a text is not a remapping, or the node has no such topic.
    """
    source_name, target_name = _NAMES[reverse]
    remaps: dict[str, str] = {}
    for text in texts:
        left, assigned, right = text.partition(":=")
        name = left.rpartition(":")[2].strip().lstrip("~/")
        right = right.strip()
        if not assigned or not name or not right:
            raise UsageError(
                f"{text!r} is not a remapping", hint=f"write {source_name}:=/points or {target_name}:=/scan"
            )
        if name not in (source_name, target_name, *_TF):
            node = "laserscan_to_pointcloud" if reverse else "pointcloud_to_laserscan"
            known = (source_name, target_name, *_TF)
            hint = f"{did_you_mean(name, known)} its topics are {', '.join(known)}".strip()
            if name in PARAMETERS:
                hint = f"it is a parameter: `param={name}:={right}`"
            raise UsageError(f"{text!r}: {node} has no topic {name!r}", hint=hint)
        remaps[name] = right if right.startswith(("/", "~")) else f"/{right}"
    topics: tuple[str, ...] = ()
    if source_name in remaps or target_name in remaps:
        source, target = remaps.get(source_name, "*"), remaps.get(target_name)
        topics = (str(source) if target is None else f"{source}:={target}",)
        TopicRequest.parse(topics[0])
    # If only one of the two topics is remapped, the other one keeps its name.
    moved = [remaps[name] for name in _TF if name in remaps]
    return topics, tuple(remaps.get(name, f"/{name}") for name in _TF) if len(moved) == 1 else tuple(moved)

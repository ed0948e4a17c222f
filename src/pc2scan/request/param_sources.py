"""Collects the parameters of a conversion from every place where a user can give them; reads ``name:=value``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.core.presets import PRESETS
from pc2scan.errors import ParameterError, UsageError

from .entries import compose, scalar_value
from .parameters import ALIASES, ParamsFile, Setting, expected_message, is_every_nodes, resolve
from .params_file import load_params_file

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
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

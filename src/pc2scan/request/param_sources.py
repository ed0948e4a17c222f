"""Collects the parameters of a conversion from every place where a user can give them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.errors import UsageError

from .parameters import ALIASES, preset_settings, resolve
from .params_file import load_params_file
from .yaml_nodes import parse_params

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from .parameters import Direction, ResolvedParams, Setting


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
        Texts for `pc2scan.request.yaml_nodes.parse_params`; a later one overrides an earlier one.
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
    # Modules are imported only if needed: a conversion of a small recording spends most of its time on imports.
    found = list(settings)
    ignored: tuple[str, ...] = ()
    remaps: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    if assignments:
        found += parse_params(assignments)
    if file is not None:
        given = {ALIASES.get(setting.name, setting.name) for setting in found}
        loaded = load_params_file(
            file, node=node, arguments=_launch_arguments(launch_args), overridden={*given, *remapped}
        )
        found += loaded.settings
        ignored, remaps, files = loaded.ignored, loaded.remaps, loaded.files
        if reverse and loaded.direction == "pointcloud_to_laserscan":
            raise UsageError(f"{loaded.node} is for pointcloud_to_laserscan, `reverse=True` is not", path=file)
        reverse = reverse or loaded.direction == "laserscan_to_pointcloud"
    if preset is not None:
        found += preset_settings(preset)
    direction: Direction = "laserscan_to_pointcloud" if reverse else "pointcloud_to_laserscan"
    return resolve(found, direction=direction)._replace(ignored=ignored, remaps=remaps, files=files)


def _launch_arguments(texts: Sequence[str]) -> dict[str, str]:
    """Read arguments of a launch file; a later one overrides an earlier one."""
    arguments = {}
    for text in texts:
        name, assigned, value = text.partition(":=")
        if not assigned or not name:
            raise UsageError(f"`launch_args`: {text!r} is not an argument", hint="write `launch_args=name:=value`")
        arguments[name] = value
    return arguments

"""Reads what a conversion is requested to do from the keywords of `pc2scan.convert`, and computes a digest of it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import UsageError
from pc2scan.json_types import json_value
from pc2scan.names import did_you_mean
from pc2scan.pipeline.run import OutputOptions
from pc2scan.remote.urls import is_url
from pc2scan.requests import KEYWORDS, conversion_of, parameter_names

from .identity import Identity, identity_of

if TYPE_CHECKING:
    from pc2scan.bags.splitting import Cut
    from pc2scan.export.run import ExportOptions
    from pc2scan.pipeline.options import ConvertOptions

__all__ = ["Request", "all_keywords", "request_of"]

#: Keywords of the destination, of splitting, and of exports.
_OUTPUT = ("storage", "compression", "profile", "metadata_version", "to", "overwrite")
_SPLIT = ("split", "repeat_latched")
_EXPORT = ("export", "pose_frame", "base_frame", "odom_topic")

#: Attributes that do not affect the output: where options come from.
_PLACES = frozenset({"origins", "place"})


@dataclass(frozen=True, slots=True)
class Request:
    """A conversion as it was requested, checked. The recording and its destination are not part of it.

    Attributes
    ----------
    options, output
        As `pc2scan.pipeline.run.run` takes them.
    files
        The files that options name and that were read, by option.
    notes
        Warnings about the options.
    export
        How scans or clouds are exported; None if they are written to a recording instead.
    """

    options: ConvertOptions
    output: OutputOptions
    files: Mapping[str, Path]
    notes: tuple[str, ...] = ()
    export: ExportOptions | None = None

    def digest(self) -> str:
        """Return a digest of everything that affects the output.

        Recordings that transforms are taken from count with their sizes and times of modification.
        """
        import hashlib  # noqa: PLC0415  # only batches need it
        import json  # noqa: PLC0415

        options = replace(self.options, jobs=0)
        output = {
            name: getattr(self.output, name) for name in ("storage", "compression", "profile", "metadata_version")
        }
        if self.output.cut is not None:
            output["cut"] = asdict(self.output.cut)
        others = [_source_identity(path).as_json() for path in options.frames.tf_from]
        if self.export is not None:
            output["export"] = _canonical(replace(self.export, overwrite=False))
        whole = json_value({"options": _canonical(options), "output": output, "tf_from": others})
        return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:32]


def _source_identity(path: Path) -> Identity:
    """Return the identity of a recording that transforms are taken from."""
    if not is_url(path):
        return identity_of([path])
    from pc2scan.remote.store import RemotePath  # noqa: PLC0415  # loads fsspec

    place = RemotePath(path)
    files = place.files()
    return Identity(
        tuple((name, *each.stated()) for name, each in ({place.name: place} if files is None else files).items())
    )


def all_keywords() -> frozenset[str]:
    """Return all keywords that `request_of` reads."""
    # Not `jobs`: the batch decides the number of threads.
    return (KEYWORDS - {"jobs"}).union(_OUTPUT, _SPLIT, _EXPORT, parameter_names())


def request_of(keywords: Mapping[str, Any], origins: Mapping[str, str] | None = None) -> Request:
    """Read the keywords of `pc2scan.convert`, except those of a single run: sources, destination, report, jobs.

    Parameters
    ----------
    keywords
        Keywords of `pc2scan.convert`, and those that only the command line has: ``param``, ``launch_args``, ``remap``.
    origins
        Where keywords come from, for errors and reports.

    Raises
    ------
    UsageError
        If a keyword is unknown, has a wrong value, or contradicts another one.
    """
    if unknown := keywords.keys() - all_keywords():
        raise UsageError(f"`{min(unknown)}` is not an option of a conversion")
    given = dict(keywords)

    def take(names: tuple[str, ...]) -> dict[str, Any]:
        return {name: given.pop(name) for name in names if name in given}

    export = _export(take(_EXPORT), given)
    cut = _read_cut(take(_SPLIT))
    output = OutputOptions(**take(_OUTPUT), like_source=True, cut=cut)
    notes: list[str] = []
    asked = conversion_of(given, origins, notes.append)
    # Absolute: another process may have another current folder.
    frames = replace(asked.options.frames, tf_from=tuple(map(_absolute_path, asked.options.frames.tf_from)))
    files = {name: _absolute_path(path) for name, path in asked.files.items()}
    return Request(replace(asked.options, frames=frames), output, files, tuple(notes), export)


def _export(asked: Mapping[str, Any], others: Mapping[str, Any]) -> ExportOptions | None:
    """Read how messages are exported; ``others`` are all other keywords."""
    if not asked:
        return None
    name = asked.get("export")
    if name is None:
        raise UsageError(f"`{min(asked)}` goes with `export`", hint="such as `export=npz`")
    if idle := [f"`{word}`" for word in (*_OUTPUT, *_SPLIT) if word != "overwrite" and others.get(word) is not None]:
        raise UsageError(f"{', '.join(idle)} would have no effect: `export` writes no recordings")
    from pc2scan.export.formats import FORMATS  # noqa: PLC0415  # most batches write recordings
    from pc2scan.export.poses import PoseOptions  # noqa: PLC0415
    from pc2scan.export.run import ExportOptions  # noqa: PLC0415

    if name not in FORMATS:
        hint = did_you_mean(name, FORMATS) or None
        raise UsageError(f"`export={name}` is not a format; the formats are {', '.join(FORMATS)}", hint=hint)
    poses = PoseOptions(**{word: value for word, value in asked.items() if word != "export"})
    if FORMATS[name].needs_poses and not poses.wanted:
        raise UsageError(f"`export={name}` needs poses", hint="give `pose_frame=odom`, or `odom_topic=/odom`")
    making = others.keys() & {*parameter_names(), "params", "preset", "params_file", "param"}
    return ExportOptions(format=name, poses=poses, converting=bool(making))


def _absolute_path(path: Path) -> Path:
    return path if is_url(path) else Path(os.path.abspath(path))  # noqa: PTH100  # links keep their names


def _read_cut(asked: Mapping[str, Any]) -> Cut | None:
    """Read where outputs are split."""
    if not asked:
        return None
    from pc2scan.pipeline.parts import cut_of  # noqa: PLC0415  # most outputs are one file

    return cut_of(asked.get("split"), repeat_latched=asked.get("repeat_latched", False))


def _canonical(value: Any) -> Any:
    """Return options as JSON's types. Equal options give equal results in every process."""
    if isinstance(value, ProjectionParams):
        # The queue's size bounds what is held in memory. It does not affect the output.
        value = replace(value, queue_size=0)
    if is_dataclass(value) and not isinstance(value, type):
        # Only attributes of the instance, not what a class computes from them.
        shown = {
            each.name: _canonical(getattr(value, each.name))
            for each in fields(value)
            if each.repr and each.name not in _PLACES
        }
        return {"": type(value).__name__, **shown}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(key): _canonical(part) for key, part in value.items()}
    if isinstance(value, tuple | list | set | frozenset):
        return [_canonical(part) for part in value]
    if hasattr(value, "tolist"):
        return value.tolist()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value) if isinstance(value, Path) else repr(value)

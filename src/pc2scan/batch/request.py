"""Reads the options of a conversion in a batch, from the call and a dataset file, and computes a digest of them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import UsageError
from pc2scan.options.call import Options
from pc2scan.options.running import Container
from pc2scan.options.table import conversion_options, options_of
from pc2scan.remote.urls import is_url
from pc2scan.requests import conversion_of, output_of
from pc2scan.result import json_value

from .identity import Identity, identity_of

if TYPE_CHECKING:
    from pc2scan.export.run import ExportOptions
    from pc2scan.pipeline.options import ConvertOptions
    from pc2scan.pipeline.run_files import OutputOptions

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
        tuple((name, *each.stat()) for name, each in ({place.name: place} if files is None else files).items())
    )


def request_of(keywords: Mapping[str, Any], origins: Mapping[str, str] | None = None) -> Request:
    """Read the options of a conversion.

    Parameters
    ----------
    keywords
        Options by name: those of `pc2scan.options.table.conversion_options`.
    origins
        Where options come from, for errors and reports.

    Raises
    ------
    UsageError
        If an option is unknown, has a wrong value, or contradicts another one.
    """
    known = conversion_options()
    if unknown := keywords.keys() - known.keys():
        raise UsageError(f"`{min(unknown)}` is not an option of a conversion")
    options = Options("batch", keywords, origins, known=known)
    notes: list[str] = []
    _check_export(options)
    output = output_of(options, like_source=True)
    conversion = conversion_of(options, notes.append)
    export = None
    if options.export is not None:
        from pc2scan.export.run import ExportOptions  # noqa: PLC0415  # most batches write recordings

        export = ExportOptions.of(options, conversion.options, options.export)
    # Absolute: another process may have another current folder.
    frames = conversion.options.frames
    frames = replace(frames, tf_from=tuple(map(_absolute_path, frames.tf_from)))
    files = {name: _absolute_path(path) for name, path in conversion.files.items()}
    return Request(replace(conversion.options, frames=frames), output, files, tuple(notes), export)


def _check_export(options: Options) -> None:
    """Raise if an option of exports is given without ``export``, or one of recordings besides it."""
    name, given = options.export, options.given
    poses = given.keys() & {"pose_frame", "base_frame", "odom_topic"}
    if name is None:
        if poses:
            raise UsageError(f"`{min(poses)}` goes with `export`", hint="such as `export=npz`")
        return
    if idle := [f"`{word}`" for word in options_of("convert") if word in given and word in Container.__annotations__]:
        raise UsageError(f"{', '.join(idle)} would have no effect: `export` writes no recordings")
    from pc2scan.export.formats import FORMATS  # noqa: PLC0415  # most batches write recordings

    if FORMATS[name].needs_poses and not poses & {"pose_frame", "odom_topic"}:
        raise UsageError(f"`export={name}` needs poses", hint="give `pose_frame=odom`, or `odom_topic=/odom`")


def _absolute_path(path: Path) -> Path:
    return path if is_url(path) else Path(os.path.abspath(path))  # noqa: PTH100  # links keep their names


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

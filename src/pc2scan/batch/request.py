"""The options of each recording: those of the call override those of the dataset file. All are checked beforehand.

A digest of them shows whether a result is up to date.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, asdict, dataclass, fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import ParameterError, UsageError
from pc2scan.files.urls import absolute
from pc2scan.options.call import Options
from pc2scan.options.running import Container
from pc2scan.options.table import conversion_options, options_of
from pc2scan.pipeline.parameters import RIVALS
from pc2scan.pipeline.redaction import may_quote, redact_file
from pc2scan.requests import conversion_of, output_of
from pc2scan.result import json_value

from .identity import identity_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pc2scan.export.run import ExportOptions
    from pc2scan.pipeline.options import ConvertOptions
    from pc2scan.pipeline.run_files import OutputOptions

    from .dataset_file import DatasetFile

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
        others = [identity_of([path]).as_json() for path in options.frames.tf_from]
        if self.export is not None:
            output["export"] = _canonical(replace(self.export, overwrite=False))
        whole = json_value({"options": _canonical(options), "output": output, "tf_from": others})
        return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:32]


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
    _check_export(options)
    output = output_of(options, like_source=True)
    conversion = conversion_of(options)
    export = None
    if options.export is not None:
        from pc2scan.export.run import ExportOptions  # noqa: PLC0415  # most batches write recordings

        export = ExportOptions.of(options, conversion.options, options.export)
    # Absolute: another process may have another current folder.
    frames = conversion.options.frames
    frames = replace(frames, tf_from=tuple(map(absolute, frames.tf_from)))
    files = {name: absolute(path) for name, path in conversion.files.items()}
    return Request(replace(conversion.options, frames=frames), output, files, conversion.notes, export)


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


def _canonical(value: Any) -> Any:
    """Return options as JSON's types. Equal options give equal results in every process."""
    if isinstance(value, ProjectionParams):
        # The queue's size bounds what is held in memory. It does not affect the output.
        value = replace(value, queue_size=0)
    if is_dataclass(value) and not isinstance(value, type):
        # Only attributes that are not the default, so that an option that is added later changes no earlier digest.
        shown = [each for each in fields(value) if each.repr and each.name not in _PLACES]
        given = {each.name: _canonical(getattr(value, each.name)) for each in shown}
        given = {each.name: given[each.name] for each in shown if given[each.name] != _canonical(_default_of(each))}
        return {"": type(value).__name__, **given}
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


def _default_of(attribute: Field[Any]) -> Any:
    return attribute.default if attribute.default_factory is MISSING else attribute.default_factory()


@dataclass(frozen=True, slots=True)
class Choice:
    """The options of a recording. Recordings with the same options share one object.

    Attributes
    ----------
    request
        The conversion that is requested; None if the recording is skipped.
    digest
        The digest of the request.
    """

    request: Request | None
    digest: str = ""


class Choices:
    """Finds the options of recordings.

    Parameters
    ----------
        dataset
            The dataset file.
        keywords
        Options of the call. They override those of the file.
        origins
            Where each option comes from, for errors.
    """

    def __init__(self, dataset: DatasetFile, keywords: Mapping[str, Any], origins: Mapping[str, str]) -> None:
        self._dataset = dataset
        self._keywords = keywords
        self._origins = origins
        self._made: dict[tuple[int, ...], Choice] = {}

    def check(self) -> None:
        """Raise if the options of the call alone, or with the defaults of the file, are wrong."""
        defaults = tuple(number for number, entry in enumerate(self._dataset.entries) if not entry.patterns)
        self._choice(defaults)

    def of(self, keys: Iterable[str]) -> dict[str, Choice]:
        """Return the options of recordings, by key.

        Raises
        ------
        UsageError
            If options are wrong; the message names the line of the dataset file.
        """
        return {key: self._choice(self._dataset.matching(key)) for key in keys}

    def warnings(self, keys: Iterable[str]) -> list[str]:
        """Return warnings about the dataset file and the options."""
        listed = list(keys)
        unused = [
            f"{self._dataset.path}, line {entry.line}: matches no recording: {', '.join(entry.patterns)}"
            for entry in self._dataset.entries
            if not any(map(entry.matches, listed))
        ]
        notes = [note for choice in self._made.values() if choice.request for note in choice.request.notes]
        return [*unused, *dict.fromkeys(notes)]

    def _choice(self, numbers: tuple[int, ...]) -> Choice:
        if numbers not in self._made:
            keywords, origins, skip = self._dataset.combined(numbers)
            for name in self._keywords:
                keywords.pop(RIVALS.get(name, ""), None)
            keywords |= self._keywords
            origins = {name: origin for name, origin in origins.items() if name not in self._keywords} | dict(
                self._origins
            )
            if skip:
                self._made[numbers] = Choice(None)
            else:
                try:
                    request = request_of(keywords, origins)
                    self._made[numbers] = Choice(request, request.digest())
                except UsageError as err:
                    self._refuse_to_quote(err, keywords, origins)
                    self._add_origin(err, numbers, origins)
                    raise
        return self._made[numbers]

    def _refuse_to_quote(self, err: UsageError, keywords: Mapping[str, Any], origins: Mapping[str, str]) -> None:
        """Raise another error if one is about a file that the dataset file names, and may quote it."""
        for name in ("params_file", "static_tf_file", "scans"):
            if name in keywords and name not in self._keywords and may_quote(err, keywords[name]):
                raise redact_file(err, keywords[name], origins[name], name) from None

    def _add_origin(self, err: UsageError, numbers: tuple[int, ...], origins: Mapping[str, str]) -> None:
        """Add the line of the dataset file that has the wrong option to the message."""
        if not numbers or any(origin in err.message for origin in origins.values()):
            return
        text = f"{err.message} {err.hint or ''}"
        named = [name for name in origins if f"`{name}`" in text or f"`{name}=" in text]
        if isinstance(err, ParameterError) and err.name in origins:
            named.insert(0, err.name)
        # Some messages quote the wrong value (a transform, a topic) instead of the option.
        keywords = self._dataset.combined(numbers)[0]
        named += [
            name
            for name, value in keywords.items()
            if any(repr(text) in err.message for text in (value if isinstance(value, tuple) else (value,)))
        ]
        entry = self._dataset.entries[numbers[-1]]
        where = next((origins[name] for name in named if name in origins), f"{self._dataset.path}, line {entry.line}")
        err.message = f"{err.message} (from {where})"

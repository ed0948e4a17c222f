"""Plans a batch: the options of each recording, what is done with it, and why.

Options of the call override those of a dataset file, which is YAML that gives options to recordings by patterns. All
are checked beforehand. Nothing is written, and of the results only what they are is looked at.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.destinations import default_destination
from pc2scan.errors import DestinationError, UsageError, name_list
from pc2scan.files.outputs import Inputs, name_key, working_names
from pc2scan.files.paths import absolute
from pc2scan.options.table import dataset_options
from pc2scan.options.values import FLAG, texts
from pc2scan.parsing import NAMED_FILES
from pc2scan.request.entries import entries_in, naming_place, read_text
from pc2scan.request.precedence import RIVALS
from pc2scan.version import __version__

from .jobs import Job, request_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from pc2scan.errors import Pc2ScanError
    from pc2scan.files.outputs import InputPath
    from pc2scan.request.entries import Entry

    from .find import Recording
    from .jobs import JobRequest
    from .manifest import BatchFolder, Identity, ManifestRecord


_EXAMPLE = "it has `defaults:`, `recordings:`, or both"


@dataclass(frozen=True)
class DatasetEntry:
    """Options for the recordings that a pattern matches.

    Attributes
    ----------
    place
        Where it begins in the file.
    patterns
        Globs; empty for the defaults, which match everything.
    keywords
        Options by name, as `pc2scan.datasets.jobs.request_of` reads them.
    origins
        Where each option comes from.
    skip
        Whether the recordings are skipped; None if the entry does not have it.
    """

    place: str
    patterns: tuple[str, ...] = ()
    keywords: Mapping[str, Any] = field(default_factory=dict)
    origins: Mapping[str, str] = field(default_factory=dict)
    skip: bool | None = None

    @cached_property
    def _expressions(self) -> list[re.Pattern[str]]:
        return [re.compile(_expression(pattern)) for pattern in self.patterns]

    def matches(self, key: str) -> bool:
        """Return whether the entry applies to the recording with this key."""
        return not self.patterns or any(expression.fullmatch(key) for expression in self._expressions)


def load_dataset_file(path: Path) -> list[DatasetEntry]:
    """Return the entries of a dataset file, the defaults first.

    Raises
    ------
    UsageError
        If it cannot be read, is not YAML, or has an unknown key or a wrong value; the message names the line.
    """
    sections = entries_in(read_text(path, _EXAMPLE), path, _EXAMPLE).mapping(
        "the file", ("defaults", "recordings"), _EXAMPLE
    )
    entries = [_entry(sections["defaults"], path.parent)] if "defaults" in sections else []
    if (recordings := sections.get("recordings")) and recordings.value is not None:
        if not isinstance(recordings.value, list):
            message = f"{recordings.place}: recordings must be a list, got {recordings.shown}"
            raise UsageError(message, hint="write '- match: PATTERN' for each entry")
        entries += [_entry(entry, path.parent, "match", "skip") for entry in recordings.value]
    return entries


def _entry(entry: Entry, folder: Path, *more: str) -> DatasetEntry:
    options = dataset_options()
    kinds = {"match": texts(), "skip": FLAG, **{name: option.value for name, option in options.items()}}
    given = entry.mapping("an entry of recordings" if more else "defaults", (*more, *options), "")
    values = {name: value.read(name, kinds[name], folder) for name, value in given.items()}
    patterns, skip = values.pop("match", ()), values.pop("skip", None)
    if more and not patterns:
        raise UsageError(f"{entry.place}: an entry of recordings has no match", hint="write 'match: robot1/**' in it")
    return DatasetEntry(entry.place, patterns, values, {name: given[name].place for name in values}, skip)


def _expression(pattern: str) -> str:
    """Translate a glob: ``*`` matches within one name, ``**`` any number of folders; a folder matches its content."""
    pattern = pattern.removeprefix("./").removesuffix("/")
    parts = []
    position = 0
    for wildcard in re.finditer(r"\*\*/|\*\*|\*|\?|\[[^\]/]+\]", pattern):
        parts.append(re.escape(pattern[position : wildcard.start()]))
        match token := wildcard[0]:
            case "**/":
                parts.append("(?:.*/)?")
            case "**":
                parts.append(".*")
            case "*":
                parts.append("[^/]*")
            case "?":
                parts.append("[^/]")
            case _:
                parts.append("[" + token[1:-1].replace("\\", "\\\\").replace("!", "^", token[1] == "!") + "]")
        position = wildcard.end()
    parts.append(re.escape(pattern[position:]))
    anywhere = "" if "/" in pattern else "(?:.*/)?"
    return f"{anywhere}{''.join(parts)}(?:/.*)?"


# --- The options of each recording ---


class Choices:
    """Finds the options of recordings. Recordings with the same options share one request.

    Parameters
    ----------
    entries
        The entries of the dataset file.
    keywords
        Options of the call. They override those of the file.
    origins
        Where each option of the call comes from, for errors.

    Raises
    ------
    UsageError
        If the options of the call alone, or with the defaults of the file, are wrong.
    """

    def __init__(self, entries: list[DatasetEntry], keywords: Mapping[str, Any], origins: Mapping[str, str]) -> None:
        self._entries = entries
        self._call = DatasetEntry("", keywords=keywords, origins=origins)
        self._made: dict[tuple[int, ...], JobRequest | None] = {}
        self._request(tuple(number for number, entry in enumerate(entries) if not entry.patterns))

    def of(self, keys: Iterable[str]) -> dict[str, JobRequest | None]:
        """Return the options of recordings, by key; None for those that are skipped.

        Raises
        ------
        UsageError
            If options are wrong; the message names the line of the dataset file.
        """
        entries = list(enumerate(self._entries))
        return {key: self._request(tuple(number for number, entry in entries if entry.matches(key))) for key in keys}

    def warnings(self, keys: Iterable[str]) -> list[str]:
        """Return warnings about the dataset file and the options."""
        listed = list(keys)
        unused = [
            f"{entry.place}: matches no recording: {', '.join(entry.patterns)}"
            for entry in self._entries
            if not any(map(entry.matches, listed))
        ]
        notes = [note for request in self._made.values() if request for note in request.options.notes]
        return [*unused, *dict.fromkeys(notes)]

    def _request(self, numbers: tuple[int, ...]) -> JobRequest | None:
        """Return the options of a recording that these entries of the file apply to."""
        if numbers not in self._made:
            keywords: dict[str, Any] = {}
            origins: dict[str, str] = {}
            skip = False
            for entry in (*(self._entries[number] for number in numbers), self._call):
                for name in entry.keywords:
                    # Another option that means the same is overridden, too.
                    keywords.pop(RIVALS.get(name, ""), None)
                    origins.pop(name, None)
                keywords |= entry.keywords
                origins |= entry.origins
                skip = skip if entry.skip is None else entry.skip
            last = self._entries[numbers[-1]].place if numbers else ""
            files = (
                (path, origins[name], name)
                for name in NAMED_FILES
                if name in keywords and name not in self._call.keywords
                for path in (keywords[name] if isinstance(keywords[name], tuple) else (keywords[name],))
                if dataset_options()[name].value.is_path(str(path))
            )
            with naming_place(origins, last, files):
                self._made[numbers] = None if skip else request_of(keywords, origins)
        return self._made[numbers]


class BatchPlan(NamedTuple):
    """What is done with every recording, in the order of their keys; ``skipped``: those that the dataset file skips."""

    jobs: list[Job]
    skipped: list[Recording]
    warnings: list[str]

    def of(self, action: str) -> list[Job]:
        """Return the jobs with one action."""
        return [job for job in self.jobs if job.action == action]


def _outputs(requests: Mapping[Recording, JobRequest]) -> dict[str, str]:
    """Return the paths of the results, by key: the folders of the sources, with the names that `convert` gives.

    Exported files go into a folder with the name of the recording.

    If two results would have the same name (``drive.bag`` and ``drive.mcap`` with ``--to mcap``), the suffix of each
    source becomes a part of its name: ``drive_bag_scan.mcap``. So it does if a result would be a folder with another
    result in it (``drive.bag`` and ``drive/x.bag`` with ``--format npz``): ``drive_bag`` and ``drive/x``.
    """
    wanted = {recording.key: (recording, request) for recording, request in requests.items() if recording.container}
    named = {key: _result_name(*pair) for key, pair in wanted.items()}
    for key in {other for others in _clashes(named).values() for other in others}:
        named[key] = _result_name(*wanted[key], distinct=True)
    return named


def _clashes(outputs: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the recordings whose results have the name of another result, or would contain it, by its key."""
    # File systems may ignore case, or the form of Unicode.
    owners: dict[str, list[str]] = {}
    for key, output in outputs.items():
        for name in (Path(output), *working_names(Path(output))):
            owners.setdefault(name_key(name.as_posix()), []).append(key)
    return {
        key: others
        for key, output in outputs.items()
        if (
            others := [
                other
                for place in (PurePosixPath(output), *PurePosixPath(output).parents)
                for other in owners.get(name_key(place.as_posix()), ())
                if other != key
            ]
        )
    }


def _result_name(recording: Recording, request: JobRequest, *, distinct: bool = False) -> str:
    source = Path(recording.key)
    suffix = f"_{source.suffix[1:] or 'folder'}" if distinct else ""
    mark, to = ("", "rosbag2") if request.export is not None else ("_scan", request.output.to)
    return default_destination(source, recording.container, f"{suffix}{mark}", folder=source.parent, to=to).as_posix()


def make_plan(
    recordings: Sequence[Recording],
    requests: Mapping[str, JobRequest | None],
    folder: BatchFolder,
    inputs: Sequence[InputPath],
    *,
    again: bool = False,
) -> BatchPlan:
    """Decide what is done with each recording.

    Parameters
    ----------
    recordings
        The recordings.
    requests
        Their options, by key; None for those that are skipped.
    folder
        The folder of the batch, with what earlier runs have recorded.
    inputs
        Everything that is read. No result is written there.
    again
        Whether everything is converted again.
    """
    chosen = {recording: request for recording in recordings if (request := requests[recording.key]) is not None}
    outputs = _outputs(chosen)
    clashes = _clashes(outputs)
    forbidden = partial(_forbidden, folder.path, cache(partial(Inputs, inputs)))
    jobs: list[Job] = []
    leftovers: list[str] = []
    for recording, request in chosen.items():
        record, output = folder.records.get(recording.key), outputs.get(recording.key, "")
        at = replace(recording, paths=tuple(map(absolute, recording.paths)))
        job = Job(recording=at, request=request, destination=absolute(folder.path / output), output=output)
        why, error = "", recording.error
        if error is None:
            present = folder.present(output)
            job = replace(job, owned=output in folder.outputs, present=present)
            why = "asked for" if again else _reason(job, record, folder, present)
        if why:
            error = (
                _clash(recording.key, clashes[recording.key], outputs)
                if recording.key in clashes
                else forbidden(output)
            )
            if error is None and not request.output.overwrite and not folder.may_replace(output, present):
                error = _ownership_error(job.destination, present, folder.left.get(output))
        if error is not None:
            jobs.append(replace(job, action="refuse", why=error.message, error=error))
            continue
        jobs.append(replace(job, action="convert" if why else "keep", why=why or "unchanged"))
        if record is not None and record.output not in ("", output) and folder.present(record.output).files:
            leftovers.append(record.output)
    warnings = [f"earlier results have other names now, and stay: {name_list(leftovers, 3)}"] if leftovers else []
    return BatchPlan(jobs, [recording for recording in recordings if recording not in chosen], warnings)


def _forbidden(out: Path, read: Callable[[], Inputs], output: str) -> DestinationError | None:
    """Return why an output may not be written into a folder, whatever is there; None if it may."""
    path = out / output
    try:
        read().refuse(path)
    except DestinationError as err:
        return err
    folders = (out / folder for folder in PurePosixPath(output).parents)
    link = next((folder for folder in folders if folder != out and folder.is_symlink()), None)
    if link is None:
        return None
    return DestinationError(
        f"would be written through the link {link}, and a batch writes only into its own folder",
        path=path,
        hint="remove the link; or convert what belongs there in a batch of its own, "
        f"`destination={os.path.realpath(link)}`",
    )


def _clash(key: str, others: Sequence[str], outputs: Mapping[str, str]) -> Pc2ScanError:
    """Return the error of a recording whose result would have the name of another one, or be in it."""
    other = others[0]
    is_in = name_key(outputs[key]).startswith(f"{name_key(outputs[other])}/")
    return DestinationError(
        f"would be in {outputs[other]}, the result of {other}"
        if is_in
        else f"would be the output of both {key} and {other}",
        hint="rename one of them, or write their outputs to different folders, in two batches",
    )


def _ownership_error(path: Path, present: Identity, left: Identity | None) -> Pc2ScanError:
    """Return the error of an output that somebody else has written, or edited since it was recorded."""
    if left is None:
        return DestinationError(
            "exists already, and was not written by this batch", path=path, hint="`overwrite=True` replaces it"
        )
    names = sorted({name for name, _, _ in {*present.files} - {*left.files}} - {path.name})
    return DestinationError(
        f"was edited since{f': {name_list(names, 3)}' if names else ''}",
        path=path,
        hint="move it away, or `overwrite=True` replaces it",
    )


def _reason(job: Job, record: ManifestRecord | None, folder: BatchFolder, present: Identity) -> str:
    """Return why a recording is converted; empty if its result is up to date."""
    if record is None:
        return "interrupted before" if job.output in folder.unfinished else "new"
    if record.version != __version__:
        return f"converted by pc2scan {record.version}"
    if record.options != job.request.digest:
        return "other options"
    if record.identity != job.recording.identity:
        return "the source was changed"
    if record.has_nothing:
        return ""
    if not record.is_written:
        message = str((record.error or {}).get("message", ""))
        return f"{record.outcome} before{f': {message}' if message else ''}"
    if record.output != job.output:
        return f"written to {record.output} before"
    if not present.files:
        return "its output is missing"
    return "" if present == record.output_identity else "its output was changed"


def have_same_outcome(record: ManifestRecord, other: ManifestRecord) -> bool:
    """Whether two lines of a recording differ at most in times and attempts."""
    names = ("outcome", "error", "identity", "options", "version", "output", "sources")
    return all(getattr(record, name) == getattr(other, name) for name in names)

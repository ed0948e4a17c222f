"""Plans a batch: decides what is done with each recording, and why.

Nothing is written, and of the results only what they are is looked at.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from pc2scan.bags.destinations import default_destination
from pc2scan.errors import DestinationError, name_list
from pc2scan.files.ownership import name_key
from pc2scan.files.places import working_names
from pc2scan.text import size
from pc2scan.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from pc2scan.errors import Pc2ScanError

    from .find import Recording
    from .folder import BatchFolder
    from .jobs import Request
    from .manifest import Identity, ManifestRecord


@dataclass(frozen=True, slots=True)
class Step:
    """What is done with one recording.

    Attributes
    ----------
    found
        The recording.
    action
        ``convert``; ``keep``: its result is up to date; ``refuse``: it cannot be converted; ``skip``: the dataset file
        excludes it.
    why
        The reason, for people.
    request
        Its options; None if it is skipped.
    output
        The path of the result, relative to the folder of the batch; empty for none.
    owned
        The files of the output that are recorded; None if it was never written.
    there
        The output as it is now.
    record
        Its last line in the manifest.
    error
        Why it is refused.
    """

    found: Recording
    action: str
    why: str
    request: Request | None
    output: str = ""
    owned: frozenset[str] | None = None
    there: Identity | None = None
    record: ManifestRecord | None = None
    error: Pc2ScanError | None = None


@dataclass(frozen=True, slots=True)
class BatchPlan:
    """What is done with every recording, in the order of their keys."""

    steps: tuple[Step, ...]
    warnings: tuple[str, ...] = ()

    def of(self, action: str) -> list[Step]:
        """Return the steps with one action."""
        return [step for step in self.steps if step.action == action]


def destinations(found: Sequence[Recording], requests: Mapping[str, Request | None]) -> dict[str, str]:
    """Return the paths of the results, by key: the folders of the sources, with the names that `convert` gives.

    Exported files go into a folder with the name of the recording.

    If two results would have the same name (``drive.bag`` and ``drive.mcap`` with ``--to mcap``), the suffix of each
    source becomes a part of its name: ``drive_bag_scan.mcap``. So it does if a result would be a folder with another
    result in it (``drive.bag`` and ``drive/x.bag`` with ``--format npz``): ``drive_bag`` and ``drive/x``.
    """
    wanted = {
        each.key: (each, request) for each in found if each.container and (request := requests[each.key]) is not None
    }
    named = {key: _result_name(*each) for key, each in wanted.items()}
    for key in {other for others in _clashes(named).values() for other in others}:
        named[key] = _result_name(*wanted[key], distinct=True)
    return named


def _clashes(outputs: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the recordings whose results have the name of another one, or would contain it; by that one's key."""
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


def _result_name(found: Recording, request: Request, *, distinct: bool = False) -> str:
    source = Path(found.key)
    suffix = f"_{source.suffix[1:] or 'folder'}" if distinct else ""
    mark, to = ("", "rosbag2") if request.export is not None else ("_scan", request.output.to)
    return default_destination(source, found.container, f"{suffix}{mark}", folder=source.parent, to=to).as_posix()


def make_plan(
    found: Sequence[Recording],
    requests: Mapping[str, Request | None],
    folder: BatchFolder,
    *,
    forbidden: Callable[[str], Pc2ScanError | None] = lambda _: None,
    again: bool = False,
) -> BatchPlan:
    """Decide what is done with each recording.

    Parameters
    ----------
    found
        The recordings.
    requests
        Their options, by key; None for those that are skipped.
    folder
        The folder of the batch, with what earlier runs have recorded.
    forbidden
        Returns why an output may not be written, whatever is there: it is a source, or behind a link.
    again
        Whether everything is converted again.
    """
    outputs = destinations(found, requests)
    clashes = _clashes(outputs)
    steps = []
    left: dict[str, str] = {}
    for each in found:
        request = requests[each.key]
        record = folder.records.get(each.key)
        output = outputs.get(each.key, "")
        step = Step(each, "convert", "", request, output, record=record)
        if request is None:
            steps.append(replace(step, action="skip", why="the dataset file skips it"))
            continue
        if each.error is not None:
            steps.append(replace(step, action="refuse", why=each.error.message, error=each.error))
            continue
        there = folder.present(output)
        step = replace(step, owned=folder.owned(output), there=there)
        why = "asked for" if again else _reason(each, request, output, folder, there)
        error = None
        if why:
            others = clashes.get(each.key)
            error = _clash(each.key, others[0], outputs, folder.path) if others else forbidden(output)
            if error is None and not request.output.overwrite and not folder.may_replace(output, there):
                error = _ownership_error(folder.path / output, there, folder.left.get(output))
        if error is not None:
            steps.append(replace(step, action="refuse", why=error.message, error=error))
            continue
        steps.append(replace(step, action="convert" if why else "keep", why=why or "unchanged"))
        if record is not None and record.output and record.output != output and folder.present(record.output).files:
            left[record.output] = output
    return BatchPlan(tuple(steps), tuple(_left_warning(left)))


def _clash(key: str, other: str, outputs: Mapping[str, str], out: Path) -> Pc2ScanError:
    """Return the error of a recording whose result would have the name of another one, or be in it."""
    is_in = name_key(outputs[key]).startswith(f"{name_key(outputs[other])}/")
    return DestinationError(
        f"would be in {outputs[other]}, the result of {other}"
        if is_in
        else f"would be the output of both {key} and {other}",
        path=out / outputs[key],
        hint="rename one of them, or write their outputs to different folders, in two batches",
    )


def _ownership_error(path: Path, there: Identity, left: Identity | None) -> Pc2ScanError:
    """Return the error of an output that somebody else has written, or edited since it was recorded."""
    if left is None:
        return DestinationError(
            "exists already, and was not written by this batch", path=path, hint="`overwrite=True` replaces it"
        )
    names = sorted({name for name, _, _ in {*there.files} - {*left.files}} - {path.name})
    return DestinationError(
        f"was edited since{f': {name_list(names, 3)}' if names else ''}",
        path=path,
        hint="move it away, or `overwrite=True` replaces it",
    )


def _left_warning(left: Mapping[str, str]) -> Iterator[str]:
    """Warn of earlier results whose recordings have another output now. They are not changed."""
    for old, new in list(left.items())[:1]:
        more = f" (and {len(left) - 1:,} more outputs of earlier runs)" if len(left) > 1 else ""
        yield f"{old} is out of date: its recording is written to {new} now{more}; the old file is not changed"


def _reason(
    found: Recording,
    request: Request,
    output: str,
    folder: BatchFolder,
    there: Identity,
) -> str:
    """Return why a recording is converted; empty if its result is up to date."""
    record = folder.records.get(found.key)
    if record is None:
        return "interrupted before" if output in folder.unfinished else "new"
    if record.version != __version__:
        return f"converted by pc2scan {record.version}"
    if record.options != request.digest:
        return "other options"
    if changed := _change_of(found, record):
        return changed
    if record.has_nothing:
        return ""
    if not record.is_written:
        message = str((record.error or {}).get("message", ""))
        return f"{record.outcome} before{f': {message}' if message else ''}"
    if record.output != output:
        return f"written to {record.output} before"
    if not there.files:
        return "its output is missing"
    if there != record.output_identity:
        return f"its output was changed: it has {size(there.size_bytes)}, it was written with " + size(
            record.output_identity.size_bytes
        )
    return ""


def _change_of(found: Recording, record: ManifestRecord) -> str:
    before, now = record.identity, found.identity
    if not now.has_sizes_of(before):
        return f"the source was changed: it has {size(now.size_bytes)}, it had {size(before.size_bytes)}"
    if now == before:
        return ""
    of_store = any(isinstance(version, str) for _, _, version in now.files)
    return f"the source was changed: another {'version' if of_store else 'time of modification'}"


def have_same_outcome(record: ManifestRecord, other: ManifestRecord) -> bool:
    """Whether two lines of a recording differ at most in times and attempts."""
    names = ("outcome", "error", "identity", "options", "version", "output", "sources")
    return all(getattr(record, name) == getattr(other, name) for name in names)

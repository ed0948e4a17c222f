"""Plans a batch: decides what is done with each recording, and why. Pure functions: nothing is read or written."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.bags.destinations import named_after
from pc2scan.bags.formats import file_suffixes
from pc2scan.errors import DestinationError
from pc2scan.files.places import working_names
from pc2scan.shown import size
from pc2scan.version import __version__

from .results import first_part, whole

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

    from pc2scan.errors import Pc2ScanError

    from .find import Found
    from .identity import Identity
    from .manifest import Record
    from .request import Request

__all__ = ["Choice", "History", "Plan", "Step", "destinations", "make_plan"]


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


@dataclass(frozen=True, slots=True)
class History:
    """What earlier runs have recorded.

    Attributes
    ----------
    records
        The manifest, by key.
    begun
        Outputs that a killed run was going to write, relative to the folder of the batch.
    """

    records: Mapping[str, Record]
    begun: frozenset[str] = frozenset()

    @property
    def owned(self) -> frozenset[str]:
        """The outputs that were written by earlier runs."""
        return self.begun | {record.output for record in self.records.values() if record.output}


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
    choice
        Its options.
    output
        The path of the result, relative to the folder of the batch; empty for none.
    replaces
        Whether an existing output may be replaced.
    record
        Its last line in the manifest.
    error
        Why it is refused.
    """

    found: Found
    action: str
    why: str
    choice: Choice
    output: str = ""
    replaces: bool = False
    record: Record | None = None
    error: Pc2ScanError | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """What is done with every recording, in the order of their keys."""

    steps: tuple[Step, ...]
    warnings: tuple[str, ...] = ()

    def of(self, action: str) -> list[Step]:
        """Return the steps with one action."""
        return [step for step in self.steps if step.action == action]


def destinations(found: Sequence[Found], choices: Mapping[str, Choice]) -> dict[str, str]:
    """Return the paths of the results, by key: the folders of the sources, with the names that `convert` gives.

    Exported files go into a folder with the name of the recording.

    If two results would have the same name (``drive.bag`` and ``drive.mcap`` with ``--to mcap``), the suffix of each
    source becomes a part of its name: ``drive_bag_scan.mcap``.
    """
    requests = {key: choice.request for key, choice in choices.items() if choice.request is not None}
    named = {
        each.key: _result_name(each, requests[each.key]) for each in found if each.container and each.key in requests
    }
    taken: dict[str, list[str]] = {}
    for key, name in named.items():
        taken.setdefault(name.casefold(), []).append(key)
    by_key = {each.key: each for each in found}
    for keys in taken.values():
        if len(keys) > 1:
            for key in keys:
                named[key] = _result_name(by_key[key], requests[key], distinct=True)
    return named


def _result_name(found: Found, request: Request, *, distinct: bool = False) -> str:
    source = Path(found.key)
    suffix = f"_{source.suffix[1:] or 'folder'}" if distinct else ""
    mark, to = ("", "rosbag2") if request.export is not None else ("_scan", request.output.to)
    name = named_after(source, found.container, f"{suffix}{mark}", folder=source.parent, to=to)
    in_parts = request.output.cut is not None and request.export is None and name.suffix in file_suffixes()
    return first_part(name.as_posix()) if in_parts else name.as_posix()


def make_plan(
    found: Sequence[Found],
    choices: Mapping[str, Choice],
    history: History,
    *,
    out: Path,
    inputs: Collection[Path] = (),
    present: Callable[[str], Identity],
    checksum: Callable[[Found], str] | None = None,
    force: bool = False,
) -> Plan:
    """Decide what is done with each recording.

    Parameters
    ----------
    found
        The recordings.
    choices
        Their options, by key.
    history
        What earlier runs have recorded.
    out
        The folder of the batch, with links resolved.
    inputs
        All paths that are read, with links resolved: nothing is written there.
    present
        Returns the identity of an output in the folder; without files if it does not exist.
    checksum
        Returns the checksum of a recording; None: sources are compared by their times of modification.
    force
        Whether everything is converted again.
    """
    outputs = destinations(found, choices)
    owners: dict[str, list[str]] = {}
    for key, output in outputs.items():
        for name in (Path(output), *working_names(Path(whole(output)))):
            owners.setdefault(name.as_posix().casefold(), []).append(key)
    owned = history.owned
    steps = []
    left: dict[str, str] = {}
    for each in found:
        choice = choices[each.key]
        record = history.records.get(each.key)
        output = outputs.get(each.key, "")
        step = Step(each, "convert", "", choice, output, replaces=output in owned, record=record)
        if choice.request is None:
            steps.append(replace(step, action="skip", why="the dataset file skips it"))
            continue
        if each.error is not None:
            steps.append(replace(step, action="refuse", why=each.error.message, error=each.error))
            continue
        others = [key for key in owners[output.casefold()] if key != each.key]
        if others:
            error = DestinationError(
                f"would be the output of both {each.key} and {others[0]}",
                path=out / output,
                hint="rename one of them, or write their outputs to different folders, in two batches",
            )
            steps.append(replace(step, action="refuse", why=error.message, error=error))
            continue
        place = out / whole(output)
        if read := next((path for path in (place, *working_names(place), *place.parents) if path in inputs), None):
            error = DestinationError("is a source, and would be overwritten", path=read, hint="write to another folder")
            steps.append(replace(step, action="refuse", why=error.message, error=error))
            continue
        there = present(output)
        replaces = step.replaces or choice.request.output.overwrite
        if there.files and not replaces:
            error = DestinationError(
                "exists already, and was not written by this batch",
                path=out / output,
                hint="`overwrite=True` replaces it",
            )
            steps.append(replace(step, action="refuse", why="its output exists already", error=error))
            continue
        why = "forced" if force else _reason(each, choice, output, history, there, checksum)
        steps.append(replace(step, action="convert" if why else "keep", why=why or "unchanged", replaces=replaces))
        if record is not None and record.output and record.output != output and present(record.output).files:
            left[record.output] = output
    return Plan(tuple(steps), tuple(_left_warning(left)))


def _left_warning(left: Mapping[str, str]) -> Iterator[str]:
    """Warn of earlier results whose recordings have another output now. They are not changed."""
    for old, new in list(left.items())[:1]:
        more = f" (and {len(left) - 1:,} more outputs of earlier runs)" if len(left) > 1 else ""
        yield f"{old} is out of date: its recording is written to {new} now{more}; the old file is not changed"


def _reason(
    found: Found,
    choice: Choice,
    output: str,
    history: History,
    there: Identity,
    checksum: Callable[[Found], str] | None,
) -> str:
    """Return why a recording is converted; empty if its result is up to date."""
    record = history.records.get(found.key)
    if record is None:
        return "interrupted before" if output in history.begun else "new"
    if record.version != __version__:
        return f"converted by pc2scan {record.version}"
    if record.options != choice.digest:
        return "other options"
    if changed := _changed(found, record, checksum):
        return changed
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


def _changed(found: Found, record: Record, checksum: Callable[[Found], str] | None) -> str:
    before, now = record.identity, found.identity
    if not now.has_sizes_of(before):
        return f"the source was changed: it has {size(now.size_bytes)}, it had {size(before.size_bytes)}"
    if checksum is not None and record.sha256 is not None:
        return "" if checksum(found) == record.sha256 else "the source was changed: another checksum"
    if now == before:
        return ""
    of_store = any(isinstance(version, str) for _, _, version in now.files)
    return f"the source was changed: another {'version' if of_store else 'time of modification'}"

"""Converts several recordings one by one, each into its own recording."""

from __future__ import annotations

import os
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pc2scan.bags.destinations import named_after
from pc2scan.bags.folders import recordings_in
from pc2scan.bags.opening import sniff
from pc2scan.errors import DestinationError, Pc2ScanError, UsageError
from pc2scan.files.ownership import OutputPath, inputs_of, refuse_overlap
from pc2scan.files.same_file import path_key
from pc2scan.remote.urls import is_url
from pc2scan.version import __version__

from .report import Failure
from .run import report_file, run

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from .options import ConvertOptions
    from .report import Report
    from .run import OutputOptions, Progress

__all__ = ["Each", "Outcome", "run_each"]

#: Exit statuses, from good to bad.
_STATUSES = (0, 3, 4, 2, 1)


@dataclass(slots=True)
class Outcome:
    """The result of one recording: a report, or the error that it failed with.

    Attributes
    ----------
    source, destination
        ``destination`` is None if the source is not a recording.
    """

    source: Path
    destination: Path | None = None
    report: Report | None = None
    error: Pc2ScanError | None = None

    @property
    def exit_status(self) -> int:
        """The exit status of a run with this source alone."""
        if self.error is not None:
            return self.error.exit_status
        return self.report.exit_status if self.report is not None else 0

    def as_dict(self) -> dict[str, Any]:
        """Return the result as JSON's types: the keys of a report, or those of a `Failure`."""
        if self.report is not None:
            return self.report.as_dict()
        if self.error is None:
            return {}
        destination = None if self.destination is None else str(self.destination)
        return Failure(self.error, [str(self.source)], destination).as_dict()


@dataclass(slots=True)
class Each:
    """The results of several recordings."""

    outcomes: list[Outcome] = field(default_factory=list)

    @property
    def exit_status(self) -> int:
        """The worst exit status of all recordings."""
        return max((outcome.exit_status for outcome in self.outcomes), key=_STATUSES.index, default=0)

    def as_dict(self) -> dict[str, Any]:
        """Return all reports as JSON's types."""
        return {
            "pc2scan": __version__,
            "exit_status": self.exit_status,
            "conversions": [outcome.as_dict() for outcome in self.outcomes],
        }


def run_each(
    sources: Sequence[Path],
    options: ConvertOptions,
    output: OutputOptions,
    *,
    also_read: Mapping[str, Path] | None = None,
    progress: Progress | None = None,
    done: Callable[[Outcome], None] | None = None,
) -> Each:
    """Convert each of several recordings on its own, like `pc2scan.convert`.

    Parameters
    ----------
    sources
        Recordings, and folders of several recordings.
    output
        ``folder`` is the folder of the destinations; None: next to their sources. One report file describes all.
    done
        Called with each outcome as it is known.

    Returns
    -------
    Each
        The results in order. The other recordings are converted even if one cannot be.

    Raises
    ------
    UsageError
        If a recording is given twice, or two would get the same name.
    """
    if not sources:
        raise UsageError("no source given")
    if any(map(is_url, (*sources, output.folder, output.report))):
        raise UsageError("`each` takes local paths, not URLs", hint="`pc2scan batch URL -o FOLDER/` takes URLs")
    result = Each(list(_with_destinations(sources, output)))
    _refuse_collisions(result.outcomes)
    inputs = inputs_of(outcome.source for outcome in result.outcomes)
    for outcome in result.outcomes:
        if outcome.destination is not None:
            refuse_overlap(inputs, [OutputPath(outcome.destination)])
    with ExitStack() as stack:
        deliver = None
        if output.report is not None:
            paths = [path for each in result.outcomes for path in (each.source, each.destination) if path is not None]
            inputs = inputs_of(paths, options.frames.tf_from, also_read)
            refuse_overlap(inputs, [OutputPath(output.report, "`report`")])
            deliver = report_file(output, stack)
        for outcome in result.outcomes:
            if outcome.error is None:
                try:
                    outcome.report = run(
                        [outcome.source],
                        None,
                        options,
                        output._replace(report=None),
                        also_read=also_read,
                        progress=progress,
                    )
                except Pc2ScanError as err:
                    outcome.error = err
            if done is not None:
                done(outcome)
        if deliver is not None:
            import json  # noqa: PLC0415  # only for a report file

            deliver(json.dumps(result.as_dict(), indent=2) + "\n")
    return result


def _with_destinations(sources: Sequence[Path], output: OutputOptions) -> Iterator[Outcome]:
    """Yield the recordings with their destinations."""
    for source in (path for given in sources for path in _expanded(given)):
        try:
            container = sniff(source).partition("+")[0]
        except Pc2ScanError as err:
            yield Outcome(source, error=err)
        else:
            yield Outcome(source, named_after(source, container, folder=output.folder, to=output.to))


def _expanded(source: Path) -> Sequence[Path]:
    """Return the recordings in a folder; of any other path the path itself."""
    if source.is_dir():
        try:
            sniff(source)
        except Pc2ScanError:
            return recordings_in(source) or (source,)
    return (source,)


def _refuse_collisions(outcomes: Sequence[Outcome]) -> None:
    """Raise if a recording is given twice, or if two would get the same destination."""
    sources: dict[str, Path] = {}
    destinations: dict[object, Path] = {}
    for outcome in outcomes:
        source = os.path.realpath(outcome.source)
        if source in sources:
            other = f" (as {sources[source]} too)" if sources[source] != outcome.source else ""
            raise UsageError(f"the recording is given twice{other}", path=outcome.source)
        sources[source] = outcome.source
        if outcome.destination is None:
            continue
        place = path_key(outcome.destination)
        if place in destinations:
            raise DestinationError(
                f"would be the output of both {destinations[place]} and {outcome.source}",
                path=outcome.destination,
                hint="convert one of them into another folder",
            )
        destinations[place] = outcome.source

"""The report of a batch: the structure from which tables, report files and the exit status are made."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from pc2scan.errors import leading, visible
from pc2scan.result import BEGINNING, Part, Result
from pc2scan.tables import Table, csv_cell
from pc2scan.text import count, counted, duration, size
from pc2scan.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from .manifest import ManifestRecord
    from .plan import Step

#: Outcomes from bad to good. Recordings are shown in this order.
_ORDER = ("died", "failed", "not begun", "empty", "incomplete", "converted", "skipped")

#: Outcomes that make the exit status 1, and 3.
_BAD, _ODD = frozenset({"died", "failed", "not begun"}), frozenset({"empty", "incomplete"})

#: Maximum number of recordings in the table on the screen. The report's file and the manifest have all of them.
_MAX_SHOWN = 30

#: Columns of the report's table.
_COLUMNS = (
    ("recording", "key"),
    ("output", "output"),
    ("outcome", "outcome"),
    ("status", "exit_status"),
    ("action", "action"),
    ("scans", "scans"),
    ("empty", "empty_scans"),
    ("skipped", "skipped"),
    ("damaged", "damaged"),
    ("warnings", "warnings"),
    ("bytes_read", "bytes_read"),
    ("bytes_written", "bytes_written"),
    ("seconds", "seconds"),
    ("attempts", "attempts"),
    ("why", "why"),
    ("error", "error"),
)

#: The first bytes of reports, by suffix. Only a file that begins with them is replaced by another report.
BEGINNINGS = {
    ".json": BEGINNING,
    ".csv": (",".join(heading for heading, _ in _COLUMNS)).encode(),
    ".md": b"# Batch of pc2scan",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """The outcome of one recording.

    Attributes
    ----------
    key
        Its name in the dataset.
    action
        ``convert``, ``keep`` (done by an earlier run), ``refuse`` or ``skip``.
    why
        The reason.
    outcome
        As in a `pc2scan.batch.manifest.ManifestRecord`; or ``skipped``; or ``not begun``, if the run ended before that.
    exit_status
        The exit status that `pc2scan convert` would have had.
    output
        The path of the result, relative to the folder of the batch; empty for none.
    scans, empty_scans
        Messages that were converted, and how many of them have no return.
    skipped, warnings
        Numbers of messages that are missing in the result, and of warnings.
    damage
        What is damaged in the source.
    bytes_read, bytes_written, seconds, attempts
        As the conversion reports them.
    error, hint
        Why it failed, and what helps; empty if it did not.
    """

    key: str
    action: str
    why: str
    outcome: str
    exit_status: int = 0
    output: str = ""
    scans: int = 0
    empty_scans: int = 0
    skipped: int = 0
    damage: tuple[str, ...] = ()
    warnings: int = 0
    bytes_read: int = 0
    bytes_written: int = 0
    seconds: float = 0.0
    attempts: int = 0
    error: str = ""
    hint: str = ""

    @classmethod
    def of(cls, step: Step, record: ManifestRecord | None) -> Outcome:
        """Return the outcome of a step of the plan, given its line of the manifest."""
        if step.action == "skip":
            return cls(key=step.found.key, action="skip", why=step.why, outcome="skipped")
        if record is None:
            return cls(key=step.found.key, action=step.action, why=step.why, outcome="not begun", exit_status=1)
        report: Mapping[str, Any] = record.report or {}
        error: Mapping[str, Any] = record.error or {}
        topics = report.get("topics", ())
        if report.get("kind") == "export":
            scans, empty = sum(topic["written"] for topic in topics), 0
        else:
            converted = [topic for topic in topics if topic["action"] == "converted"]
            scans, empty = (sum(topic[name] for topic in converted) for name in ("messages_out", "empty_scans"))
        return cls(
            key=step.found.key,
            action=step.action,
            why=step.why,
            outcome=record.outcome,
            exit_status=record.exit_status,
            output=record.output if record.report is not None else "",
            scans=scans,
            empty_scans=empty,
            skipped=report.get("skipped_count", 0),
            damage=tuple(place["what"] for place in report.get("damage", ())),
            warnings=len(report.get("warnings", ())),
            bytes_read=record.identity.size_bytes,
            bytes_written=report.get("bytes_written", record.output_identity.size_bytes),
            seconds=record.seconds,
            attempts=record.attempts,
            error=str(error.get("message", "")),
            hint=str(error.get("hint") or ""),
        )

    @property
    def damaged(self) -> int:
        """How many places of the source are damaged."""
        return len(self.damage)

    @property
    def rank(self) -> tuple[int, bool, bool]:
        """The sorting key that puts bad outcomes first."""
        return _ORDER.index(self.outcome), not self.empty_scans, not self.warnings

    @property
    def remark(self) -> str:
        """A short text on what is special: skipped messages, damage, warnings."""
        if self.error:
            return self.error
        counted = ((self.skipped, "skipped"), (self.damaged, "damaged"), (self.warnings, "warnings"))
        return ", ".join(f"{number:,} {what}" for number, what in counted if number)


@dataclass(slots=True, repr=False)
class BatchReport(Result):
    """The report of a batch.

    Attributes
    ----------
    destination
        The folder of the results.
    outcomes
        One for each recording, in the order of their names.
    dry_run
        Whether it was a dry run: outcomes are forecasts, and sizes are estimates.
    seconds
        The duration of the run.
    workers
        How many recordings were converted at a time; 0 if there were none.
    estimate_seconds
        For a dry run: how long the conversions would take on this machine; None if that cannot be estimated.
    warnings
        Warnings.
    """

    kind: ClassVar[str] = "batch"
    json_names: ClassVar[tuple[str, ...]] = (
        *("destination", "dry_run", "counts", "unchanged", "workers", "seconds", "estimate_seconds", "recordings"),
    )

    destination: Path | str
    outcomes: list[Outcome] = field(default_factory=list)
    dry_run: bool = False
    seconds: float = 0.0
    workers: int = 0
    estimate_seconds: float | None = None
    warnings: list[str] = field(default_factory=list)

    @property
    def exit_status(self) -> int:
        """0 if every recording is converted; 3 if some are incomplete or empty; 1 if any failed."""
        found = {outcome.outcome for outcome in self.outcomes}
        return 1 if found & _BAD else 3 if found & _ODD else 0

    @property
    def counts(self) -> dict[str, int]:
        """How many recordings have each outcome, the bad ones first."""
        counted = Counter(outcome.outcome for outcome in self.outcomes)
        return {name: counted[name] for name in _ORDER if counted[name]}

    @property
    def unchanged(self) -> int:
        """How many recordings had been converted before."""
        return sum(outcome.action == "keep" for outcome in self.outcomes)

    def __repr__(self) -> str:
        counts = ", ".join(f"{number:,} {name}" for name, number in self.counts.items())
        return f"<BatchReport on {str(self.destination)!r}: {counts or 'nothing'}, exit status {self.exit_status}>"

    @property
    def recordings(self) -> list[dict[str, Any]]:
        """The rows of the report's table, bad outcomes first."""
        return [{heading: getattr(each, name) for heading, name in _COLUMNS} for each in self._ordered()]

    def _ordered(self) -> list[Outcome]:
        return sorted(self.outcomes, key=lambda outcome: outcome.rank)

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the recordings, bad outcomes first, and the total; ``verbose``: all recordings."""
        if self.dry_run:
            yield "dry run, nothing is written"
        ordered = self._ordered()
        listed = ordered if verbose else ordered[:_MAX_SHOWN]
        if listed:
            yield Table(
                ("recording", "outcome", "scans", "empty", "written", "why", "remark"),
                [
                    (
                        each.key,
                        each.outcome,
                        count(each.scans),
                        count(each.empty_scans),
                        size(each.bytes_written) if each.bytes_written else "-",
                        each.why if each.action != "refuse" else "",
                        each.remark,
                    )
                    for each in listed
                ],
                left=("recording", "outcome", "why", "remark"),
            )
            if more := len(ordered) - len(listed):
                worst = ordered[len(listed)].outcome
                yield f"and {more:,} more, {worst} or better (`report` lists all)"
            yield ""
        yield from self.total()

    def total(self) -> Iterator[str]:
        """Yield the numbers of recordings, scans and bytes."""
        counts = ", ".join(f"{number:,} {name}" for name, number in self.counts.items())
        would = "would be: " if self.dry_run else ""
        yield f"{counted(len(self.outcomes), 'recording')}{f': {would}{counts}' if counts else ''}" + (
            f"; {self.unchanged:,} unchanged since an earlier run" if self.unchanged else ""
        )
        done = [each for each in self.outcomes if each.action == "convert"]
        read, written = sum(each.bytes_read for each in done), sum(each.bytes_written for each in done)
        scans, empty = sum(each.scans for each in self.outcomes), sum(each.empty_scans for each in self.outcomes)
        if self.dry_run:
            if done:
                took = "unknown" if self.estimate_seconds is None else f"about {duration(self.estimate_seconds)}"
                yield f"{len(done):,} to convert: {size(read)}; written would be about {size(written)}; time: {took}"
            return
        yield f"{counted(scans, 'scan')}, {empty:,} without a return"
        if done:
            failed = sum(each.outcome in ("failed", "died") for each in done)
            yield (
                f"{self.destination}: {len(done) - failed:,} converted now, {size(written)} from {size(read)} in "
                f"{duration(self.seconds)}, {self.workers} at a time"
            )
        else:
            yield f"{leading(str(self.destination))}: nothing to do ({duration(self.seconds)})"


def report_text(report: BatchReport, suffix: str) -> str:
    """Return a report as the text of a file; ``suffix`` is a key of `BEGINNINGS`."""
    if suffix == ".json":
        return report.as_json()
    rows = [list(line.values()) for line in report.recordings]
    headings = [heading for heading, _ in _COLUMNS]
    if suffix == ".csv":
        cells = [[csv_cell(cell) if isinstance(cell, str) else str(cell) for cell in row] for row in rows]
        return "".join(f"{','.join(line)}\n" for line in (headings, *cells))
    return "\n".join(_markdown(report, headings, rows)) + "\n"


def _markdown(report: BatchReport, headings: Sequence[str], rows: Sequence[Sequence[Any]]) -> Iterator[str]:
    yield f"{BEGINNINGS['.md'].decode()} {__version__}"
    yield ""
    yield from (f"{visible(line)}\n" for line in report.total())
    yield f"| {' | '.join(headings)} |"
    yield f"|{'---|' * len(headings)}"
    for row in rows:
        yield f"| {' | '.join(_cell(str(cell)) for cell in row)} |"


def _cell(text: str) -> str:
    # Names come from recordings and folders. Escaped, they cannot be taken for markup.
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>#|~" else c for c in visible(text, None))

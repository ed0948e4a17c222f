"""The report of a batch: the structure from which tables, report files and the exit status are made."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from pc2scan.errors import leading, name_list
from pc2scan.result import Part, Result
from pc2scan.text import Table, count, counted, duration, size

from .manifest import NO_CLOUDS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from .jobs import Job
    from .manifest import ManifestRecord

#: Outcomes from bad to good. Recordings are shown in this order.
_ORDER = ("died", "failed", "empty", "incomplete", NO_CLOUDS, "converted", "skipped")

#: Outcomes that make the exit status 1, and 3.
_BAD, _ODD = frozenset({"died", "failed"}), frozenset({"empty", "incomplete"})

#: Maximum number of recordings that are listed one by one. If there are more, their remarks are listed instead.
_MAX_SHOWN = 30

#: How many recordings are named as examples.
_EXAMPLES = 3

#: What differs between texts that say the same of different recordings: options at the end, quoted names, topics,
#: numbers; and what agrees with a number.
_VARIABLE = re.compile(r":(?: `[^`]*`)+$|'[^']*'|(?<![\w.])/[\w./-]+(?:, /[\w./-]+)*|-?\d[\d,.]*(?:e[+-]?\d+)?")
_AGREEING = re.compile(r"\b(?:is|are|was|were|has|have|its|their)\b|(?<=# )([a-z]+?)s?\b")


class RemarkGroup(NamedTuple):
    """Recordings with the same remark, apart from names and numbers.

    Attributes
    ----------
    kind
        ``warning``, ``damaged``, ``skipped``, or the outcome of which it is the reason.
    text
        The remark about the first of them.
    recordings
        Their names in the dataset.
    """

    kind: str
    text: str
    recordings: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingOutcome:
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
        As in a `pc2scan.datasets.manifest.ManifestRecord`; or ``skipped``.
    exit_status
        The exit status that `pc2scan convert` would have had.
    output
        The path of the result, relative to the folder of the batch; empty for none.
    scans, empty_scans
        Messages that were converted, and how many of them have no return.
    skipped
        The number of messages that are missing in the result.
    warnings, damage
        The warnings, and what is damaged in the source.
    bytes_read, bytes_written, seconds, attempts
        As the conversion reports them.
    error, hint
        Why it failed, or has nothing to convert, and what helps; empty if there is a result.
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
    warnings: tuple[str, ...] = ()
    bytes_read: int = 0
    bytes_written: int = 0
    seconds: float = 0.0
    attempts: int = 0
    error: str = ""
    hint: str = ""

    @classmethod
    def skipped_by_file(cls, key: str) -> RecordingOutcome:
        """Return the outcome of a recording that the dataset file skips."""
        return cls(key=key, action="skip", why="the dataset file skips it", outcome="skipped")

    @classmethod
    def of(cls, job: Job, record: ManifestRecord) -> RecordingOutcome:
        """Return the outcome of a job, given its line of the manifest."""
        report: Mapping[str, Any] = record.report or {}
        error: Mapping[str, Any] = record.error or {}
        topics = report.get("topics", ())
        if report.get("kind") == "export":
            scans, empty = sum(topic["written"] for topic in topics), 0
        else:
            converted = [topic for topic in topics if topic["action"] == "converted"]
            scans, empty = (sum(topic[name] for topic in converted) for name in ("messages_out", "empty_scans"))
        return cls(
            key=job.key,
            action=job.action,
            why=job.why,
            outcome=record.outcome,
            exit_status=record.exit_status,
            output=record.output if record.report is not None else "",
            scans=scans,
            empty_scans=empty,
            skipped=report.get("skipped_count", 0),
            damage=tuple(place["what"] for place in report.get("damage", ())),
            warnings=tuple(map(str, report.get("warnings", ()))),
            bytes_read=record.identity.size_bytes,
            bytes_written=report.get("bytes_written", record.output_identity.size_bytes),
            seconds=record.seconds,
            attempts=record.attempts,
            error=str(error.get("message", "")),
            hint=str(error.get("hint") or ""),
        )

    @property
    def rank(self) -> tuple[int, bool, bool]:
        """The sorting key that puts bad outcomes first."""
        return _ORDER.index(self.outcome), not self.empty_scans, not self.warnings

    @property
    def remark(self) -> str:
        """A short text on what is special: skipped messages, damage, warnings."""
        if self.error:
            return self.error if self.outcome != NO_CLOUDS else ""
        numbers = {"skipped": self.skipped, "damaged": len(self.damage)}
        counts = [f"{number:,} {what}" for what, number in numbers.items() if number]
        return ", ".join([*counts, counted(len(self.warnings), "warning")] if self.warnings else counts)

    def remarks(self) -> Iterator[tuple[str, str]]:
        """Yield the remarks about it: the kind (see `RemarkGroup`) and the text."""
        if self.error:
            yield self.outcome, f"{self.error} ({self.hint})" if self.hint else self.error
        if self.skipped:
            yield "skipped", counted(self.skipped, "message")
        yield from (("damaged", text) for text in self.damage)
        yield from (("warning", text) for text in self.warnings)


def groups_of(outcomes: Iterable[RecordingOutcome]) -> list[RemarkGroup]:
    """Return the remarks that several recordings share, the worst first, then the most frequent."""
    remarks: dict[tuple[str, str], tuple[str, dict[str, None]]] = {}
    for outcome in outcomes:
        for kind, text in outcome.remarks():
            alike = _AGREEING.sub(r"\1", _VARIABLE.sub(lambda match: "" if match[0][0] == ":" else "#", text))
            _, keys = remarks.setdefault((kind, alike), (text, {}))
            keys[outcome.key] = None
    kinds = [*_ORDER, "skipped", "damaged", "warning"]
    groups = [RemarkGroup(kind, text, tuple(keys)) for (kind, _), (text, keys) in remarks.items()]
    return sorted(groups, key=lambda group: (kinds.index(group.kind), -len(group.recordings)))


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
        Whether it was a dry run, which converts only the first clouds.
    seconds
        The duration of the run.
    workers
        How many recordings were converted at a time; 0 if a cluster decides it.
    warnings
        Warnings.
    """

    kind: ClassVar[str] = "batch"
    json_names: ClassVar[tuple[str, ...]] = (
        *("destination", "dry_run", "counts", "unchanged", "workers", "seconds"),
        *("groups", "recordings"),
    )

    destination: Path | str
    outcomes: list[RecordingOutcome] = field(default_factory=list)
    dry_run: bool = False
    seconds: float = 0.0
    workers: int = 0
    warnings: list[str] = field(default_factory=list)

    @property
    def exit_status(self) -> int:
        """0 if every recording is converted; 3 if some are incomplete or empty; 1 if any failed."""
        outcomes = {outcome.outcome for outcome in self.outcomes}
        return 1 if outcomes & _BAD else 3 if outcomes & _ODD else 0

    @property
    def counts(self) -> dict[str, int]:
        """How many recordings have each outcome, the bad ones first."""
        counted = Counter(outcome.outcome for outcome in self.outcomes)
        return {name: counted[name] for name in _ORDER if counted[name]}

    @property
    def unchanged(self) -> int:
        """How many recordings had been converted before."""
        return sum(outcome.action == "keep" for outcome in self.outcomes)

    @property
    def groups(self) -> list[RemarkGroup]:
        """The remarks that several recordings share, the worst first, then the most frequent."""
        return groups_of(self.recordings)

    @property
    def recordings(self) -> list[RecordingOutcome]:
        """The outcomes, the bad ones first."""
        return sorted(self.outcomes, key=lambda outcome: outcome.rank)

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the recordings, bad outcomes first, the remarks that several share, and the total.

        If there are more than thirty recordings, only the remarks about those that need attention are listed;
        ``verbose``: all recordings.
        """
        if self.dry_run:
            yield "dry run, nothing is written"
        listed = self.recordings if verbose or len(self.outcomes) <= _MAX_SHOWN else []
        if listed:
            yield _table_of(listed)
            yield ""
        # Errors are in the table already.
        groups = [group for group in self.groups if not listed or group.kind not in _ORDER]
        if groups:
            yield _table_of_groups(groups)
            yield ""
        yield from self.total()

    def total(self) -> Iterator[str]:
        """Yield the numbers of recordings, scans and bytes."""
        counts = ", ".join(f"{number:,} {name}" for name, number in self.counts.items())
        would = "would be: " if self.dry_run else ""
        yield f"{counted(len(self.outcomes), 'recording')}{f': {would}{counts}' if counts else ''}" + (
            f"; {self.unchanged:,} unchanged since an earlier run" if self.unchanged else ""
        )
        conversions = [outcome for outcome in self.outcomes if outcome.action == "convert"]
        read, written = (
            sum(outcome.bytes_read for outcome in conversions),
            sum(outcome.bytes_written for outcome in conversions),
        )
        scans, empty = (
            sum(outcome.scans for outcome in self.outcomes),
            sum(outcome.empty_scans for outcome in self.outcomes),
        )
        if self.dry_run:
            if conversions:
                yield f"{len(conversions):,} to convert: {size(read)}"
            return
        yield f"{counted(scans, 'scan')}, {empty:,} without a return"
        if conversions:
            results = sum(outcome.outcome in ("empty", "incomplete", "converted") for outcome in conversions)
            yield (
                f"{self.destination}: {counted(results, 'result')} written now, {size(written)} from {size(read)} in "
                f"{duration(self.seconds)}" + (f", {self.workers} at a time" if self.workers else "")
            )
        else:
            yield f"{leading(str(self.destination))}: nothing to do ({duration(self.seconds)})"


def _table_of(outcomes: Iterable[RecordingOutcome]) -> Table:
    rows = [
        (
            outcome.key,
            outcome.outcome,
            count(outcome.scans),
            count(outcome.empty_scans),
            size(outcome.bytes_written) if outcome.bytes_written else "-",
            outcome.why if outcome.action != "refuse" else "",
            outcome.remark,
        )
        for outcome in outcomes
    ]
    headings = ("recording", "outcome", "scans", "empty", "written", "why", "remark")
    return Table(headings, rows, left=("recording", "outcome", "why", "remark"))


def _table_of_groups(groups: Iterable[RemarkGroup]) -> Table:
    rows = [
        (f"{len(group.recordings):,}", group.kind, group.text, name_list(group.recordings, _EXAMPLES))
        for group in groups
    ]
    return Table(("recordings", "what", "text", "such as"), rows, left=("what", "text", "such as"))

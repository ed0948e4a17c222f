"""The report of a conversion: one structure that the table, the JSON file and the exit status read."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.formats import FORMATS
from pc2scan.core.rule import REJECTIONS, Rejection
from pc2scan.errors import leading, stamp_text
from pc2scan.text import Shown, Table, count, json_value, listed, size
from pc2scan.version import __version__

from .report_warnings import loss_warning, param_notes, topic_notes, topic_warnings

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pc2scan.bags.damage import Damage
    from pc2scan.core.params import ProjectionParams
    from pc2scan.errors import Pc2ScanError

    from .scan_spec import ScanSpec
    from .topic_report import TopicReport

#: The beginning of every report as JSON: such a file may be replaced by another report.
BEGINNING = b'{\n  "pc2scan": "'

#: How many skipped messages are listed one by one; all of them are counted.
MAX_LISTED = 100

#: How many damaged places, and skipped messages, are shown as text.
_MAX_SHOWN = 5


class Failure(NamedTuple):
    """A conversion that failed before its options were resolved.

    Attributes
    ----------
    error
        The error.
    sources, destination
        Paths as they were given; None for no destination.
    """

    error: Pc2ScanError
    sources: list[str]
    destination: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON's types: some of the keys of a report."""
        return {
            "pc2scan": __version__,
            "exit_status": self.error.exit_status,
            "error": self.error.as_dict(),
            "sources": self.sources,
            "destination": self.destination,
        }

    def as_json(self) -> str:
        """Return it as the text of a report's file."""
        return _json(self.as_dict())


class Skipped(NamedTuple):
    """A message that was not converted.

    Attributes
    ----------
    topic, log_time_ns, stamp_ns
        The message; ``stamp_ns`` is None if its header cannot be read.
    reason
        The reason, with numbers.
    hint
        What the user can do; empty if unknown.
    targets
        The topics of the destination that miss its result.
    """

    topic: str
    log_time_ns: int
    stamp_ns: int | None
    reason: str
    hint: str = ""
    targets: tuple[str, ...] = ()

    def __str__(self) -> str:
        when = (
            f"log time {stamp_text(self.log_time_ns)}"
            if self.stamp_ns is None
            else f"stamp {stamp_text(self.stamp_ns)}"
        )
        return f"{self.topic}, {when}: {self.reason}"


@dataclass(slots=True, repr=False)
class Report(Shown):
    """The report of a conversion.

    Attributes
    ----------
    sources, destination
        Paths as they were given; empty if the run failed before the destination was known.
    error
        The error of a run that failed and wrote nothing; None if it did not fail.
    dry_run
        Whether it was a dry run: counts and sizes are estimates, and points are those of the first messages.
    container, ros_version
        Container and ROS version of the destination: ``rosbag1``, ``rosbag2`` or ``mcap``, and 1 or 2; empty and 0 as
        long as they are not known.
    scans
        The request of each output; nearly always there is only one.
    source_frame
        The frame that replaces the clouds' ``frame_id``; empty if none does.
    topics
        One entry for each source topic and each topic that it goes to, in the source's order.
    skipped
        The first `MAX_LISTED` messages that were not converted.
    warnings
        Problems that did not stop the conversion.
    notes
        Values that were measured, or chosen by default.
    damage
        Damaged places in the parts of the sources that were read.
    messages_read
        How many messages of the sources were read, of all topics that are not skipped.
    messages_declared
        How many messages the sources declare, of all topics that are not skipped; None if they do not declare it, or
        if only a part was requested.
    undelivered
        Whether the report's file could not be written; the recording is written nevertheless.
    """

    sources: list[str]
    destination: str
    scans: tuple[ScanSpec, ...]
    source_frame: str = ""
    topics: list[TopicReport] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    damage: list[Damage] = field(default_factory=list)
    messages_read: int = 0
    messages_declared: int | None = None
    undelivered: bool = False
    error: Pc2ScanError | None = None
    dry_run: bool = False
    container: str = ""
    ros_version: int = 0
    files: list[str] = field(default_factory=list)
    bytes_read: int = 0
    bytes_written: int = 0
    seconds: float = 0.0

    @property
    def params(self) -> ProjectionParams:
        """The projection's parameters of the first output."""
        return self.scans[0].params

    @property
    def origins(self) -> Mapping[str, str]:
        """The origin of each parameter of the first output, by name; ``default`` if it was not given."""
        return self.scans[0].origins

    @property
    def written_to(self) -> str:
        """The destination for the beginning of a line; for several files the first, the last and their number."""
        if len(self.files) < 2:  # several
            is_file = self.files and not FORMATS[self.container].is_directory
            return leading(self.files[0] if is_file else self.destination)
        return f"{leading(self.destination)}: {len(self.files)} files, {self.files[0]} to {self.files[-1]}"

    @property
    def skipped_count(self) -> int:
        """How many messages are missing in the destination, in all topics, listed or not."""
        return sum(topic.skipped for topic in self.topics)

    @property
    def exit_status(self) -> int:
        """The exit status of the run.

        0 for success; 4 if the recording is written, but none of its scans has a return; 3 if it is written, but a
        source is damaged, messages are missing in the destination, or the report is not written. If the run failed: the
        status of its error.
        """
        if self.error is not None:
            return self.error.exit_status
        if self.all_empty:
            return 4
        return 3 if self.damage or self.skipped_count or self._lost_topics() or self.undelivered else 0

    @property
    def all_empty(self) -> bool:
        """Whether messages were converted, and no result has a return or a point."""
        converted = [topic for topic in self.topics if topic.action == "converted"]
        made = sum(topic.messages_out for topic in converted)
        return made > 0 and sum(topic.empty_scans for topic in converted) == made

    def _lost_topics(self) -> list[TopicReport]:
        """Topics whose messages are missing because they cannot be written."""
        return [topic for topic in self.topics if topic.lost and topic.messages_in]

    def list_skipped(self, skipped: Skipped) -> None:
        """Add a skipped message to the list, unless it is full."""
        if len(self.skipped) < MAX_LISTED:
            self.skipped.append(skipped)

    def conclude(self) -> None:
        """Add the warnings and notes that depend on the whole conversion."""
        for spec in self.scans:
            self.notes += (note for note in param_notes(spec) if note not in self.notes)
        if lost := self._lost_topics():
            self.warnings.append(loss_warning(lost))
        for topic in self.topics:
            self.warnings += topic_warnings(topic, self.scans[0], self.rejections, self.source_frame)
            self.notes += topic_notes(topic, self.source_frame)

    @property
    def rejections(self) -> dict[str, Rejection]:
        """Why points may be rejected, by the name of the count."""
        further = (rejection for spec in self.scans for rejection in spec.rejections)
        return {each.name: each for each in (*REJECTIONS, *further)}

    def __repr__(self) -> str:
        converted = sum(topic.messages_out for topic in self.topics if topic.action == "converted")
        return f"<Report on {self.destination!r}: {converted:,} messages converted, exit status {self.exit_status}>"

    def tables(self) -> Iterator[str | Table]:
        """Yield the table of topics, the table of points, and the notes."""
        yield Table(
            ("topic", "to", "in", "out", "skipped", "what"),
            [
                (
                    topic.topic,
                    topic.target or "-",
                    *map(count, (topic.messages_in, topic.messages_out, topic.skipped)),
                    topic.action + " (cloud kept)" * topic.clouds_kept + (topic.note and f": {topic.note}"),
                )
                for topic in self.topics
            ],
            left=("topic", "to", "what"),
        )
        if converted := [topic for topic in self.topics if topic.action == "converted"]:
            yield ""
            reasons = self.rejections.values()
            yield Table(
                ("on", "points", "used", *(reason.heading for reason in reasons), "empty"),
                [
                    (
                        topic.target or "-",
                        *map(count, (topic.points.total, topic.points.used)),
                        *(count(topic.points.rejected.get(reason.name, 0)) for reason in reasons),
                        count(topic.empty_scans),
                    )
                    for topic in converted
                ],
                left=("on",),
            )
        yield ""
        yield from (f"note: {note}" for note in self.notes)

    def _shown(self) -> Iterator[str | Table]:
        if self.dry_run:
            yield "dry run, nothing is written"
            yield ""
        yield from self.tables()
        written, read = size(self.bytes_written), size(self.bytes_read)
        yield f"{self.written_to}: {written} from {read}, exit status {self.exit_status}"
        yield from listed([str(place) for place in self.damage], "damaged", _MAX_SHOWN)
        yield from listed([str(entry) for entry in self.skipped], "skipped", _MAX_SHOWN)
        if hint := next((entry.hint for entry in self.skipped if entry.hint), ""):
            yield f"hint: {hint}"
        yield from (f"warning: {warning}" for warning in self.warnings)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as JSON's types; the keys are documented in docs/report.md."""
        return {
            "pc2scan": __version__,
            "exit_status": self.exit_status,
            "error": None if self.error is None else self.error.as_dict(),
            "sources": self.sources,
            "destination": self.destination or None,
            "files": self.files,
            "dry_run": self.dry_run,
            "container": self.container or None,
            "ros_version": self.ros_version or None,
            **_spec_as_dict(self.scans[0]),
            "scans": [{"name": spec.name, **_spec_as_dict(spec)} for spec in self.scans if spec.name],
            "topics": [topic.as_dict() for topic in self.topics],
            "skipped": [entry._asdict() for entry in self.skipped],
            "skipped_count": self.skipped_count,
            "damage": [damage.as_dict() for damage in self.damage],
            "messages_read": self.messages_read,
            "messages_declared": self.messages_declared,
            "warnings": self.warnings,
            "notes": self.notes,
            "bytes_read": self.bytes_read,
            "bytes_written": self.bytes_written,
            "seconds": round(self.seconds, 3),
        }

    def as_json(self) -> str:
        """Return the report as the text of its file."""
        return _json(self.as_dict())


def _spec_as_dict(spec: ScanSpec) -> dict[str, Any]:
    """Return the parameters and options of an output as JSON's types."""
    from .stages.filters import as_dict  # noqa: PLC0415  # only reports in JSON need it

    return {
        "params": json_value(asdict(spec.params)),
        "param_origins": dict(spec.origins),
        "filters": [json_value(as_dict(each)) for each in spec.filters],
    }


def _json(document: dict[str, Any]) -> str:
    import json  # noqa: PLC0415  # only where it is asked for

    return json.dumps(document, indent=2) + "\n"

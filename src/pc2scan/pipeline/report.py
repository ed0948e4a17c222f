"""The report of a conversion: one structure that the table, the JSON file and the exit status read."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.core.counts import PointCounts
from pc2scan.core.params import ProjectionParams
from pc2scan.core.rule import REJECTIONS, Rejection
from pc2scan.errors import stamp_text
from pc2scan.json_types import json_value
from pc2scan.shown import Shown, Table, agreeing, count, counted, listed, size
from pc2scan.version import __version__

from .parameters import from_preset

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.errors import Pc2ScanError

    from .combine.matching import SourceCounts
    from .combine.rebinned import Rebinned
    from .scan_spec import ScanSpec

__all__ = ["BEGINNING", "Failure", "Report", "Skipped", "Tally", "TopicReport"]

#: The beginning of every report as JSON: such a file may be replaced by another report.
BEGINNING = b'{\n  "pc2scan": "'

#: How many skipped messages are listed one by one; all of them are counted.
MAX_LISTED = 100

#: How many damaged places, and skipped messages, are shown as text.
_MAX_SHOWN = 5

#: Attributes of a topic's entry that JSON has in another form, or does not have.
_NOT_AS_THEY_ARE = {"points", "motions", "tilts", "spec", "joined", "rebinned"}

#: How many topics the warning about skipped ones lists.
_MAX_WARNED = 5

#: If a default rejects this share of the points, a warning names it.
_NOTABLE_SHARE = 0.25


#: If the seconds between two transforms exceed this, deskewing warns: odometry has ten transforms a second and more.
_NOTABLE_GAP = 0.25

#: Tilts in degrees: above the first the mount is probably wrong, below the second there is no tilt; and how many scans
#: are needed to judge it.
_NOTABLE_TILT = 45.0
_NO_TILT = 1e-4
_SEVERAL = 10

#: A relative change of the increment that is more than rounding.
_NOTABLE_STEP = 1e-5


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


class Tally(NamedTuple):
    """What is compared or said once the whole recording has been read.

    Attributes
    ----------
    path
        The source.
    counts
        For each connection that is written its topic, its declared number of messages, and how many were read.
    declared
        How many messages the source declares; None if it does not say, or not all are written.
    refusals
        Warnings that consumers would refuse the scans, each with the topics that it is about.
    """

    path: Path
    counts: Sequence[tuple[str, int | None, int]]
    declared: int | None
    refusals: Mapping[str, Sequence[str]]


@dataclass(slots=True)
class TopicReport:
    """What happened to one topic of the source.

    Attributes
    ----------
    topic, msgtype
        In the source.
    target
        The topic in the destination: the scan's if converted, the same if it passed through, None if it was skipped.
    action
        ``converted``, ``joined`` (its messages are in the scans of another topic), ``passed``, ``re-encoded``,
        ``skipped``, or ``added`` (transforms given by the user).
    note
        Why it was skipped, or another note; empty otherwise.
    messages_in, messages_out, skipped
        Messages in the source (within ``start`` and ``end``), messages written, and messages that are missing in
        the destination. Messages of a topic that the user dropped are not missing.
    points
        Points of all converted clouds: how many are used, and how many are rejected for which reason.
    empty_scans
        Scans without a single return.
    motions
        One for each deskewed cloud: the largest distance of the sensor from its pose at the scan's time, metres and
        radians, and the longest time between interpolated transforms, seconds.
    tilts
        One for each level scan: the angle between the z axis of the target frame and up, radians.
    joined
        Counts of a topic whose messages become scans together with others; None for all other topics.
    removed_beams
        Beams of filtered scans: how many had ``returns`` before, and how many each filter removed.
    rebinned
        Counts of beams, for scans that are made of scans; None for all others.
    clouds_kept
        Whether the converted clouds were written, too.
    lost
        Whether the topic should have been written but cannot be; ``note`` has the reason.
    advice
        Options with heights that suit the clouds, in a level frame; empty if none are needed.
    spec
        The request that the output was made by; None if the topic is not converted.
    """

    topic: str
    msgtype: str
    target: str | None
    action: str
    note: str = ""
    messages_in: int = 0
    messages_out: int = 0
    skipped: int = 0
    points: PointCounts = field(default_factory=PointCounts)
    empty_scans: int = 0
    motions: list[tuple[float, float, float]] = field(default_factory=list)
    tilts: list[float] = field(default_factory=list)
    joined: SourceCounts | None = None
    removed_beams: dict[str, int] = field(default_factory=dict)
    rebinned: Rebinned | None = None
    clouds_kept: bool = False
    lost: bool = False
    advice: str = ""
    spec: ScanSpec | None = field(default=None, compare=False, repr=False)

    @property
    def motion(self) -> dict[str, float] | None:
        """The largest and the median of the motions, and the longest gap; None if nothing was deskewed."""
        if not self.motions:
            return None
        from statistics import median_low  # noqa: PLC0415  # only with deskewing

        metres, radians, gaps = zip(*self.motions, strict=True)
        return {
            "largest_m": max(metres),
            "median_m": median_low(metres),
            "largest_deg": math.degrees(max(radians)),
            "median_deg": math.degrees(median_low(radians)),
            "longest_gap_s": max(gaps),
        }

    @property
    def tilt(self) -> dict[str, float] | None:
        """The largest and the median of the tilts, degrees; None if nothing was made level."""
        if not self.tilts:
            return None
        from statistics import median_low  # noqa: PLC0415  # only where scans are level

        return {
            "largest_deg": math.degrees(max(self.tilts)),
            "median_deg": math.degrees(median_low(self.tilts)),
        }

    def count_rebinned(self, found: Rebinned) -> None:
        """Add the beams of one more scan."""
        known = self.rebinned or (0, 0, 0)
        self.rebinned = type(found)(*(one + other for one, other in zip(known, found, strict=True)))

    def count_removed(self, found: Mapping[str, int]) -> None:
        """Add the beams that were removed from one more scan."""
        for name, number in found.items():
            self.removed_beams[name] = self.removed_beams.get(name, 0) + number

    def add(self, other: TopicReport) -> None:
        """Add what happened to the topic in another piece of the recording."""
        self.messages_in += other.messages_in
        self.messages_out += other.messages_out
        self.skipped += other.skipped
        self.points += other.points
        self.empty_scans += other.empty_scans
        self.motions += other.motions
        self.tilts += other.tilts
        self.count_removed(other.removed_beams)
        if other.rebinned is not None:
            self.count_rebinned(other.rebinned)

    def skip(self, count: int) -> None:
        """Count messages of a topic that is not written; they are missing unless the user dropped the topic."""
        self.messages_in += count
        if self.lost:
            self.skipped += count


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
        """The destination as text; for several files the first, the last and their number."""
        if len(self.files) < 2:  # several
            return self.files[0] if self.files and self.container != "rosbag2" else self.destination
        return f"{self.destination}: {len(self.files)} files, {self.files[0]} to {self.files[-1]}"

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
            self.notes += (note for note in _param_notes(spec) if note not in self.notes)
        if lost := self._lost_topics():
            self.warnings.append(_loss_warning(lost))
        for topic in self.topics:
            if topic.action == "converted" and not topic.messages_out:
                why = "could be converted" if topic.messages_in else "was there to convert (see `start` and `end`)"
                self.warnings.append(f"no message of {topic.topic} {why}")
            elif topic.action == "converted":
                self.warnings += self._point_warnings(topic)
            self._report_joined(topic)
            if motion := topic.motion:
                deskewed = topic.spec is not None and topic.spec.deskew
                within = "deskewed; within a cloud" if deskewed else "placed through `fixed_frame`; within a scan"
                self.notes.append(
                    f"{topic.target}: {within} the sensor moved by up to {motion['largest_m']:.3g} m "
                    f"and {motion['largest_deg']:.3g} degrees (median {motion['median_m']:.3g} m, "
                    f"{motion['median_deg']:.3g} degrees)"
                )
                if motion["longest_gap_s"] > _NOTABLE_GAP:
                    self.warnings.append(
                        f"{topic.target}: while clouds were measured, transforms to `fixed_frame` were missing for up "
                        f"to {motion['longest_gap_s']:.3g} s; deskewing assumes that the robot moved evenly meanwhile"
                    )

            if tilt := topic.tilt:
                self._report_tilt(topic, tilt)

    def _report_tilt(self, topic: TopicReport, tilt: Mapping[str, float]) -> None:
        """Note how far the target frame was from level, and warn if that is implausible."""
        spec = topic.spec
        frame = (spec.params.target_frame if spec else "") or self.source_frame or "the clouds' frame"
        by = (spec.imu or spec.fixed_frame) if spec else ""
        largest, median = tilt["largest_deg"], tilt["median_deg"]
        if median > _NOTABLE_TILT:
            self.warnings.append(
                f"{topic.target}: by {by}, {frame} is tilted by {median:.0f} degrees (median). If it is not mounted "
                "so, the mount of the IMU is wrong (`static_tf`), or z of `fixed_frame` is not up"
            )
        elif largest < _NO_TILT and len(topic.tilts) >= _SEVERAL:
            self.warnings.append(
                f"{topic.target}: by {by}, {frame} is never tilted, so `level` has no effect. Odometry of wheels knows "
                "no roll and pitch; an IMU does: `imu=TOPIC`"
            )
        else:
            self.notes.append(
                f"{topic.target}: level by {by}; {frame} was tilted by up to {largest:.3g} degrees "
                f"(median {median:.3g})"
            )

    def _report_joined(self, topic: TopicReport) -> None:
        """Report messages that become scans together, and beams that become other beams."""
        counts, scans = topic.joined, topic.target
        if counts is not None and topic.action == "joined" and counts.messages and not counts.used:
            self.warnings.append(
                f"no message of {topic.topic} is in a scan on {scans}: its stamps are never within the window of the "
                "leading topic's"
            )
        elif counts is not None and topic.action == "joined" and counts.scans_without:
            first, last, number = counts.silence
            self.warnings.append(
                f"{counted(counts.scans_without, 'scan')} on {scans} {agreeing(counts.scans_without, 'have')} "
                f"nothing of {topic.topic}; {number:,} in a row, "
                f"from {stamp_text(first)} to {stamp_text(last)}"
            )
        if counts is not None and counts.unmatched:
            self.notes.append(
                f"{counts.unmatched:,} of {counted(counts.messages, 'message')} of {topic.topic} "
                f"{agreeing(counts.unmatched, 'are')} in no scan on {scans}"
            )
        if topic.removed_beams:
            returns = topic.removed_beams["returns"]
            for name, number in topic.removed_beams.items():
                if name != "returns":
                    of = f"{scans}: {number:,} of {counted(returns, 'beam')}"
                    self.notes.append(f"{of} {agreeing(number, 'were')} {name}, and {agreeing(number, 'are')} removed")
        if beams := topic.rebinned:
            note = f"{scans}: of {beams.beams:,} beams {beams.shared:,} share one of the new scans with another"
            self.notes.append(f"{note}; {beams.between:,} of the new ones lie between two neighbours, without a return")

    @property
    def rejections(self) -> dict[str, Rejection]:
        """Why points may be rejected, by the name of the count."""
        further = (rejection for spec in self.scans for rejection in spec.rejections)
        return {each.name: each for each in (*REJECTIONS, *further)}

    def _point_warnings(self, topic: TopicReport) -> list[str]:
        """Return warnings that name the cause of scans without returns, and of points that a default rejects."""
        points = topic.points
        if topic.empty_scans:
            scans = f"{counted(topic.messages_out, 'scan')} on {topic.target}"
            empty = f"{topic.empty_scans:,} of {scans} {agreeing(topic.empty_scans, 'have')} no return at all"
            return [f"{empty}: {self._blame(topic)}"]
        warnings = []
        for each in self.rejections.values():
            share = points.rejected.get(each.name, 0) / points.total if points.total else 0.0
            if each.absent and points.total and points.rejected.get(each.name) == 0:
                warnings.append(f"{topic.target}: {each.absent}")
            if share >= _NOTABLE_SHARE and self._surprises(topic, each):
                advice = f": {topic.advice}" if topic.advice and each.name == "height" else ""
                warnings.append(f"{topic.target}: {share:.0%} of the points were {each.by_default[1]}{advice}")
        return warnings

    def _surprises(self, topic: TopicReport, rejection: Rejection) -> bool:
        """Whether a parameter that was not given rejects more points by its default than users expect."""
        name, _ = rejection.by_default
        spec = topic.spec or self.scans[0]
        if not name or spec.origins.get(name, "default") != "default":
            return False
        return bool(getattr(spec.params, name) == getattr(ProjectionParams(), name))

    def _blame(self, topic: TopicReport) -> str:
        """Return the most frequent reason, and its parameters."""
        points = topic.points
        explained = Counter[str]()
        for name, rejection in self.rejections.items():
            explanation = rejection.by_default[1] if self._surprises(topic, rejection) else rejection.explanation
            if name == "height" and topic.advice:
                explanation += f": {topic.advice}"
            explained[explanation] += points.rejected.get(name, 0)
        explanation, count = explained.most_common(1)[0]
        return f"{count / points.total:.0%} of all points were {explanation}" if count else "the clouds have no points"

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
            "topics": [
                {
                    **{f.name: getattr(topic, f.name) for f in fields(topic) if f.name not in _NOT_AS_THEY_ARE},
                    "scan": topic.spec.name if topic.spec else "",
                    "motion": topic.motion,
                    "tilt": topic.tilt,
                    "joined": None if topic.joined is None else topic.joined.as_dict(),
                    "rebinned": None if topic.rebinned is None else topic.rebinned._asdict(),
                    "points": topic.points.as_dict(),
                }
                for topic in self.topics
            ],
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


def _param_notes(spec: ScanSpec) -> Iterator[str]:
    """Yield notes about parameters."""
    params = spec.params
    layout, asked = params.layout, params.angle_increment
    # If beams are measured, another note has their number.
    if params.beams != "auto" and layout.full_circle and abs(layout.angle_increment - asked) > _NOTABLE_STEP * asked:
        yield (
            f"angle_increment is {layout.angle_increment:.7g} rad instead of {asked:.7g}: "
            f"{layout.count} beams divide the circle evenly"
        )
    origin = spec.origins.get("range_max", "")
    if from_preset(origin):
        yield (
            f"range_max is {params.range_max:g} m, chosen by {origin}: returns beyond are ignored; "
            "`range_max` chooses another"
        )


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


def _loss_warning(topics: Sequence[TopicReport]) -> str:
    """Return the warning of how many messages of which topics are missing, and why."""
    count = sum(topic.messages_in for topic in topics)
    listed = [f"{topic.topic} ({topic.messages_in:,}: {topic.note})" for topic in topics[:_MAX_WARNED]]
    more = len(topics) - len(listed)
    return (
        f"{counted(count, 'message')} of {counted(len(topics), 'topic')} "
        f"{agreeing(count, 'are')} skipped: {', '.join(listed)}{f' and {more} more' if more else ''}"
    )

"""Checks of the result of a conversion: its first scans, and the counts of its topics. Notes about it, too."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.advice.checks.clouds import NOTABLE_SHARE, notable_share
from pc2scan.bags.damage import RECOVER, Damage, count_details
from pc2scan.core.consumers import CONSUMERS, judge
from pc2scan.core.params import ProjectionParams
from pc2scan.errors import DamageError, ResultError, name_list, stamp_text
from pc2scan.messages.laserscan import decode_laserscan, scan_for_consumers
from pc2scan.request.parameters import preset_of
from pc2scan.text import agreeing, counted

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.core.rule import Rejection
    from pc2scan.core.verdicts import Outcome, Verdict
    from pc2scan.model import Buffer
    from pc2scan.request.options import ConvertOptions, ScanSpec

    from .combine.grouping import SourceCounts
    from .plan import Route
    from .report import Report, TopicReport

#: How many topics the warning about skipped ones lists.
_MAX_WARNED = 5

#: What rejects this share of the points may be the cause of empty scans.
_NOTABLE_PART = 0.05

#: If a filter that should remove faults alone removes more than this share, a warning names it.
_MOST_REMOVED = 0.1

#: What to type if too many beams are removed.
_REMEDIES = {
    "sparse": "they have fewer returns than `min_points` or `reduce=kth=N`: lower these, or use more heights or wider "
    "beams",
    "shadows": "so many are hardly mixed pixels, but thin or rough things (plants, meshes): leave out `remove=shadows`",
    "speckles": "so many are hardly noise: leave out `remove=speckles`",
}

#: The share of the beams of a scan without a return between two others from which on a note is worth it.
_NOTABLE_GAPS = 0.02

#: If the seconds between two transforms exceed this, deskewing warns: odometry has ten transforms a second and more.
_NOTABLE_GAP = 0.25

#: Tilts in degrees: above the first the mount is probably wrong, below the second there is no tilt; and how many scans
#: are needed to judge it.
_NOTABLE_TILT = 45.0
_NO_TILT = 1e-4
_SEVERAL = 10

#: If messages in a row are in no scan for this long and an interval, nanoseconds, the leading topic is silent.
_NOTABLE_SILENCE_NS = 2_000_000_000

#: A relative change of the increment that is more than rounding.
_NOTABLE_STEP = 1e-5

#: What a consumer does with scans by its verdict, as part of a sentence.
_DOES: dict[Outcome, str] = {
    "shifted": "would turn these scans by up to one beam",
    "misplaced": "would misplace these scans",
    "ignored": "would ignore these scans",
    "aborts": "would abort at these scans",
}


def refused_scans(first_scans: Sequence[tuple[TopicReport, Buffer]], serialization: str) -> Iterator[str]:
    """Yield a warning for each reason why consumers would ignore the scans, or abort, with the topics."""
    topics: dict[str, dict[str, None]] = {}
    for topic, data in first_scans:
        origins = topic.spec.origins.values() if topic.spec else ()
        chosen = next(filter(None, map(preset_of, origins)), "")
        if text := _refusal(data, serialization, chosen):
            topics.setdefault(text, {})[topic.target or ""] = None
    yield from (f"{', '.join(names)}: {text}" for text, names in topics.items())


def _refusal(data: Buffer, serialization: str, consumer: str = "") -> str:
    """Return a warning that names the consumers that would ignore scans like this one, or abort; empty if none would.

    The consumer that the scans are made for is checked by all its rules. The others are checked only by what a
    scan's header advertises; `pc2scan check` judges the ranges. Infinite ranges with an infinite range_max, as
    upstream's own defaults have them, are misplaced by most consumers, and gmapping aborts.

    Parameters
    ----------
    data
        A serialised LaserScan.
    serialization
        ``ros1`` or ``cdr``.
    consumer
        The consumer whose preset was chosen; empty if none was.
    """
    scan = scan_for_consumers(decode_laserscan(data, serialization))
    if consumer:
        verdict = judge(consumer, scan)
        return "" if verdict.outcome == "accepted" else f"{consumer} {_DOES[verdict.outcome]}: {_explanation(verdict)}"
    scan = replace(scan, infinite=0, short=0)
    verdicts = [verdict for name in CONSUMERS if (verdict := judge(name, scan)).refused]
    if not verdicts:
        return ""
    first = verdicts[0]
    others = f" (so would {', '.join(verdict.consumer for verdict in verdicts[1:])})" if verdicts[1:] else ""
    return f"{first.consumer} would ignore these scans{others}: {_explanation(first)}"


def _explanation(verdict: Verdict) -> str:
    """Return what a scan has, what the consumer allows, and how to change it."""
    return f"{verdict.observed} where it allows {verdict.allowed}. {verdict.cure[:1].upper()}{verdict.cure[1:]}"


def shared_beams(first_scans: Sequence[tuple[TopicReport, Buffer]], serialization: str) -> Iterator[str]:
    """Yield a note where upstream's beams end at the angles of a 2D lidar's: two are in one, and none in the next."""
    for topic, data in first_scans:
        spec = topic.spec
        if spec is None or not spec.combining.rebin or topic.joined is not None or spec.params.geometry != "upstream":
            continue
        scan = decode_laserscan(data, serialization)
        hit = np.isfinite(scan.ranges) & (scan.ranges <= scan.range_max)
        between = np.count_nonzero(hit[:-2] & ~hit[1:-1] & hit[2:])
        most = min(topic.points.used / topic.messages_out, hit.size)
        if between > _NOTABLE_GAPS * hit.size and np.count_nonzero(hit) < (1 - _NOTABLE_GAPS) * most:
            yield (
                f"{topic.target}: {between:,} of {hit.size:,} beams have no return between two that have one: those of "
                "the lidar are at their edges, by rounding on either side; `geometry=centered` has them in the middle"
            )


def lost_topics(report: Report) -> Iterator[str]:
    """Yield a warning of how many messages of which topics are missing, and why."""
    topics = report.lost_topics
    if not topics:
        return
    count = sum(topic.messages_in for topic in topics)
    listed = [f"{topic.topic} ({topic.messages_in:,}: {topic.note})" for topic in topics[:_MAX_WARNED]]
    more = len(topics) - len(listed)
    yield (
        f"{counted(count, 'message')} of {counted(len(topics), 'topic')} "
        f"{agreeing(count, 'are')} skipped: {', '.join(listed)}{f' and {more} more' if more else ''}"
    )


def unconverted_topic(topic: TopicReport, _: Report) -> Iterator[str]:
    """Yield a warning if no message of a topic was converted."""
    if topic.action == "converted" and not topic.messages_out:
        why = "could be converted" if topic.messages_in else "was there to convert (see `start` and `end`)"
        yield f"no message of {topic.topic} {why}"


def unordered_stamps(topic: TopicReport, _: Report) -> Iterator[str]:
    """Yield a warning if stamps go back or are 0."""
    yield from topic.stamps.faults(topic.topic)


def scans_without_return(topic: TopicReport, report: Report) -> Iterator[str]:
    """Yield a warning that names the cause of scans without returns."""
    if _is_made(topic) and topic.empty_scans:
        scans = f"{counted(topic.messages_out, 'scan')} on {topic.target}"
        empty = f"{topic.empty_scans:,} of {scans} {agreeing(topic.empty_scans, 'have')} no return at all"
        yield f"{empty}: {_blame(topic, topic.spec or report.scans[0], report.rejections)}"


def points_rejected_by_default(topic: TopicReport, report: Report) -> Iterator[str]:
    """Yield a warning for each default that rejects many points."""
    points, spec = topic.points, topic.spec or report.scans[0]
    if not _is_made(topic) or topic.empty_scans:
        return
    for rejection in report.rejections.values():
        share = points.rejected.get(rejection.name, 0) / points.total if points.total else 0.0
        no_returns = topic.no_returns if rejection.name == "height" else 0.0
        if 0 < no_returns < 1:
            share = (share - no_returns) / (1 - no_returns)
        least = notable_share(spec) if rejection.name == "height" else NOTABLE_SHARE
        if share >= least and _surprises(spec, rejection):
            advice = f": {topic.advice}" if topic.advice and rejection.name == "height" else ""
            of = "returns" if no_returns else "points"
            yield f"{topic.target}: {share:.0%} of the {of} were {rejection.by_default[1]}{advice}"


def filters_without_effect(topic: TopicReport, report: Report) -> Iterator[str]:
    """Yield a warning for each filter that should have rejected points, and rejected none."""
    points = topic.points
    if not _is_made(topic) or topic.empty_scans or not points.total:
        return
    for rejection in report.rejections.values():
        if rejection.absent and points.rejected.get(rejection.name) == 0:
            yield f"{topic.target}: {rejection.absent}"


def faults_without_number(topic: TopicReport, report: Report) -> Iterator[str]:
    """Yield warnings of filters that remove far more than the faults that they are for.

    Not of limits, conditions and regions, nor of the ground: they reject what users ask them to, and often most of it.
    """
    points, beams = topic.points, topic.removed_beams
    if not _is_made(topic):
        return
    faulty = [(each.name, each.explanation, each.remedy) for each in report.rejections.values() if each.remedy]
    removals = [(points.rejected.get(name, 0), points.total, "point", what, remedy) for name, what, remedy in faulty]
    removals += [
        (beams[name], beams["returns"], "beam", f"removed as {name}", remedy)
        for name, remedy in _REMEDIES.items()
        if name in beams
    ]
    for number, total, kind, what, remedy in removals:
        if number > _MOST_REMOVED * total:
            share = f"{number:,} of {counted(total, kind)} ({number / total:.0%})"
            yield f"{topic.target}: {share} {agreeing(number, 'were')} {what}; {remedy}"


def _surprises(spec: ScanSpec, rejection: Rejection) -> bool:
    """Whether a parameter that was not given rejects more points by its default than users expect."""
    name, _ = rejection.by_default
    if not name or spec.origins.get(name, "default") != "default":
        return False
    return bool(getattr(spec.params, name) == getattr(ProjectionParams(), name))


def _blame(topic: TopicReport, spec: ScanSpec, rejections: Mapping[str, Rejection]) -> str:
    """Return the reasons with their parameters: the most frequent one, or if nothing is left, all that may be it.

    A point is counted for the first reason that rejects it. Without this one, the others may reject it, too.
    """
    points = topic.points
    explained = Counter[str]()
    for name, rejection in rejections.items():
        explanation = rejection.by_default[1] if _surprises(spec, rejection) else rejection.explanation
        if name == "height" and topic.advice:
            explanation += f": {topic.advice}"
        explained[explanation] += points.rejected.get(name, 0)
    beams = dict(topic.removed_beams)
    returns = beams.pop("returns", 0)
    if 0 < returns <= sum(beams.values()):
        names = name_list([name for name, number in beams.items() if number])
        return f"all of the {counted(returns, 'beam')} with a return were removed as {names}"
    (first, most), *others = explained.most_common()
    if not most:
        return "all of their beams were removed" if points.used else "the clouds have no points"
    parts = [f"{most / points.total:.0%} of all points were {first}"]
    if not points.used:
        parts += [f"{n / points.total:.0%} {what}" for what, n in others if n >= _NOTABLE_PART * points.total]
    return "; ".join(parts)


def jumping_stamps(topic: TopicReport, _: Report) -> Iterator[str]:
    """Yield a warning about stamps that jump, which no scan may combine."""
    counts = topic.joined
    if counts is None or not counts.jumped:
        return
    stamp_ns, by_ns = counts.first_jump
    far = f"{abs(by_ns) / 1e9:,.3f}".rstrip("0").rstrip(".")
    more = f" and {counts.jumped - 1:,} more times" if counts.jumped > 1 else ""
    yield (
        f"the stamps of {topic.topic} jump {'back' if by_ns < 0 else 'ahead'} by {far} s at {stamp_text(stamp_ns)}"
        f"{more}, compared with their log times: no scan on {topic.target} has messages from before and after"
    )


def source_in_no_scan(topic: TopicReport, _: Report) -> Iterator[str]:
    """Yield a warning about a topic whose messages are in no scan, or not in some."""
    counts, scans = topic.joined, topic.target
    if topic.action != "joined" or counts is None:
        return
    if counts.messages and not counts.used:
        yield (
            f"no message of {topic.topic} is in a scan on {scans}: its stamps are never within the window of the "
            "leading topic's"
        )
    elif counts.longest_silence is not None:
        first, last, number = counts.longest_silence
        yield (
            f"{counted(counts.scans_without, 'scan')} on {scans} {agreeing(counts.scans_without, 'have')} "
            f"nothing of {topic.topic}; {number:,} in a row, "
            f"from {stamp_text(first)} to {stamp_text(last)}"
        )


def messages_in_no_scan(topic: TopicReport, _: Report) -> Iterator[str]:
    """Yield a warning about many messages in a row that are in no scan."""
    if topic.joined is not None and _are_left_long(topic, topic.joined):
        leads = "Scans are made for messages of the leading topic, the first one of `topics`"
        yield f"{_unmatched(topic, topic.joined)}. {leads}"


def _are_left_long(topic: TopicReport, counts: SourceCounts) -> bool:
    """Whether messages in a row are in no scan for so long that the leading topic is silent, or far from them."""
    every_ns = topic.spec.combining.every_ns if topic.spec else 0
    run = counts.longest_unmatched
    if topic.action != "joined" or run is None:
        return False
    return run.last_stamp_ns - run.first_stamp_ns > _NOTABLE_SILENCE_NS + every_ns


def _unmatched(topic: TopicReport, counts: SourceCounts) -> str:
    """Return how many messages are in no scan, and where most of them are."""
    run = counts.longest_unmatched
    assert run is not None
    return (
        f"{counts.unmatched:,} of {counted(counts.messages, 'message')} of {topic.topic} "
        f"{agreeing(counts.unmatched, 'are')} in no scan on {topic.target}; {run.number:,} in a row, "
        f"from {stamp_text(run.first_stamp_ns)} to {stamp_text(run.last_stamp_ns)}"
    )


def missing_transforms(topic: TopicReport, _: Report) -> Iterator[str]:
    """Yield a warning about gaps in the transforms while clouds were measured."""
    motion = topic.motion
    if motion and motion["longest_gap_s"] > _NOTABLE_GAP:
        yield (
            f"{topic.target}: while clouds were measured, transforms to `fixed_frame` were missing for up "
            f"to {motion['longest_gap_s']:.3g} s; points are placed as if the robot had moved evenly meanwhile"
        )


def implausible_tilt(topic: TopicReport, report: Report) -> Iterator[str]:
    """Yield a warning if the target frame is tilted more than a robot is, or never."""
    tilt, (by, frame) = topic.tilt, _levelled(topic, report)
    if not tilt:
        return
    if (median := tilt["median_deg"]) > _NOTABLE_TILT:
        yield (
            f"{topic.target}: by {by}, {frame} is tilted by {median:.0f} degrees (median). If it is not mounted "
            "so, the mount of the IMU is wrong (`static_tf`), or z of `fixed_frame` is not up"
        )
    elif tilt["largest_deg"] < _NO_TILT and len(topic.tilts) >= _SEVERAL:
        yield (
            f"{topic.target}: by {by}, {frame} is never tilted, so `level` has no effect. Wheel odometry has no "
            "roll and pitch, an IMU has: `imu=TOPIC`"
        )


def evenly_divided_circle(spec: ScanSpec) -> Iterator[str]:
    """Yield a note if the increment is another one than was given."""
    params = spec.params
    layout, increment = params.layout, params.angle_increment
    # If beams are measured, another note has their number.
    if (
        params.beams != "auto"
        and layout.full_circle
        and abs(layout.angle_increment - increment) > _NOTABLE_STEP * increment
    ):
        yield (
            f"angle_increment is {layout.angle_increment:.7g} rad instead of {increment:.7g}: "
            f"{layout.count} beams divide the circle evenly"
        )


def range_of_preset(spec: ScanSpec) -> Iterator[str]:
    """Yield a note if a preset limits the range."""
    origin = spec.origins.get("range_max", "")
    if preset_of(origin):
        yield (
            f"range_max is {spec.params.range_max:g} m, chosen by {origin}: returns beyond are ignored; "
            "`range_max` chooses another"
        )


def unmatched_messages(topic: TopicReport, _: Report) -> Iterator[str]:
    """Yield a note about messages that are in no scan, if there is no warning about them."""
    if (counts := topic.joined) is not None and counts.unmatched and not _are_left_long(topic, counts):
        yield _unmatched(topic, counts)


def removed_beams(topic: TopicReport, _: Report) -> Iterator[str]:
    """Yield a note for each reason for which beams are removed."""
    if not topic.removed_beams:
        return
    returns = topic.removed_beams["returns"]
    for name, number in topic.removed_beams.items():
        if name != "returns":
            of = f"{topic.target}: {number:,} of {counted(returns, 'beam')}"
            yield f"{of} {agreeing(number, 'were')} {name}, and {agreeing(number, 'are')} removed"


def motion_of_sensor(topic: TopicReport, _: Report) -> Iterator[str]:
    """Yield a note about how far the sensor moved while clouds were measured."""
    motion = topic.motion
    if not motion:
        return
    placed = "deskewed" if topic.spec is not None and topic.spec.deskew else "placed through `fixed_frame`"
    within = f"{placed}; within a {'cloud' if topic.joined is None else 'scan'}"
    yield (
        f"{topic.target}: {within} the sensor moved by up to {motion['largest_m']:.3g} m "
        f"and {motion['largest_deg']:.3g} degrees (median {motion['median_m']:.3g} m, "
        f"{motion['median_deg']:.3g} degrees)"
    )


def tilt_of_frame(topic: TopicReport, report: Report) -> Iterator[str]:
    """Yield a note about the tilt of the target frame, if it is plausible."""
    tilt, (by, frame) = topic.tilt, _levelled(topic, report)
    if tilt and not any(implausible_tilt(topic, report)):
        yield (
            f"{topic.target}: level by {by}; {frame} was tilted by up to {tilt['largest_deg']:.3g} degrees "
            f"(median {tilt['median_deg']:.3g})"
        )


def _is_made(topic: TopicReport) -> bool:
    """Whether messages were converted."""
    return topic.action == "converted" and topic.messages_out > 0


def _levelled(topic: TopicReport, report: Report) -> tuple[str, str]:
    """Return by what the scans of a topic are level, and in which frame they would be otherwise."""
    spec = topic.spec
    frame = (spec.params.target_frame if spec else "") or report.source_frame or "the clouds' frame"
    return (spec.imu or spec.fixed_frame) if spec else "", frame


#: What the counts of a topic show: warnings and notes, in this order.
WARNINGS: Sequence[Callable[[TopicReport, Report], Iterator[str]]] = (
    unconverted_topic,
    unordered_stamps,
    scans_without_return,
    points_rejected_by_default,
    filters_without_effect,
    faults_without_number,
    jumping_stamps,
    source_in_no_scan,
    messages_in_no_scan,
    missing_transforms,
    implausible_tilt,
)
NOTES: Sequence[Callable[[TopicReport, Report], Iterator[str]]] = (
    unmatched_messages,
    removed_beams,
    motion_of_sensor,
    tilt_of_frame,
)


def result_findings(
    report: Report, first_scans: Sequence[tuple[TopicReport, Buffer]] = (), serialization: str = ""
) -> tuple[list[str], list[str]]:
    """Return the warnings and the notes about a result.

    Parameters
    ----------
    report
        The counts of its topics.
    first_scans
        The first scan of each topic that was written, serialised. Empty for a dry run.
    serialization
        That of the scans: ``ros1`` or ``cdr``.
    """
    warnings = [*refused_scans(first_scans, serialization), *lost_topics(report)]
    notes = dict.fromkeys(
        text for spec in report.scans for text in (*evenly_divided_circle(spec), *range_of_preset(spec))
    )
    notes.update(dict.fromkeys(shared_beams(first_scans, serialization)))
    for topic in report.topics:
        warnings += (text for check in WARNINGS for text in check(topic, report))
        notes.update(dict.fromkeys(text for note in NOTES for text in note(topic, report)))
    return warnings, [*notes]


def compare_counts(
    reader: Reader, routes: Collection[Route], options: ConvertOptions, report: Report
) -> tuple[int | None, list[Damage]]:
    """Compare how many messages were read with how many the sources declare, for each connection.

    Parameters
    ----------
    reader, routes
        The source, and its connections; all their messages have been read.
    report
        How many messages were read, and the damage that explains a difference.

    Returns
    -------
    How many messages the sources declare (None: they do not, or only a part was read), and the damage of a difference
    that nothing else explains; empty without one.

    Raises
    ------
    DamageError
        With ``strict``, instead of returning damage.
    """
    if options.start is not None or options.end is not None:
        return None, []
    written = [route for route in routes if route.writes]
    declared_counts = ((route.connection, route.connection.message_count, route.messages) for route in written)
    counts = [(connection.topic, known, read) for connection, known, read in declared_counts if known is not None]
    # MCAP's writers may omit the counts by channel, and store the sum.
    declared = reader.summary.message_count if len(written) == len(reader.connections) else None
    if declared is None and len(counts) == len(written):
        declared = sum(count for _, count, _ in counts)
    if declared is None:
        return None, []
    messages_read = report.messages_read
    lost = max(declared - messages_read, sum(max(0, count - read) for _, count, read in counts))
    details = count_details(counts)
    if (declared == messages_read and not details) or any(damage.loses for damage in report.damage):
        return declared, []
    missing = (
        f"declares {counted(declared, 'message')}, {messages_read:,} {agreeing(messages_read, 'were')} found{details}"
    )
    if options.strict:
        raise DamageError(missing, path=reader.path, hint=RECOVER)
    return declared, [Damage(missing, reader.path, messages_lost=max(0, lost))]


def refuse_nothing(report: Report) -> None:
    """Raise if no message was converted.

    Raises
    ------
    ResultError
        The error names the most frequent reason.
    """
    converted = report.converted
    if any(topic.messages_out for topic in converted):
        return
    read = sum(topic.messages_in for topic in converted)
    if not read and report.damage:
        place = report.damage[0]
        error = f"no message was converted: there was none to convert in a damaged recording: {place.what}"
        raise ResultError(error, path=place.path)
    joined = [topic for topic in report.topics if topic.action == "joined" and topic.messages_in]
    if not read and joined:
        raise ResultError(
            f"no message was converted: the leading topic has none, so those of "
            f"{name_list([topic.topic for topic in joined])} are in no scan",
            hint="name another topic first in `topics`; or check `start` and `end`",
        )
    if not read:
        raise ResultError(
            "no message was converted: there was none to convert", hint="check `topics`, `start` and `end`"
        )
    if not report.skipped:
        raise ResultError("no message was converted")
    reasons = Counter("" if entry.gap_ns else entry.reason for entry in report.skipped)
    ((common, count),) = reasons.most_common(1)
    # Of stamps without transforms the farthest: what helps it helps the others, too.
    shown = max(report.skipped, key=lambda entry: entry.gap_ns if not common else entry.reason == common)
    which = "" if count == len(report.skipped) else f", {count:,} of {read:,}"
    raise ResultError(f"no message was converted: all were skipped{which}: {shown.reason}", hint=shown.hint or None)


def refuse_unsatisfied(report: Report, options: ConvertOptions) -> None:
    """Raise if the result does not satisfy `fail_on` or `min_used`.

    Raises
    ------
    ResultError
        The error has the numbers and the option.
    """
    for topic in report.converted:
        if options.fail_on and topic.empty_scans:
            raise ResultError(
                f"{topic.empty_scans:,} of {counted(topic.messages_out, 'scan')} on {topic.target} "
                f"{agreeing(topic.empty_scans, 'have')} no return "
                f"(`fail_on={options.fail_on}`)"
            )
        share = topic.points.used / topic.points.total if topic.points.total else 0.0
        if share < options.min_used:
            raise ResultError(
                f"{share:.3%} of the points of {topic.topic} are in the scans on {topic.target}, less than "
                f"{options.min_used:.3%} (`min_used`)"
            )
    if options.fail_on != "warning":
        return
    if report.damage:
        raise ResultError("a source is damaged (`fail_on=warning`)", path=report.damage[0].path)
    if report.skipped_count:
        raise ResultError(f"{counted(report.skipped_count, 'message', 'were')} skipped (`fail_on=warning`)")
    if report.warnings:
        raise ResultError(f"{report.warnings[0]} (`fail_on=warning`)")

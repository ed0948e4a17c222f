"""Checks the result of a conversion: its first scans, and the counts of its topics. Yields warnings and notes."""

from __future__ import annotations

import math
from collections import Counter
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.advice.checks.first_clouds import notable_share
from pc2scan.bags.damage import RECOVER, Damage, count_details
from pc2scan.core.consumers import judge
from pc2scan.core.percentiles import median_low
from pc2scan.errors import DamageError, ResultError, name_list, stamp_text
from pc2scan.messages.laserscan import decode_laserscan, scan_for_consumers
from pc2scan.request.precedence import preset_of
from pc2scan.result import Remark
from pc2scan.text import agreeing, counted

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.core.consumers import Outcome
    from pc2scan.core.rule import Rejection
    from pc2scan.messages.laserscan import LaserScan
    from pc2scan.model import Buffer
    from pc2scan.request.spec import Request, ScanSpec

    from .plan import Route
    from .report import Report, TopicReport

warning, note = partial(Remark, "warning"), partial(Remark, "note")

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


def _shared_beams(topic: TopicReport, spec: ScanSpec, scan: LaserScan) -> Iterator[str]:
    """Yield a note where upstream's beams end at the angles of a 2D lidar's: two are in one, and none in the next."""
    if topic.joined is not None or spec.params.geometry != "upstream":
        return
    hit = np.isfinite(scan.ranges) & (scan.ranges <= scan.range_max)
    between = np.count_nonzero(hit[:-2] & ~hit[1:-1] & hit[2:])
    most = min(topic.points.used / topic.messages_out, hit.size)
    if between > _NOTABLE_GAPS * hit.size and np.count_nonzero(hit) < (1 - _NOTABLE_GAPS) * most:
        yield (
            f"{topic.target}: {between:,} of {hit.size:,} beams have no return between two that have one: those of "
            "the lidar are at their edges, by rounding on either side; `geometry=centered` has them in the middle"
        )


def _of_first_scans(
    first_scans: Sequence[tuple[TopicReport, ScanSpec, Buffer]], serialization: str
) -> Iterator[Remark]:
    """Yield a warning for each reason why the consumer that scans are made for would not use them as they are meant.

    Without a preset, this is slam_toolbox, and only whether it ignores them: `pc2scan check` judges for all consumers.
    """
    topics: dict[str, list[str]] = {}
    for topic, spec, data in first_scans:
        scan = decode_laserscan(data, serialization)
        chosen = next(filter(None, map(preset_of, spec.origins.values())), "")
        verdict = judge(chosen or "slam_toolbox", scan_for_consumers(scan))
        if verdict.outcome != "accepted" and (chosen or verdict.refused):
            does = f"{_DOES[verdict.outcome]}: {verdict.observed} where it allows {verdict.allowed}"
            text = f"{verdict.consumer} {does}. {verdict.cure[:1].upper()}{verdict.cure[1:]}"
            topics.setdefault(text, []).append(topic.target or "")
        if spec.combining.rebin:
            yield from map(note, _shared_beams(topic, spec, scan))
    yield from (warning(f"{', '.join(dict.fromkeys(names))}: {text}") for text, names in topics.items())


def _lost_messages(topics: Sequence[TopicReport]) -> Remark:
    """Return the warning of how many messages of which topics are missing, and why."""
    count = sum(topic.messages_in for topic in topics)
    listed = [f"{topic.topic} ({topic.messages_in:,}: {topic.note})" for topic in topics[:_MAX_WARNED]]
    listed += [f"and {len(topics) - _MAX_WARNED} more"] if len(topics) > _MAX_WARNED else []
    which = f"{counted(count, 'message')} of {counted(len(topics), 'topic')}"
    return warning(f"{which} {agreeing(count, 'are')} skipped: {', '.join(listed)}")


def _of_request(spec: ScanSpec) -> Iterator[Remark]:
    """Yield notes if the increment is another one than was given, and if a preset limits the range."""
    params, origin = spec.params, spec.origins.get("range_max", "")
    layout, increment = params.layout, params.angle_increment
    is_changed = abs(layout.angle_increment - increment) > _NOTABLE_STEP * increment
    # If beams are measured, another note has their number.
    if params.beams != "auto" and layout.full_circle and is_changed:
        yield note(
            f"angle_increment is {layout.angle_increment:.7g} rad instead of {increment:.7g}: "
            f"{layout.count} beams divide the circle evenly"
        )
    if preset_of(origin):
        yield note(
            f"range_max is {params.range_max:g} m, chosen by {origin}: returns beyond are ignored; `range_max` chooses "
            "another"
        )


def unconverted_topic(topic: TopicReport, *_: object) -> Iterator[Remark]:
    """Yield a warning if no message of a topic was converted."""
    if topic.action == "converted" and not topic.messages_out:
        text = f"there is no message of {topic.topic} to convert; see `start`, `end`"
        yield warning(f"no message of {topic.topic} could be converted" if topic.messages_in else text)


def unordered_stamps(topic: TopicReport, *_: object) -> Iterator[Remark]:
    """Yield a warning if stamps go back or are 0."""
    yield from map(warning, topic.stamps.texts(topic.topic))


def scans_without_return(topic: TopicReport, spec: ScanSpec, report: Report) -> Iterator[Remark]:
    """Yield a warning that names the cause of scans without returns; a note if these are of nothing but floor."""
    removed = sum(topic.points.rejected.get(name, 0) for name in ("height", "ground", "min_height_slope"))
    is_floor = topic.is_level and 2 * removed > topic.points.total
    why = "nothing but level floor is within the heights" if is_floor else _blame(topic, spec, report.rejections)
    yield (note if is_floor else warning)(f"{_empty(topic)} at all: {why}")


def _empty(topic: TopicReport) -> str:
    """Return how many scans have no return."""
    scans = f"{counted(topic.messages_out, 'scan')} on {topic.target}"
    return f"{topic.empty_scans:,} of {scans} {agreeing(topic.empty_scans, 'have')} no return"


def rejected_points(topic: TopicReport, spec: ScanSpec, report: Report) -> Iterator[Remark]:
    """Yield a warning for each default that rejects many points, each fault that does, and each filter without effect.

    Not of limits, conditions and regions, nor of the ground: they reject what users ask them to, and often most of it.
    """
    points = topic.points
    for name, rejection in report.rejections.items() if topic.action == "converted" else ():
        count = points.rejected.get(name)
        if rejection.remedy:
            yield from _removed(
                topic, "point", count or 0, points.total, f"{rejection.explanation}; {rejection.remedy}"
            )
        elif topic.empty_scans or not points.total:
            continue
        elif rejection.absent and count == 0:
            yield warning(f"{topic.target}: {rejection.absent}")
        elif (default := rejection.by_default[0]) and spec.is_default(default):
            share = ((count or 0) / points.total - topic.no_returns) / (1 - topic.no_returns or 1.0)
            if share >= notable_share(spec):
                of = "returns" if topic.no_returns else "points"
                advice = f": {topic.advice}" if topic.advice else ""
                yield warning(f"{topic.target}: {share:.0%} of the {of} were {rejection.by_default[1]}{advice}")


def removed_beams(topic: TopicReport, *_: object) -> Iterator[Remark]:
    """Yield a note for each reason for which beams are removed, and a warning if it removes many."""
    returns = topic.removed_beams["returns"]
    for name, number in topic.removed_beams.items():
        if name != "returns":
            of = f"{topic.target}: {number:,} of {counted(returns, 'beam')}"
            yield note(f"{of} {agreeing(number, 'were')} {name}, and {agreeing(number, 'are')} removed")
            yield from _removed(topic, "beam", number, returns, f"removed as {name}; {_REMEDIES[name]}")


def _removed(topic: TopicReport, kind: str, number: int, total: int, why: str) -> Iterator[Remark]:
    """Yield a warning if more is removed than faults may be."""
    if number > _MOST_REMOVED * total:
        share = f"{number:,} of {counted(total, kind)} ({number / total:.0%})"
        yield warning(f"{topic.target}: {share} {agreeing(number, 'were')} {why}")


def _blame(topic: TopicReport, spec: ScanSpec, rejections: Mapping[str, Rejection]) -> str:
    """Return the reasons with their parameters: the most frequent one, or if nothing is left, all that may be it.

    A point is counted for the first reason that rejects it. Without this one, the others may reject it, too.
    """
    points = topic.points
    explained = Counter[str]()
    for name, rejection in rejections.items():
        default, by_default = rejection.by_default
        explanation = by_default if default and spec.is_default(default) else rejection.explanation
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


def jumping_stamps(topic: TopicReport, *_: object) -> Iterator[Remark]:
    """Yield a warning about stamps that jump, which no scan may combine."""
    if topic.joined is not None and topic.joined.jumped:
        (stamp_ns, by_ns), jumped = topic.joined.first_jump, topic.joined.jumped
        far = f"{abs(by_ns) / 1e9:,.3f}".rstrip("0").rstrip(".")
        more = f" and {jumped - 1:,} more times" if jumped > 1 else ""
        yield warning(
            f"the stamps of {topic.topic} jump {'back' if by_ns < 0 else 'ahead'} by {far} s at {stamp_text(stamp_ns)}"
            f"{more}, compared with their log times: no scan on {topic.target} has messages from before and after"
        )


def source_in_no_scan(topic: TopicReport, *_: object) -> Iterator[Remark]:
    """Yield a warning about a topic whose messages are in no scan, or not in some between the first and the last."""
    counts, scans = topic.joined, topic.target
    if topic.action != "joined" or counts is None:
        return
    if counts.messages and not counts.used:
        why = "its stamps are never within the window of the leading topic's"
        yield warning(f"no message of {topic.topic} is in a scan on {scans}: {why}")
    elif counts.scans_without > sum(counts.edges):
        have = agreeing(counts.scans_without, "have")
        yield warning(f"{counted(counts.scans_without, 'scan')} on {scans} {have} nothing of {topic.topic}")


def messages_in_no_scan(topic: TopicReport, spec: ScanSpec, _: Report) -> Iterator[Remark]:
    """Yield a note about messages that are in no scan; a warning if many in a row are: the leading topic is silent."""
    counts = topic.joined
    if counts is None or counts.longest_unmatched is None:
        return
    first, last, number = counts.longest_unmatched
    text = (
        f"{counts.unmatched:,} of {counted(counts.messages, 'message')} of {topic.topic} "
        f"{agreeing(counts.unmatched, 'are')} in no scan on {topic.target}; {number:,} in a row, "
        f"from {stamp_text(first)} to {stamp_text(last)}"
    )
    if topic.action == "joined" and last - first > _NOTABLE_SILENCE_NS + spec.combining.every_ns:
        yield warning(f"{text}. Scans are made for messages of the leading topic, the first one of `topics`")
    else:
        yield note(text)


def missing_transforms(topic: TopicReport, *_: object) -> Iterator[Remark]:
    """Yield a warning if there were no transforms for long while clouds were measured."""
    if topic.longest_gap_s > _NOTABLE_GAP:
        yield warning(
            f"{topic.target}: while clouds were measured, transforms to `fixed_frame` were missing for up "
            f"to {topic.longest_gap_s:.3g} s; points are placed as if the robot had moved evenly meanwhile"
        )


def tilt_of_frame(topic: TopicReport, spec: ScanSpec, _: Report) -> Iterator[Remark]:
    """Yield a note about the tilt of the target frame; a warning if a robot is never tilted so, or always."""
    if not topic.tilts:
        return
    median, largest = math.degrees(median_low(topic.tilts)), math.degrees(max(topic.tilts))
    by = spec.imu.topic if spec.imu else spec.fixed_frame
    frame = spec.params.target_frame or "the clouds' frame"
    if median > _NOTABLE_TILT:
        yield warning(
            f"{topic.target}: by {by}, {frame} is tilted by {median:.0f} degrees (median). If it is not mounted "
            "so, the mount of the IMU is wrong (`static_tf`), or z of `fixed_frame` is not up"
        )
    elif largest < _NO_TILT and len(topic.tilts) >= _SEVERAL:
        yield warning(
            f"{topic.target}: by {by}, {frame} is never tilted, so `level` has no effect. Wheel odometry has no "
            "roll and pitch, an IMU has: `imu=TOPIC`"
        )
    else:
        yield note(
            f"{topic.target}: level by {by}; {frame} was tilted by up to {largest:.3g} degrees (median {median:.3g})"
        )


#: Checks of a topic, by the attribute that a topic must have for them; each yields warnings and notes.
TOPIC_CHECKS: Mapping[str, Sequence[Callable[[TopicReport, ScanSpec, Report], Iterator[Remark]]]] = {
    "action": (unconverted_topic,),
    "stamps.faults": (unordered_stamps,),
    "empty_scans": (scans_without_return,),
    "messages_out": (rejected_points,),
    "removed_beams": (removed_beams,),
    "joined": (jumping_stamps, source_in_no_scan, messages_in_no_scan),
    "longest_gap_s": (missing_transforms,),
    "tilts": (tilt_of_frame,),
}


def result_findings(
    report: Report, first_scans: Sequence[tuple[TopicReport, ScanSpec, Buffer]] = (), serialization: str = ""
) -> tuple[list[str], list[str]]:
    """Return the warnings and the notes about a result.

    Parameters
    ----------
    report
        The counts of its topics.
    first_scans
        The first scan of each topic that was written, serialised, and its request. Empty for a dry run.
    serialization
        The serialisation of the scans: ``ros1`` or ``cdr``.
    """
    remarks = [*_of_first_scans(first_scans, serialization)]
    if lost := [topic for topic in report.topics if topic.lost and topic.messages_in]:
        remarks.append(_lost_messages(lost))
    remarks += (remark for spec in report.scans for remark in _of_request(spec))
    for topic in report.topics:
        if (spec := topic.spec) is not None:
            groups = (checks for name, checks in TOPIC_CHECKS.items() if attrgetter(name)(topic))
            remarks += (remark for checks in groups for check in checks for remark in check(topic, spec, report))
    warnings = [remark.text for remark in remarks if remark.label == "warning"]
    return warnings, list(dict.fromkeys(remark.text for remark in remarks if remark.label == "note"))


def compare_counts(reader: Reader, request: Request, routes: Collection[Route], report: Report) -> None:
    """Compare how many messages were read with how many the sources declare, for each connection of a whole recording.

    The report then has how many they declare, and the damage of a difference that nothing else explains.

    Raises
    ------
    DamageError
        With ``strict``, if there is such a difference.
    """
    read = report.messages_read
    written = [route for route in routes if route.writes]
    known = [(route.connection.topic, route.connection.message_count, route.messages) for route in written]
    counts = [(topic, declared, own) for topic, declared, own in known if declared is not None]
    # MCAP's writers may omit the counts by channel, and store the sum.
    declared = reader.summary.message_count if len(written) == len(reader.connections) else None
    if declared is None and len(counts) == len(written):
        declared = sum(count for _, count, _ in counts)
    if declared is None or request.start is not None or request.end is not None:
        return
    report.messages_declared = declared
    is_equal = declared == read and all(count == own for _, count, own in counts)
    if is_equal or any(damage.loses for damage in report.damage):
        return
    details = count_details(counts)
    missing = f"declares {counted(declared, 'message')}, {read:,} {agreeing(read, 'were')} found{details}"
    if request.strict:
        raise DamageError(missing, path=reader.path, hint=RECOVER)
    lost = max(0, declared - read, sum(max(0, count - own) for _, count, own in counts))
    report.damage.append(Damage(missing, reader.path, messages_lost=lost))


def refuse_nothing(report: Report) -> None:
    """Raise because no message was converted.

    Raises
    ------
    ResultError
        The error names the most frequent reason.
    """
    read = sum(topic.messages_in for topic in report.converted)
    joined = [topic.topic for topic in report.topics if topic.action == "joined" and topic.messages_in]
    why, path, hint = "there was none to convert", None, "check `topics`, `start` and `end`"
    if read:
        reasons = Counter("" if entry.gap_ns else entry.reason for entry in report.skipped)
        ((common, count),) = reasons.most_common(1)
        # The stamp that is farthest from any transform: its hint helps the others, too.
        shown = max(report.skipped, key=lambda entry: entry.gap_ns if not common else entry.reason == common)
        which = "" if count == len(report.skipped) else f", {count:,} of {read:,}"
        why, hint = f"all were skipped{which}: {shown.reason}", shown.hint
    elif report.damage:
        why, hint = f"{why} in a damaged recording: {report.damage[0].what}", ""
        path = report.damage[0].path
    elif joined:
        why = f"the leading topic has none, so those of {name_list(joined)} are in no scan"
        hint = "name another topic first in `topics`; or check `start` and `end`"
    raise ResultError(f"no message was converted: {why}", path=path, hint=hint or None)


def refuse_unsatisfied(report: Report, request: Request) -> None:
    """Raise if the result does not satisfy `fail_on` or `min_used`.

    Raises
    ------
    ResultError
        The error has the numbers and the option.
    """
    for topic in report.converted:
        if request.fail_on and topic.empty_scans:
            raise ResultError(f"{_empty(topic)} (`fail_on={request.fail_on}`)")
        share = topic.points.used / topic.points.total if topic.points.total else 0.0
        if share < request.min_used:
            of = f"{share:.3%} of the points of {topic.topic} are in the scans on {topic.target}"
            raise ResultError(f"{of}, less than {request.min_used:.3%} (`min_used`)")
    if request.fail_on != "warning":
        return
    if report.damage:
        raise ResultError("a source is damaged (`fail_on=warning`)", path=report.damage[0].path)
    if report.skipped_count:
        raise ResultError(f"{counted(report.skipped_count, 'message', 'were')} skipped (`fail_on=warning`)")
    if report.warnings:
        raise ResultError(f"{report.warnings[0]} (`fail_on=warning`)")

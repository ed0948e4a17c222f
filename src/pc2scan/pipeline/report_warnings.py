"""Warnings and notes about a conversion, from the counts of its topics."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import stamp_text
from pc2scan.text import agreeing, counted

from .parameters import from_preset

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pc2scan.core.rule import Rejection

    from .combine.counts import SourceCounts
    from .scan_spec import ScanSpec
    from .topic_report import TopicReport

#: How many topics the warning about skipped ones lists.
_MAX_WARNED = 5

#: If a default rejects this share of the points, a warning names it.
_NOTABLE_SHARE = 0.25

#: If a filter that should remove faults alone removes more than this share, a warning names it.
_MOST_REMOVED = 0.1

#: What to type if `min_points` or `kth` removes too many beams.
_OF_SPARSE = "they have fewer returns than `min_points` or `kth`: lower these, or use more heights or wider beams"

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


def topic_warnings(
    topic: TopicReport, scan: ScanSpec, rejections: Mapping[str, Rejection], source_frame: str
) -> Iterator[str]:
    """Yield warnings about a topic whose messages are all counted.

    Parameters
    ----------
    topic
        What happened to the topic.
    scan
        The request of the first output, for topics without a request of their own.
    rejections
        Why points may be rejected, by the name of the count.
    source_frame
        The frame that replaces the clouds' ``frame_id``; empty if none does.
    """
    if topic.action == "converted" and not topic.messages_out:
        why = "could be converted" if topic.messages_in else "was there to convert (see `start` and `end`)"
        yield f"no message of {topic.topic} {why}"
    elif topic.action == "converted":
        yield from _point_warnings(topic, topic.spec or scan, rejections)
        yield from _removal_warnings(topic, topic.spec or scan, rejections)
    yield from _jump_warnings(topic)
    yield from _joined_warnings(topic)
    if (motion := topic.motion) and motion["longest_gap_s"] > _NOTABLE_GAP:
        yield (
            f"{topic.target}: while clouds were measured, transforms to `fixed_frame` were missing for up "
            f"to {motion['longest_gap_s']:.3g} s; points are placed as if the robot had moved evenly meanwhile"
        )
    if (tilt := topic.tilt) and (warning := _tilt_warning(topic, tilt, source_frame)):
        yield warning


def topic_notes(topic: TopicReport, source_frame: str) -> Iterator[str]:
    """Yield notes about a topic whose messages are all counted; see `topic_warnings`."""
    yield from _joined_notes(topic)
    if motion := topic.motion:
        placed = "deskewed" if topic.spec is not None and topic.spec.deskew else "placed through `fixed_frame`"
        within = f"{placed}; within a {'cloud' if topic.joined is None else 'scan'}"
        yield (
            f"{topic.target}: {within} the sensor moved by up to {motion['largest_m']:.3g} m "
            f"and {motion['largest_deg']:.3g} degrees (median {motion['median_m']:.3g} m, "
            f"{motion['median_deg']:.3g} degrees)"
        )
    if (tilt := topic.tilt) and not _tilt_warning(topic, tilt, source_frame):
        by, frame = _levelled(topic, source_frame)
        yield (
            f"{topic.target}: level by {by}; {frame} was tilted by up to {tilt['largest_deg']:.3g} degrees "
            f"(median {tilt['median_deg']:.3g})"
        )


def _point_warnings(topic: TopicReport, spec: ScanSpec, rejections: Mapping[str, Rejection]) -> Iterator[str]:
    """Yield warnings that name the cause of scans without returns, and of points that a default rejects."""
    points = topic.points
    if topic.empty_scans:
        scans = f"{counted(topic.messages_out, 'scan')} on {topic.target}"
        empty = f"{topic.empty_scans:,} of {scans} {agreeing(topic.empty_scans, 'have')} no return at all"
        yield f"{empty}: {_blame(topic, spec, rejections)}"
        return
    for each in rejections.values():
        share = points.rejected.get(each.name, 0) / points.total if points.total else 0.0
        if each.absent and points.total and points.rejected.get(each.name) == 0:
            yield f"{topic.target}: {each.absent}"
        if share >= _NOTABLE_SHARE and _surprises(spec, each):
            advice = f": {topic.advice}" if topic.advice and each.name == "height" else ""
            yield f"{topic.target}: {share:.0%} of the points were {each.by_default[1]}{advice}"


def _removal_warnings(topic: TopicReport, spec: ScanSpec, rejections: Mapping[str, Rejection]) -> Iterator[str]:
    """Yield warnings of filters that remove far more than the faults that they are for.

    Not of limits, conditions and regions, nor of the ground: they reject what users ask them to, and often most of it.
    """
    points, beams = topic.points, topic.removed_beams
    faulty = [(each.name, each.explanation, each.remedy) for each in rejections.values() if each.remedy]
    removals = [(points.rejected.get(name, 0), points.total, "point", what, remedy) for name, what, remedy in faulty]
    remedies = {"sparse": _OF_SPARSE} | {each.name: each.remedy for each in spec.remove}
    removals += [
        (beams[name], beams["returns"], "beam", f"removed as {name}", remedy)
        for name, remedy in remedies.items()
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
    """Return the most frequent reason, and its parameters."""
    points = topic.points
    explained = Counter[str]()
    for name, rejection in rejections.items():
        explanation = rejection.by_default[1] if _surprises(spec, rejection) else rejection.explanation
        if name == "height" and topic.advice:
            explanation += f": {topic.advice}"
        explained[explanation] += points.rejected.get(name, 0)
    explanation, count = explained.most_common(1)[0]
    if count:
        return f"{count / points.total:.0%} of all points were {explanation}"
    return "all of their beams were removed" if points.used else "the clouds have no points"


def _jump_warnings(topic: TopicReport) -> Iterator[str]:
    """Yield a warning about stamps that jump, which no scan may combine."""
    counts = topic.joined
    if counts is None or not counts.jumped:
        return
    listed = [
        f"{'back' if jump.by_ns < 0 else 'ahead'} by {f'{abs(jump.by_ns) / 1e9:,.3f}'.rstrip('0').rstrip('.')} s "
        f"at {stamp_text(jump.stamp_ns)}"
        for jump in counts.jumps
    ]
    more = counts.jumped - len(listed)
    yield (
        f"the stamps of {topic.topic} jump {', '.join(listed)}{f' and {more:,} more times' if more else ''}, compared "
        f"with their log times: no scan on {topic.target} has messages from before and after"
    )


def _joined_warnings(topic: TopicReport) -> Iterator[str]:
    """Yield warnings about messages that become scans together with others."""
    counts, scans = topic.joined, topic.target
    if counts is None or topic.action != "joined":
        return
    if counts.messages and not counts.used:
        yield (
            f"no message of {topic.topic} is in a scan on {scans}: its stamps are never within the window of the "
            "leading topic's"
        )
    elif counts.scans_without:
        first, last, number = counts.silence
        yield (
            f"{counted(counts.scans_without, 'scan')} on {scans} {agreeing(counts.scans_without, 'have')} "
            f"nothing of {topic.topic}; {number:,} in a row, "
            f"from {stamp_text(first)} to {stamp_text(last)}"
        )
    if _are_left_long(topic, counts):
        yield (
            f"{_unmatched(topic, counts)}. Scans are made for messages of the leading topic; `lead` chooses another one"
        )


def _are_left_long(topic: TopicReport, counts: SourceCounts) -> bool:
    """Whether messages in a row are in no scan for so long that the leading topic is silent, or far from them."""
    every_ns = topic.spec.combining.every_ns if topic.spec else 0
    return counts.left.last_stamp_ns - counts.left.first_stamp_ns > _NOTABLE_SILENCE_NS + every_ns


def _unmatched(topic: TopicReport, counts: SourceCounts) -> str:
    """Return how many messages are in no scan, and where most of them are."""
    first, last, number = counts.left
    where = f"{number:,} in a row, from {stamp_text(first)} to {stamp_text(last)}"
    return (
        f"{counts.unmatched:,} of {counted(counts.messages, 'message')} of {topic.topic} "
        f"{agreeing(counts.unmatched, 'are')} in no scan on {topic.target}; {where}"
    )


def _joined_notes(topic: TopicReport) -> Iterator[str]:
    """Yield notes about messages that are in no scan, beams that were removed, and beams that became other beams."""
    counts, scans = topic.joined, topic.target
    if counts is not None and counts.unmatched and not (topic.action == "joined" and _are_left_long(topic, counts)):
        yield _unmatched(topic, counts)
    if topic.removed_beams:
        returns = topic.removed_beams["returns"]
        for name, number in topic.removed_beams.items():
            if name != "returns":
                of = f"{scans}: {number:,} of {counted(returns, 'beam')}"
                yield f"{of} {agreeing(number, 'were')} {name}, and {agreeing(number, 'are')} removed"
    if beams := topic.rebinned:
        note = f"{scans}: of {beams.beams:,} beams {beams.shared:,} share one of the new scans with another"
        yield f"{note}; {beams.between:,} of the new ones lie between two neighbours, without a return"


def _tilt_warning(topic: TopicReport, tilt: Mapping[str, float], source_frame: str) -> str:
    """Return a warning if the tilt of the target frame is implausible; empty if it is not."""
    by, frame = _levelled(topic, source_frame)
    if (median := tilt["median_deg"]) > _NOTABLE_TILT:
        return (
            f"{topic.target}: by {by}, {frame} is tilted by {median:.0f} degrees (median). If it is not mounted "
            "so, the mount of the IMU is wrong (`static_tf`), or z of `fixed_frame` is not up"
        )
    if tilt["largest_deg"] < _NO_TILT and len(topic.tilts) >= _SEVERAL:
        return (
            f"{topic.target}: by {by}, {frame} is never tilted, so `level` has no effect. Wheel odometry has no "
            "roll and pitch, an IMU has: `imu=TOPIC`"
        )
    return ""


def _levelled(topic: TopicReport, source_frame: str) -> tuple[str, str]:
    """Return by what a topic's scans are level, and in which frame they would be otherwise."""
    spec = topic.spec
    frame = (spec.params.target_frame if spec else "") or source_frame or "the clouds' frame"
    return (spec.imu or spec.fixed_frame) if spec else "", frame


def param_notes(spec: ScanSpec) -> Iterator[str]:
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


def loss_warning(topics: Sequence[TopicReport]) -> str:
    """Return the warning of how many messages of which topics are missing, and why."""
    count = sum(topic.messages_in for topic in topics)
    listed = [f"{topic.topic} ({topic.messages_in:,}: {topic.note})" for topic in topics[:_MAX_WARNED]]
    more = len(topics) - len(listed)
    return (
        f"{counted(count, 'message')} of {counted(len(topics), 'topic')} "
        f"{agreeing(count, 'are')} skipped: {', '.join(listed)}{f' and {more} more' if more else ''}"
    )

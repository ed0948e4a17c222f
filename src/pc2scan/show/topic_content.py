"""What a topic holds: the properties of its clouds, from a sample, and the defects of its scans."""

from __future__ import annotations

import math
from array import array
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from pc2scan.core.consumers import (
    CONSUMERS,
    OUTCOMES,
    ConsumerScan,
    Outcome,
    ScanTransforms,
    Verdict,
    are_returns,
    judge,
)
from pc2scan.core.layout import TURN
from pc2scan.core.percentiles import median
from pc2scan.core.timing import IN_SECONDS, increment_doubt
from pc2scan.errors import DecodeError, TransformError, leading, name_list, stamp_text
from pc2scan.messages.clouds import CLOUDS, SCANS
from pc2scan.messages.laserscan import scan_for_consumers
from pc2scan.request.point_time import PointTime
from pc2scan.text import agreeing, count_range, counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from pc2scan.core.points import Points
    from pc2scan.messages.laserscan import LaserScan
    from pc2scan.model import RawMessage
    from pc2scan.result import Part
    from pc2scan.transforms.mounting import Mounting
    from pc2scan.transforms.placing import Placer

#: ``defect``: violates the definition of the message, or makes scans useless. ``notice``: worth knowing.
Level = Literal["defect", "notice"]

#: Scans without a transform are usual at the beginning and the end: as many as come within this time, nanoseconds, or
#: this share of all scans.
_USUAL_NS = 2_000_000_000
_USUAL_SHARE = 0.05

#: A median range from here on is taken for millimetres: no lidar sees half a kilometre in most directions.
_MILLIMETRES = 500.0

#: Rounding of a driver's ``time_increment``.
_ROUNDING = 1.01

#: A scan whose beams take so many times the interval has a ``time_increment`` in another unit.
_LONG = 10.0

#: An interval that differs from the median by more than this share is reported: scans are missing or repeated.
_STUTTER = 0.5

#: A ``scan_time`` that differs from the median interval by more than this share of it is reported.
_SCAN_TIME = 0.2

#: A scan is a part of a turn if returns are in less than this share of its directions, and less than this share of them
#: in directions in which the scan before it has returns.
_PART = 0.5

#: ... and if the mean of these directions is longer than that of half a turn: they are in one sector.
_HALF_TURN = 2 / math.pi

#: Fewer returns than these, as of two posts in a field while the robot turns, are no part of a turn.
_FEWEST_RETURNS = 4

#: What to do about stamps that are out of order.
_BACK = "SLAM mixes such scans up; pc2scan convert `stamps=log` takes the log times, with `rebin` for a 2D lidar"

#: What is counted scan by scan: a verb that agrees with the count, the problem, and what the user can do.
_EACH_SCAN: dict[str, tuple[str, str, str]] = {
    "stamps-back": ("have", "a stamp before that of the scan before", _BACK),
    "stamps-repeated": ("repeat", "the stamp of the scan before", _BACK),
    "stamps-zero": ("have", "no stamp (0)", _BACK),
    "no-returns": ("have", "no return at all", "other heights, for scans made from clouds: pc2scan info proposes them"),
}


@dataclass(frozen=True, slots=True)
class Finding:
    """A problem of the scans of a topic, for all consumers.

    Attributes
    ----------
    kind
        A word for programs, such as ``stamps-back``.
    level
        ``defect`` or ``notice``.
    text
        The problem, with the numbers.
    hint
        What the user can do; empty if unknown.
    count
        How many scans have it.
    stamp_ns
        The stamp of the first of these scans; None if it does not concern single scans.
    """

    kind: str
    level: Level
    text: str
    hint: str = ""
    count: int = 0
    stamp_ns: int | None = None

    def lines(self) -> Iterator[str]:
        """Yield the text of a report."""
        since = "" if self.stamp_ns is None else f" (first at {stamp_text(self.stamp_ns)})"
        yield f"  {self.level}: {self.text}{since}"
        if self.hint:
            yield f"          {self.hint}"


@dataclass(slots=True)
class ScanCount:
    """How many scans have a problem, and the stamp of the first; of verdicts, also the first one."""

    count: int = 0
    stamp_ns: int = 0
    verdict: Verdict | None = None

    def add(self, stamp_ns: int, verdict: Verdict | None = None) -> None:
        """Count one more scan."""
        if not self.count:
            self.stamp_ns, self.verdict = stamp_ns, verdict
        self.count += 1

    def finding(self, kind: str, level: Level, text: str, hint: str = "") -> Finding:
        """Return the finding about what was counted."""
        return Finding(kind, level, text, hint, self.count, self.stamp_ns)


class ConsumerCheck(NamedTuple):
    """What one consumer does with the scans of a topic.

    Attributes
    ----------
    consumer
        Its name.
    outcome
        The worst outcome of any scan.
    scans
        How many scans have this outcome.
    verdict
        The rule, the numbers and the cure, for the first of these scans.
    stamp_ns
        The stamp of the first of these scans.
    """

    consumer: str
    outcome: Outcome
    scans: int
    verdict: Verdict
    stamp_ns: int

    def lines(self, scans: int) -> Iterator[str]:
        """Yield the text of a report, given how many scans the topic has."""
        share = "" if self.scans == scans else f" {self.scans:,} of {counted(scans, 'scan')}"
        yield f"  {self.consumer:<14}{self.outcome}{share}"
        verdict = self.verdict
        if verdict.rule:
            yield f"      rule  {verdict.rule}"
            yield f"      here  {verdict.observed}; allowed: {verdict.allowed}"
            yield f"      cure  {verdict.cure}"


class TopicCheck(NamedTuple):
    """The result of one topic.

    Attributes
    ----------
    scans
        How many were decoded.
    frames
        All ``frame_id`` of the scans.
    beams
        The smallest and the largest number of beams.
    interval_ns
        Median of the intervals between stamps, to one percent; None for fewer than two scans.
    first
        The first scan; None without any.
    consumers
        What each consumer does, in the order of `pc2scan.core.consumers.CONSUMERS`; empty without scans.
    findings
        Problems for all consumers, the defects first.
    """

    topic: str
    scans: int
    frames: tuple[str, ...]
    beams: tuple[int, int]
    interval_ns: float | None
    first: ConsumerScan | None
    consumers: tuple[ConsumerCheck, ...]
    findings: tuple[Finding, ...]

    def head(self) -> Iterator[str]:
        """Yield what the scans are."""
        scan = self.first
        if scan is None:
            yield f"{leading(self.topic)}: no scans"
        else:
            frames = name_list(list(map(repr, self.frames)), 5)
            rate = "" if self.interval_ns is None else f", {1e9 / self.interval_ns:.2f} Hz"
            beams = f"{count_range(*self.beams)} beams"
            yield f"{leading(self.topic)}: {counted(self.scans, 'scan')} of {beams}{rate}, in frame {frames}"
            yield (
                f"  angles {scan.angle_min:.6g} to {scan.angle_max:.6g} rad by {scan.angle_increment:.6g}, "
                f"ranges {scan.range_min:.4g} to {scan.range_max:.4g} m"
            )

    def lines(self, names: tuple[str, ...]) -> Iterator[str]:
        """Yield the text of a report, with the verdicts of the named consumers, or of all."""
        yield from self.head()
        yield ""
        for consumer in self.consumers:
            if not names or consumer.consumer in names:
                yield from consumer.lines(self.scans)
        for finding in self.findings:
            yield from finding.lines()
        yield ""


def few_unplaced(unplaced: int, scans: int, interval_ns: float | None) -> bool:
    """Whether so many scans without a transform are usual in a sound recording.

    They are less than half of the scans, and at most 5 % of them or as many as come within 2 s: transforms often begin
    a little later than the scans, and end earlier.
    """
    at_the_ends = _USUAL_NS / interval_ns if interval_ns else 0.0
    return 2 * unplaced < scans and unplaced <= max(_USUAL_SHARE * scans, at_the_ends)


class ScanTopic:
    """The scans of one topic, added in the order of their log times.

    Attributes
    ----------
    scans
        How many were decoded.
    first
        The first of them.
    frames
        All ``frame_id``.
    beams
        All lengths of ``ranges``.
    """

    def __init__(self) -> None:
        self.scans = 0
        self.first: ConsumerScan | None = None
        self.frames: dict[str, None] = {}
        self.beams: set[int] = set()
        #: The verdicts of each consumer, by outcome; those about transforms are beside the others.
        self._verdicts: dict[str, dict[str, ScanCount]] = {consumer: {} for consumer in CONSUMERS}
        self._undecodable = ScanCount()
        self._reason = ""
        self._kept_of: dict[tuple[str, str], ConsumerScan] = {}
        self._tallies = {kind: ScanCount() for kind in _EACH_SCAN}
        #: Zeros that are returns, because range_min is 0 or less.
        self._zeros = 0
        self._median = 0.0
        #: The last stamp, and the intervals that are positive.
        self._last_ns: int | None = None
        self._intervals = array("q")
        self._sectors = _Sectors()

    def read(
        self,
        message: RawMessage,
        echo: str = "first",
        place: Callable[[str, int, int], ScanTransforms] = lambda *_: ScanTransforms(),
    ) -> None:
        """Add the next message; ``place`` returns the transforms of a frame at a stamp and a log time."""
        try:
            scan = SCANS[message.connection.ros_type](message.connection.serialization, echo)(message.data)
        except DecodeError as err:
            self._undecodable.add(message.log_time_ns)
            self._reason = self._reason or err.message
        else:
            self._add(scan, place(scan.frame_id, scan.stamp_ns, message.log_time_ns))

    def _add(self, message: LaserScan, placed: ScanTransforms) -> None:
        stamp_ns, frame = message.stamp_ns, message.frame_id
        scan = scan_for_consumers(message)
        self.scans += 1
        if self.first is None:
            self.first = scan
            finite = message.ranges[np.isfinite(message.ranges)]
            self._median = median(finite) if len(finite) else 0.0
        self.frames[frame] = None
        self.beams.add(scan.beams)
        self._judge(scan, frame, stamp_ns, placed)
        self._zeros += scan.zero if scan.range_min <= 0 else 0
        if fault := self._stamp_fault(stamp_ns):
            self._tallies[fault].add(stamp_ns)
        if scan.returns:
            self._sectors.add(frame, scan, message.ranges, stamp_ns)
        else:
            self._tallies["no-returns"].add(stamp_ns)

    def _judge(self, scan: ConsumerScan, frame: str, stamp_ns: int, placed: ScanTransforms) -> None:
        for consumer, verdicts in self._verdicts.items():
            kept = self._kept_of.get((consumer, frame))
            verdict = judge(consumer, scan, kept, placed)
            if verdict.unplaced:
                verdicts.setdefault("unplaced", ScanCount()).add(stamp_ns, verdict)
                verdict = judge(consumer, scan, kept)
            else:
                self._kept_of.setdefault((consumer, frame), scan)
            verdicts.setdefault(verdict.outcome, ScanCount()).add(stamp_ns, verdict)

    def _stamp_fault(self, stamp_ns: int) -> str:
        """Return what is wrong with the stamp of the next scan; empty if nothing is."""
        if stamp_ns == 0:
            return "stamps-zero"
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if last_ns is None:
            return ""
        if stamp_ns > last_ns:
            self._intervals.append(stamp_ns - last_ns)
            return ""
        return "stamps-back" if stamp_ns < last_ns else "stamps-repeated"

    @property
    def interval_ns(self) -> float | None:
        """The median of the intervals between stamps; None if there are none."""
        middle = (len(self._intervals) - 1) // 2
        return float(np.partition(np.array(self._intervals), middle)[middle]) if self._intervals else None

    def result(self, name: str, interval_ns: float | None, findings: Iterable[Finding]) -> TopicCheck:
        """Return the result of a topic of this name, with these findings."""
        beams = min(self.beams, default=0), max(self.beams, default=0)
        frames, consumers = tuple(self.frames), tuple(self._consumers())
        return TopicCheck(name, self.scans, frames, beams, interval_ns, self.first, consumers, tuple(findings))

    def _consumers(self) -> Iterator[ConsumerCheck]:
        """Yield the worst verdict of each consumer.

        A few missing transforms do not count, see `few_unplaced`. Problems of the scans themselves come first.
        """
        for consumer, verdicts in self._verdicts.items() if self.scans else ():
            outcome = [known for known in OUTCOMES if known in verdicts][-1]
            unplaced = verdicts.get("unplaced", ScanCount())
            few = few_unplaced(unplaced.count, self.scans, self.interval_ns)
            worst = unplaced if outcome in ("accepted", "shifted") and not few else verdicts[outcome]
            verdict = worst.verdict
            assert verdict is not None
            preset = f"`preset={consumer}`"
            if preset in verdict.cure:
                # Scans that a 2D lidar has measured, too.
                cure = verdict.cure.replace(preset, f"`rebin=True` {preset}")
                verdict = verdict._replace(cure=f"{cure}; without `rebin` for scans made from clouds")
            yield ConsumerCheck(consumer, verdict.outcome, worst.count, verdict, worst.stamp_ns)

    def undecodable(self) -> Iterator[Finding]:
        """Yield a finding if messages are no scans."""
        if self._undecodable.count:
            text = f"{counted(self._undecodable.count, 'message')} cannot be read as a scan: {self._reason}"
            yield self._undecodable.finding("undecodable", "defect", text)

    def findings(self) -> Iterator[Finding]:
        """Yield the problems of the scans."""
        yield from self.undecodable()
        first = self.first
        if first is None:
            return
        for kind, (verb, problem, hint) in _EACH_SCAN.items():
            tally = self._tallies[kind]
            if not tally.count:
                continue
            of = f"{tally.count:,} of {counted(self.scans, 'scan')} {agreeing(tally.count, verb)}"
            few = kind == "no-returns" and 2 * tally.count <= self.scans
            yield tally.finding(kind, "notice" if few else "defect", f"{of} {problem}", hint)
        yield from self._time_findings(first)
        yield from self._sectors.findings()
        if self._median >= _MILLIMETRES:
            text = f"the median range of the first scan is {self._median:,.0f} m"
            hint = "ranges are metres; if the clouds are in millimetres: pc2scan convert `cloud_scale=0.001`"
            yield Finding("units", "notice", text, hint)
        if self._zeros:
            text = f"{self._zeros:,} ranges are 0, and range_min is 0 m or less"
            yield Finding("ranges-zero", "notice", text, "consumers see obstacles at the sensor: `range_min=0.1`")

    def _time_findings(self, first: ConsumerScan) -> Iterator[Finding]:
        if self.interval_ns is None:
            return
        period = self.interval_ns / 1e9
        off = np.abs(np.array(self._intervals) - self.interval_ns) > _STUTTER * self.interval_ns
        if count := int(off.sum()):
            most = f"{count} of {len(off)} intervals {agreeing(count, 'are')} not about {period:.3f} s"
            text = f"the rate stutters: {most}; the longest is {max(self._intervals) / 1e9:.3f} s"
            yield Finding("rate", "notice", text, "scans are missing, or were stamped on arrival", count)
        if first.scan_time > 0 and abs(first.scan_time - period) > _SCAN_TIME * period:
            text = f"scan_time is {first.scan_time:.4g} s, but scans come every {period:.4g} s"
            hint = f"pc2scan convert `scan_time={period:.3g}`, with `rebin` for scans of a 2D lidar"
            yield Finding("scan-time", "notice", text, hint)
        turn = max(abs(first.angle_max - first.angle_min), (first.beams - 1) * abs(first.angle_increment))
        if not turn > 0:  # nor NaN
            return
        span = abs(first.time_increment) * (first.beams - 1)
        doubt = increment_doubt(span / min(1.0, turn / TURN), period)
        if not doubt and span > period * _ROUNDING:
            doubt = f"by its time_increment a scan takes {span:.3g} s, but scans come every {period:.3g} s"
        if doubt:
            level: Level = "defect" if span > _LONG * period else "notice"
            yield Finding("time-increment", level, doubt, f"{IN_SECONDS}; pc2scan convert `rebin=True` writes 0")


class _Sectors:
    """The directions that scans with returns fill: packets are parts of a turn."""

    def __init__(self) -> None:
        #: The frame of the last scan, and which directions have a return; None if it is no part.
        self._last: tuple[str, NDArray[np.bool_]] | None = None
        self._pairs = -1
        self._parts = ScanCount()

    def add(self, frame_id: str, scan: ConsumerScan, ranges: NDArray[np.float32], stamp_ns: int) -> None:
        """Add the next scan, and its ranges, float32, shape (beams,), metres."""
        self._pairs += 1
        last, self._last = self._last, None
        if not _FEWEST_RETURNS <= scan.returns < _PART * scan.beams:
            return
        returns = are_returns(ranges, scan.range_min, scan.range_max)
        if abs(np.exp(1j * TURN / scan.beams * np.flatnonzero(returns)).mean()) < _HALF_TURN:
            return
        self._last = frame_id, returns
        if last is None or last[0] != frame_id or len(last[1]) != len(returns):
            return
        if np.count_nonzero(last[1] & returns) < _PART * min(np.count_nonzero(last[1]), np.count_nonzero(returns)):
            self._parts.add(stamp_ns)

    def findings(self) -> Iterator[Finding]:
        """Yield the problem."""
        parts = self._parts.count
        if parts > max(0, self._pairs) / 2:
            text = f"{parts:,} of {self._pairs:,} scans are parts of a turn: returns are in another sector each time"
            hint = "for scans made from clouds: pc2scan convert `accumulate=0.1`, the time of a turn"
            yield self._parts.finding("parts", "defect", text, hint)


# --- Clouds ---


@dataclass(frozen=True, slots=True)
class CloudInfo:
    """The properties of the clouds of one topic, from a sample spread over the recording.

    Attributes
    ----------
    sampled
        How many clouds were read.
    frames
        All ``frame_id`` of these clouds.
    fields
        Name and datatype, in the message's order.
    shape
        Height and width of the first cloud.
    points_min, points_max
        Points per cloud.
    nan_share
        Share of points with a NaN coordinate.
    zero_share
        Share of points at exactly (0, 0, 0), which some drivers write for no return.
    limits
        The least and the largest finite x, y, z and range, which is hypot(x, y); empty if there are none.
    above_zero_share
        Share of points with z > 0, which upstream's default min_height keeps.
    target_frame
        The frame of x, y and z; empty for the clouds' own.
    mounting
        How the clouds are mounted, and which options suit that; None if no cloud could be decoded.
    problems
        Why sampled clouds cannot be decoded or transformed, each reason once.
    """

    topic: str
    sampled: int = 0
    frames: tuple[str, ...] = ()
    fields: tuple[tuple[str, str], ...] = ()
    shape: tuple[int, int] = (0, 0)
    points_min: int = 0
    points_max: int = 0
    nan_share: float = 0.0
    zero_share: float = 0.0
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)
    above_zero_share: float = 0.0
    target_frame: str = ""
    mounting: Mounting | None = None
    problems: tuple[str, ...] = ()

    def body(self) -> Iterator[Part]:
        """Yield the parts of `Info` about the clouds."""
        yield f"{leading(self.topic)}: {counted(self.sampled, 'cloud')} sampled"
        yield from (f"  cannot be described: {problem}" for problem in self.problems)
        if not self.fields:
            return
        height, width = self.shape
        yield f"  frame   {', '.join(map(repr, self.frames))}"
        yield f"  points  {count_range(self.points_min, self.points_max)} a cloud ({height} x {width})"
        yield f"  fields  {', '.join(map(' '.join, self.fields))}"
        yield f"  NaN {self.nan_share:.1%}, (0, 0, 0) {self.zero_share:.1%}, z > 0 {self.above_zero_share:.1%}"
        if self.limits:
            limits = ", ".join(f"{name} {low:.2f} to {high:.2f}" for name, (low, high) in self.limits.items())
            yield f"  metres  {limits}" + (f" in {self.target_frame}" if self.target_frame else "")


class ShownCloud(NamedTuple):
    """What is kept of a cloud: its size, some of its points.

    Attributes
    ----------
    points
        (4, N): with their times, see `seconds_of`, without those at (0, 0, 0) or with NaN; (3, N) in another frame.
    nans, zeros
        How many of the points that were examined have NaN, and how many are at (0, 0, 0).
    shape, fields
        As in `CloudInfo`.
    """

    frame_id: str
    stamp_ns: int
    points: NDArray[np.floating[Any]]
    nans: int
    zeros: int
    shape: tuple[int, int]
    fields: tuple[tuple[str, str], ...]


def seconds_of(points: Points) -> NDArray[Any]:
    """Return the times of a cloud's points, seconds after its stamp, as many as these; NaN if they are not known."""
    with suppress(DecodeError):
        return np.asarray(PointTime().read(points).at())
    return np.full(points.xyz()[0].shape, np.nan)


def sample_cloud(most: int, message: RawMessage) -> ShownCloud | str:
    """Return what is kept of a cloud, so many points at most, or why it cannot be described."""
    fields = []
    try:
        cloud = CLOUDS[message.connection.ros_type](message.connection.serialization)(message.data)
        coordinates = cloud.xyz()
        for name in cloud.fields:
            # Fields that cannot be read are not needed.
            with suppress(DecodeError):
                fields.append((name, cloud.field(name).dtype.name))
        step = -(-coordinates[0].size // most) or 1
        with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
            x, y, z, seconds = (_thinned(column, step) for column in (*coordinates, seconds_of(cloud)))
            # Points at the sensor are no returns, wherever the sensor is in the target frame.
            zero = (x == 0) & (y == 0) & (z == 0)
            nan = np.isnan(x) | np.isnan(y) | np.isnan(z)
    except DecodeError as err:
        return _problem(err)
    height, width = np.atleast_2d(coordinates[0]).shape
    points, layout = np.stack([x, y, z, seconds.astype(x.dtype)])[:, ~(zero | nan)], ((height, width), tuple(fields))
    return ShownCloud(cloud.frame_id, cloud.stamp_ns, points, int(nan.sum()), int(zero.sum()), *layout)


def describe_clouds(topic: str, sampled: list[ShownCloud | str], places: Placer) -> tuple[CloudInfo, list[ShownCloud]]:
    """Return the properties of a topic's clouds, and the clouds, which leave ``sampled``, in the frame of scans.

    Parameters
    ----------
    topic
        The topic.
    sampled
        What `sample_cloud` returned.
    places
        The frame of scans.
    """
    count, clouds = len(sampled), list[ShownCloud]()
    problems: dict[str, None] = {}
    while sampled:
        cloud = sampled.pop(0)
        if isinstance(cloud, str):
            problems[cloud] = None
            continue
        try:
            place = places.place(cloud.frame_id, cloud.stamp_ns)
        except TransformError as err:
            problems[_problem(err)] = None
            continue
        if place.target_from_source is not None:
            points = place.target_from_source.apply(cloud.points[:3].T).T
            # Of infinite coordinates.
            cloud = cloud._replace(points=points[:, ~np.isnan(points).any(axis=0)])
        clouds.append(cloud)
    info = CloudInfo(topic, count, target_frame=places.target_frame, problems=tuple(problems))
    if not clouds:
        return info, clouds
    parts, sizes = [cloud.points for cloud in clouds], [math.prod(cloud.shape) for cloud in clouds]
    kept, nans, zeros = np.sum([(cloud.points.shape[1], cloud.nans, cloud.zeros) for cloud in clouds], axis=0).tolist()
    examined = max(1, kept + nans + zeros)
    return replace(
        info,
        frames=tuple(dict.fromkeys(cloud.frame_id for cloud in clouds)),
        fields=clouds[0].fields,
        shape=clouds[0].shape,
        points_min=min(sizes),
        points_max=max(sizes),
        nan_share=nans / examined,
        zero_share=zeros / examined,
        limits=_limits(parts),
        above_zero_share=sum(int((part[2] > 0).sum()) for part in parts) / max(1, kept),
    ), clouds


def _problem(err: DecodeError | TransformError) -> str:
    return f"{err.message} ({err.hint})" if err.hint else err.message


def _thinned(column: NDArray[Any], step: int) -> NDArray[np.floating[Any]]:
    """Return every ``step``-th coordinate: float32 unchanged, all others as float64, which represents them exactly.

    Rows with gaps between them have no flat view, so their columns are thinned.
    """
    column = column[::step] if column.ndim == 1 else column[:, ::step].ravel()
    return column.astype(np.float32 if column.dtype.kind == "f" and column.dtype.itemsize == 4 else np.float64)


def _limits(parts: Sequence[NDArray[np.floating[Any]]]) -> dict[str, tuple[float, float]]:
    """Return the least and the largest finite x, y, z and range of points, (3, N) or more of each cloud."""
    limits: dict[str, tuple[float, float]] = {}
    for x, y, z, *_ in parts:
        for name, values in (("x", x), ("y", y), ("z", z), ("range", np.hypot(x, y, dtype=np.float64))):
            finite = values[np.isfinite(values)]
            if finite.size:
                low, high = limits.get(name, (math.inf, -math.inf))
                limits[name] = min(low, float(finite.min())), max(high, float(finite.max()))
    return limits

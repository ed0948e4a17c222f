"""The checked request: a `Request` has the description of each output, and what applies to all of them."""

from __future__ import annotations

import re
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.topics import is_glob, new_topic
from pc2scan.core.params import ProjectionParams
from pc2scan.core.quantities import duration_ns
from pc2scan.core.rule import NO_TIME, NO_TRANSFORM, PointCounts, Rejection
from pc2scan.errors import ParameterError, UsageError
from pc2scan.messages.clouds import CLOUDS, SCANS
from pc2scan.options.values import nanoseconds_of
from pc2scan.transforms.placing import FrameOptions

from .filters import as_dict

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Mapping
    from pathlib import Path

    from pc2scan.core.unproject import UnprojectParams
    from pc2scan.options.moment import TimeBound
    from pc2scan.transforms.attitude import ImuRequest

    from .filters import Filter
    from .point_time import PointTime

#: The largest number of messages that one scan may be made of.
_MOST_MESSAGES = 100_000

#: The name of a trajectory among topics, in options.
TRAJECTORY = "trajectory"

#: The largest offset of a clock: three centuries, as stamps of 64 bits have.
_MOST_OFFSET_NS = 2**63 - 1

_CLOUDS = r"(\d+) ?(?:clouds?|scans?|messages?)"


class TopicRequest(NamedTuple):
    """A topic to convert, and the topic of the result."""

    source: str
    target: str | None = None

    @classmethod
    def parse(cls, text: str) -> TopicRequest:
        """Read ``/points`` or, in ROS's remapping notation, ``/points:=/scan``.

        Raises
        ------
        UsageError
            If a side of ``:=`` is empty, or the right one is not the name of a topic.
        """
        source, remapped, target = text.partition(":=")
        if not source or (remapped and not target):
            raise UsageError(f"`topics`: {text!r} is not a topic", hint="write /points or /points:=/scan")
        return cls(source, new_topic(target, f"`topics={text}`") if target else None)


class Combining(NamedTuple):
    """Which messages become one scan.

    Attributes
    ----------
    window_ns
        The largest difference between the stamps of another topic and of the leading one, nanoseconds; None: half the
        median period.
    span_ns, count
        A scan has the points of this many nanoseconds, or of this many messages of each topic, counted back from its
        stamp; both 0: of one message, or of its interval.
    every_ns
        The length of an interval that becomes one scan, nanoseconds; 0: each message of the leading topic becomes one.
    rebin
        Whether LaserScans are converted instead of clouds.
    is_bare
        Whether ``accumulate`` was typed as a whole number without a unit, which may be meant as a number of clouds.
    """

    window_ns: int | None = None
    span_ns: int = 0
    count: int = 0  # type: ignore[assignment]  # instead of the tuple's method
    every_ns: int = 0
    rebin: bool = False
    is_bare: bool = False

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Combining:
        """Parse the options ``window``, ``accumulate``, ``every`` and ``rebin``; others are ignored.

        Raises
        ------
        UsageError
            If a value cannot be parsed, or is out of range.
        """
        spans = {name: nanoseconds_of(name, values[name]) for name in ("window", "every") if name in values}
        accumulate = values.get("accumulate")
        count = span_ns = 0
        if isinstance(accumulate, str) and (match := re.fullmatch(_CLOUDS, accumulate.strip())):
            count = int(match[1])
            if not 1 <= count <= _MOST_MESSAGES:
                raise UsageError(f"`accumulate` is {accumulate!r}, it must be 1 to {_MOST_MESSAGES:,} clouds")
        elif accumulate is not None:
            span_ns = nanoseconds_of("accumulate", accumulate, "; or a number of clouds (10clouds)")
        is_bare = isinstance(accumulate, str) and accumulate.strip().isdecimal()
        rebin = values.get("rebin", False)
        return cls(spans.get("window"), span_ns, count, spans.get("every", 0), rebin, is_bare)

    @property
    def accumulates(self) -> bool:
        """Whether scans are made of several messages of each topic."""
        return bool(self.span_ns or self.count or self.every_ns)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanSpec:
    """The checked description of one output. Two of these are never equal.

    Attributes
    ----------
    topics
        The topics to convert, and those of the results; empty means every topic of `types`. Messages that go to
        several topics are converted once.
    name
        The name of the output in errors and the report; without ``topics``, also the target of the only topic that can
        be converted. Empty if the command line describes the output.
    place
        The place of its description, for errors.
    origins
        The origin of each parameter's value, by name; ``default`` if it was not given.
    params
        The projection's parameters.
    reverse
        Whether LaserScan becomes PointCloud2. Of ``params``, only those about frames are used then.
    channels
        Fields of the clouds that ``reverse`` makes, and the range cutoff; None means the defaults.
    deskew
        Whether each point of a cloud, with ``reverse`` each beam of a scan, is transformed by the pose at its own time.
    fixed_frame
        A frame that does not move. With ``deskew`` of clouds, points are transformed through it; with ``level``, its z
        axis points up.
    point_time
        With ``deskew`` of clouds: the source of the points' times; None: the first of the usual fields that exists.
    stamp
        With ``deskew`` of clouds: the scan's stamp: that of the cloud's ``header``, or the ``start``, ``middle`` or
        ``end`` of its points' times.
    level
        Whether scans of clouds are in a frame without roll and pitch, which come from ``fixed_frame`` or ``imu``.
    imu
        With ``level``: the IMU that measures the direction of up; None: ``fixed_frame`` is used.
    combining
        Which messages become one scan.
    filters
        Filters of points, which are applied before the projection, in order.
    remove
        Filters of beams, which are applied after the projection, in order: ``shadows`` and ``speckles``.
    keep_used
        A topic for the points that give the scans their ranges; empty: none.
    echo
        The echo that 2D scans with several echoes use: ``first``, ``last`` or ``strongest``.
    """

    topics: tuple[TopicRequest, ...] = ()
    name: str = ""
    place: str = ""
    origins: Mapping[str, str] = field(default_factory=dict)
    params: ProjectionParams = ProjectionParams()
    reverse: bool = False
    channels: UnprojectParams | None = None
    deskew: bool = False
    fixed_frame: str = ""
    point_time: PointTime | None = None
    stamp: str = "header"
    level: bool = False
    imu: ImuRequest | None = None
    combining: Combining = Combining()
    filters: tuple[Filter, ...] = ()
    remove: tuple[str, ...] = ()
    keep_used: str = ""
    echo: str = "first"

    def __post_init__(self) -> None:
        combines, steps, fixed = self.may_combine, self.params.time_increment, self.fixed_frame
        deskews_clouds = self.deskew and not self.reverse
        contradictions = {
            "`echo` chooses among the echoes of 2D scans, which need `reverse` or `rebin`": (
                self.echo != "first" and not (self.reverse or combines)
            ),
            "`level` needs a frame whose z is up, such as `fixed_frame=odom`, or an IMU: `imu=/imu/data`": (
                self.level and not (self.imu or fixed)
            ),
            "`fixed_frame` needs `deskew` or `level` of clouds, `accumulate`, or topics that become one scan": (
                fixed and not (self.deskew or self.level or combines)
            ),
            "`deskew` needs a frame that does not move with the sensor, such as `target_frame=odom`": (
                self.deskew and self.reverse and not self.params.target_frame
            ),
            "`deskew` of clouds needs a frame that does not move, such as `fixed_frame=odom`": (
                deskews_clouds and not fixed
            ),
            f"time_increment is {steps}, but a scan that is deskewed, or of several messages, has one time": (
                steps != 0 and (deskews_clouds or combines)
            ),
            "`window` needs several topics that become one scan: `topics=/front:=/scan` `topics=/rear:=/scan`": (
                self.combining.window_ns is not None and not self.may_share
            ),
            "`keep_used` needs scans of one cloud each, without `accumulate`, `every` and `rebin`": (
                combines and self.keep_used
            ),
        }
        if wrong := [message for message, is_wrong in contradictions.items() if is_wrong]:
            raise UsageError(wrong[0])
        for name in (point_filter.name for point_filter in self.filters):
            if name in PointCounts().as_dict() or not name.isidentifier():
                raise UsageError(f"a filter is named {name!r}, which cannot be the name of its count")

    def as_dict(self) -> dict[str, Any]:
        """Return the parameters of the projection, their origins and the filters, for reports."""
        return {
            "name": self.name,
            "params": self.params,
            "param_origins": dict(self.origins),
            "filters": [as_dict(point_filter) for point_filter in self.filters],
        }

    @contextmanager
    def naming_errors(self, place: str = "") -> Generator[None]:
        """Put the name of the output in front of errors, after ``place``; those of a parameter get its origin."""
        try:
            yield
        except UsageError as err:
            if isinstance(err, ParameterError) and (origin := self.origins.get(err.name)):
                err.message += f" (from {origin})"
            err.message = place + self.label + err.message
            raise

    @property
    def may_share(self) -> bool:
        """Whether several topics may go to one."""
        targets = [request.target for request in self.topics if request.target]
        wild = any(request.target and "*" not in request.target and is_glob(request.source) for request in self.topics)
        return not self.reverse and (wild or len(set(targets)) < len(targets))

    @property
    def may_combine(self) -> bool:
        """Whether a scan may be made of several messages, or of other scans."""
        return self.may_share or self.combining.accumulates or self.combining.rebin

    def refuse_combining(self, what: str) -> None:
        """Raise if scans would be made of several messages, or of scans, where each has to be made of one cloud.

        Raises
        ------
        UsageError
            If any option requests this.
        """
        if self.may_combine:
            raise UsageError(
                f"{what} each scan of one cloud: `accumulate`, `every`, `rebin` and topics that share a target do not "
                "count",
                hint="make the scans with `pc2scan convert` and these options, and use what it writes",
            )

    @property
    def rejections(self) -> tuple[Rejection, ...]:
        """The reasons for which points may be rejected, besides those of the projection."""
        lost = (NO_TIME, NO_TRANSFORM) if self.deskew and not self.reverse else ()
        own = (
            Rejection(point_filter.name, point_filter.explanation, absent=getattr(point_filter, "absent", ""))
            for point_filter in self.filters
        )
        return (*own, *lost)

    @property
    def needs_transforms(self) -> bool:
        """Whether messages are transformed, for the output or for a filter."""
        in_others = any(isinstance(point_filter.frame, str) for point_filter in self.filters)
        return bool(self.params.target_frame or self.fixed_frame or self.level or in_others)

    @property
    def frames(self) -> tuple[str, ...]:
        """The frames that transforms must have."""
        named = (point_filter.frame for point_filter in self.filters if isinstance(point_filter.frame, str))
        return tuple(filter(None, (self.params.target_frame, self.fixed_frame, *named)))

    @property
    def needs_measuring(self) -> bool:
        """Whether anything must be measured in the first clouds."""
        params = self.params
        needs_fields = (
            params.intensity_field or self.deskew or any(point_filter.fields for point_filter in self.filters)
        )
        return bool(needs_fields) or "auto" in (params.scan_time, params.time_increment, params.beams)

    def is_default(self, name: str) -> bool:
        """Return whether a parameter of the projection is not given."""
        is_given = self.origins.get(name, "default") != "default"
        return not is_given and bool(getattr(self.params, name) == getattr(ProjectionParams(), name))

    @property
    def label(self) -> str:
        """The beginning of messages about this output; empty if it has no name."""
        return f"{self.name}: " if self.name else ""

    def types(self, *, named: bool = False) -> tuple[str, ...]:
        """Return the types that are converted, in ROS 2's spelling; ``named``: of topics that are requested by name."""
        if self.reverse or self.combining.rebin:
            return tuple(SCANS)
        return (*CLOUDS, *SCANS) if named and self.may_combine else tuple(CLOUDS)


@dataclass(frozen=True, slots=True)
class StampOptions:
    """How stamps are corrected.

    Attributes
    ----------
    by_log
        Whether the stamps of converted messages become their log times.
    offset_ns
        What is added to the stamps of converted messages, nanoseconds; None: it is measured.
    by_topic
        The same for single topics, which may be any that are read; ``trajectory`` stands for the poses of a file.
    """

    by_log: bool = False
    offset_ns: int | None = 0
    by_topic: Mapping[str, int | None] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return self.by_log or self.offset_ns != 0 or bool(self.by_topic.keys() - {TRAJECTORY})

    @classmethod
    def of(cls, stamps: str, time_offset: Iterable[str]) -> StampOptions:
        """Read the options ``stamps`` and ``time_offset``.

        Raises
        ------
        UsageError
            If an offset is not one, or they contradict each other.
        """
        offsets: dict[str, int | None] = {}
        for text in time_offset:
            name, _, value = text.rpartition("=")
            if name in offsets:
                raise UsageError(f"`time_offset` is given twice for {name or 'all topics'}")
            offsets[name] = _offset_of(text, value)
        if offsets.get(TRAJECTORY, 0) is None:
            raise UsageError("`time_offset`: the offset of a trajectory is not measured; give it in seconds")
        general, by_log = offsets.pop("", 0), stamps == "log"
        if by_log and general != 0:
            raise UsageError("`stamps=log` takes log times, which `time_offset` would change; give only one of them")
        return cls(by_log, general, offsets)


def _offset_of(text: str, value: str) -> int | None:
    """Return an offset in nanoseconds, exact to the last digit; None for ``auto``."""
    if value == "auto":
        return None
    sign, number = re.fullmatch(r"([+-]?)(.*)", value.strip()).groups()  # type: ignore[union-attr]
    offset_ns = duration_ns(number if re.search("[a-z]", number) else f"{number}s")
    if offset_ns is None or offset_ns > _MOST_OFFSET_NS:
        raise UsageError(
            f"`time_offset`: {text!r} is not an offset",
            hint="write seconds (3.2, -37s), 120ms, 48us, auto, or with a topic /rear=0.12s",
        )
    return -offset_ns if sign == "-" else offset_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """A checked request to convert: its outputs, and what applies to all of them.

    Attributes
    ----------
    scans
        The outputs; usually only one.
    frames
        The source of transforms.
    clock
        How the stamps of converted messages are corrected.
    cloud_scale
        What the coordinates of clouds are multiplied by, so that they are metres.
    keep_clouds
        Whether the converted messages are written, too.
    clouds_as
        How clouds are written that are not converted, or kept: ``recorded``, or ``pointcloud2``. With the latter, they
        are written instead of scans if they are not kept.
    only_scans
        Whether only the new messages are written.
    keep, drop
        Topics or globs that choose among the topics that are not converted. ``drop`` has precedence, and also
        excludes a cloud topic that is not requested by name.
    start, end
        The cut, by log time: from ``start`` on, before ``end``.
    jobs
        Number of threads; 0: one for each processor core.
    strict
        Whether damage of a source, and a message that cannot be converted, are errors; otherwise everything readable
        is converted, and the report lists the rest.
    fail_on
        When the whole run fails and nothing is written: ``empty`` (if a scan has no return), or ``warning`` (also for
        any other warning, skipped message or damage); empty text for neither.
    min_used
        The share of the points of each topic, 0 to 1, that must be in its scans; otherwise the run fails.
    repair
        Convert nothing: all messages are copied, byte for byte.
    files
        The files that were read for these options, by option.
    notes
        Warnings about these files.
    """

    scans: tuple[ScanSpec, ...] = (ScanSpec(),)
    frames: FrameOptions = FrameOptions()
    clock: StampOptions | None = None
    cloud_scale: float = 1.0
    keep_clouds: bool = False
    clouds_as: str = "recorded"
    only_scans: bool = False
    keep: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()
    start: TimeBound | None = None
    end: TimeBound | None = None
    jobs: int = 0
    strict: bool = False
    fail_on: str = ""
    min_used: float = 0.0
    repair: bool = False
    files: Mapping[str, Path] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        named = {request.source for spec in self.scans for request in spec.topics}
        if twice := [topic for topic in self.drop if topic in named]:
            raise UsageError(f"`drop={twice[0]}` has no effect on a topic that `topics` converts")

    @property
    def no_scans(self) -> bool:
        """Whether clouds are written instead of scans; ``scans`` is not used then."""
        return self.clouds_as != "recorded" and not self.keep_clouds

    @property
    def scan(self) -> ScanSpec:
        """The first output."""
        return self.scans[0]

    @property
    def window(self) -> int | None:
        """How many units may be loaded ahead, the node's ``queue_size``; None: as many as memory allows."""
        return min((spec.params.queue_size for spec in self.scans if spec.params.queue_size), default=None)

    def with_scan(self, **changes: Any) -> Request:
        """Return the options with only the first output, changed."""
        return replace(self, scans=(replace(self.scan, **changes),))

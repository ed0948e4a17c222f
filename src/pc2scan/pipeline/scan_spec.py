"""One output of a conversion: its source topics, parameters and options."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.topics import is_glob, new_topic
from pc2scan.core.counts import PointCounts
from pc2scan.core.params import ProjectionParams
from pc2scan.errors import UsageError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.messages.pointcloud2 import POINTCLOUD2

from .combine.options import Combining

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pc2scan.core.rule import Rejection
    from pc2scan.core.unproject import UnprojectParams

    from .stages.beams import BeamFilter
    from .stages.filters import Filter


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
            raise UsageError(f"{text!r} is not a topic", hint="write /points or /points:=/scan")
        return cls(source, new_topic(target, f"`topics={text}`") if target else None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanSpec:
    """The checked description of one output. Two of these are never equal.

    Attributes
    ----------
    topics
        The topics to convert, and those of the results; empty means every topic of `source_types`. Messages that go to
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
        With ``deskew`` of clouds: the field with the times of points, as ``FIELD`` or ``FIELD:UNIT``. Empty: the first
        of the usual fields that exists.
    stamp
        With ``deskew`` of clouds: the scan's stamp: that of the cloud's ``header``, or the ``start``, ``middle`` or
        ``end`` of its points' times.
    level
        Whether scans of clouds are in a frame without roll and pitch, which come from ``fixed_frame`` or ``imu``.
    imu
        With ``level``: the IMU that measures the direction of up, ``TOPIC`` or ``TOPIC:FRAME``. Empty: ``fixed_frame``
        is used.
    combining
        Which messages become one scan.
    filters
        Filters of points, which are applied before the projection, in order.
    remove
        Filters of beams, which are applied after the projection, in order: ``Shadows`` and ``Speckles`` of
        `pc2scan.pipeline.stages.beams`.
    keep_used
        A topic for the points that give the scans their ranges; empty: none.
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
    point_time: str = ""
    stamp: str = "header"
    level: bool = False
    imu: str = ""
    combining: Combining = Combining()
    filters: tuple[Filter, ...] = ()
    remove: tuple[BeamFilter, ...] = ()
    keep_used: str = ""

    def __post_init__(self) -> None:
        if self.keep_used:
            object.__setattr__(self, "keep_used", new_topic(self.keep_used, "`keep_used`"))
        if not self.reverse and self.channels is not None:
            raise UsageError("`channels` and `range_cutoff` need `reverse`")
        self._check_stages()
        self._check_levelling()
        self._check_deskewing()
        self._check_combining()

    def as_dict(self) -> dict[str, Any]:
        """Return the parameters of the projection, their origins and the filters, for reports."""
        from .stages.filters import as_dict  # noqa: PLC0415  # only reports in JSON need it

        return {
            "name": self.name,
            "params": self.params,
            "param_origins": dict(self.origins),
            "filters": [as_dict(each) for each in self.filters],
        }

    def _check_stages(self) -> None:
        if self.reverse and self.keep_used:
            raise UsageError("`keep_used` keeps points of clouds, but `reverse` converts scans")
        if self.reverse and self.remove:
            raise UsageError("`remove` removes beams of scans that are made of clouds, but `reverse` makes clouds")
        if self.reverse and self.filters:
            raise UsageError("filters select points of clouds, but `reverse` converts scans")
        taken = PointCounts().as_dict()
        for name in (each.name for each in self.filters):
            if name in taken or not name.isidentifier():
                raise UsageError(f"a filter is named {name!r}, which cannot be the name of its count")

    def _check_deskewing(self) -> None:
        if self.deskew and self.reverse and not self.params.target_frame:
            raise UsageError(
                "`deskew` needs a `target_frame` that does not move with the sensor",
                hint="such as `target_frame=odom`",
            )
        if (self.reverse or not self.deskew) and (self.point_time or self.stamp != "header"):
            raise UsageError("`point_time` and `stamp` need `deskew` of clouds")
        moves = self.deskew or self.level or self.may_combine
        if self.fixed_frame and (self.reverse or not moves):
            raise UsageError(
                "`fixed_frame` needs `deskew` or `level` of clouds, `accumulate`, or topics that become one scan"
            )
        if self.reverse or not self.deskew:
            return
        from .stages.deskew import STAMPS, PointTime  # noqa: PLC0415  # only where points move

        if not self.fixed_frame:
            raise UsageError(
                "`deskew` of clouds needs a frame that does not move: `fixed_frame`", hint="such as `fixed_frame=odom`"
            )
        if self.stamp not in STAMPS:
            raise UsageError(f"`stamp` is {self.stamp!r}, it must be one of {', '.join(STAMPS)}")
        if self.point_time:
            PointTime.parse(self.point_time)
        if self.params.time_increment != 0:
            raise UsageError(
                f"time_increment is {self.params.time_increment}, but a deskewed scan has one time",
                hint="remove `time_increment`",
            )

    def _check_levelling(self) -> None:
        if self.level and self.reverse:
            raise UsageError("`level` makes scans level, but `reverse` makes clouds")
        if self.imu and not self.level:
            raise UsageError("`imu` needs `level`")
        if self.level and not (self.fixed_frame or self.imu):
            raise UsageError(
                "`level` needs a source of the direction of up",
                hint="give a frame that does not move, whose z is up: `fixed_frame=odom`; or an IMU: `imu=/imu/data`",
            )
        if self.imu:
            from pc2scan.tf.imu import ImuRequest  # noqa: PLC0415  # only where scans are level

            ImuRequest.parse(self.imu)

    def _check_combining(self) -> None:
        asked = self.combining
        if self.reverse and (asked.accumulates or asked.rebin):
            raise UsageError("`accumulate`, `every` and `rebin` make scans, but `reverse` makes clouds")
        if (asked.lead or asked.window_ns is not None) and not self.may_share:
            raise UsageError(
                "`lead` and `window` need several topics that become one scan",
                hint="such as `topics=/front:=/scan` `topics=/rear:=/scan` `target_frame=base_link`",
            )
        if asked.window_ns is not None and asked.accumulates:
            raise UsageError(
                "`window` has no effect with `accumulate` and `every`, which use all messages of an interval"
            )
        if self.may_combine and self.params.time_increment != 0:
            raise UsageError(
                f"time_increment is {self.params.time_increment}, but a scan of several messages has one time",
                hint="remove `time_increment`",
            )

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
        further: tuple[Rejection, ...] = ()
        if self.filters:
            from .stages.filters import rejection_of  # noqa: PLC0415  # only where points are filtered

            further = tuple(map(rejection_of, self.filters))
        if not self.deskew or self.reverse:
            return further
        from pc2scan.core.rule import NO_TIME, NO_TRANSFORM  # noqa: PLC0415  # only where points move

        return (*further, NO_TIME, NO_TRANSFORM)

    @property
    def needs_transforms(self) -> bool:
        """Whether messages are transformed, for the output or for a filter."""
        in_others = any(isinstance(each.frame, str) for each in self.filters)
        return bool(self.params.target_frame or self.fixed_frame or self.level or in_others)

    @property
    def needs_measuring(self) -> bool:
        """Whether anything must be measured in the first clouds."""
        params = self.params
        needs_fields = params.intensity_field or self.deskew or any(each.fields for each in self.filters)
        return bool(needs_fields) or "auto" in (params.scan_time, params.time_increment, params.beams)

    @property
    def label(self) -> str:
        """The beginning of messages about this output; empty if it has no name."""
        return f"{self.name}: " if self.name else ""

    @property
    def source_types(self) -> tuple[str, ...]:
        """The types that are converted, in ROS 2's spelling."""
        return (LASERSCAN,) if self.reverse or self.combining.rebin else tuple(CLOUDS)

    @property
    def named_types(self) -> tuple[str, ...]:
        """The types that are converted if a topic is requested by name."""
        return (*self.source_types, LASERSCAN) if self.may_combine and not self.combining.rebin else self.source_types

    @property
    def made_type(self) -> str:
        """The type of the new messages."""
        return POINTCLOUD2 if self.reverse else LASERSCAN

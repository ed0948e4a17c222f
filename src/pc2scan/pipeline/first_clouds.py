"""Samples the first clouds of a conversion, and draws warnings if they contradict its parameters.

The threads that convert take a sample of each cloud that may be among the first, until enough samples have been judged.
Samples are judged in the order of writing, so the warnings do not depend on the number of threads. A level floor in the
first cloud ends the check within a millisecond.
"""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .cloud_checks import CloudChecks, Sample, sample_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pc2scan.core.counts import PointCounts
    from pc2scan.core.points import Points
    from pc2scan.tf.buffer import TransformBuffer
    from pc2scan.tf.mounting import Mounting
    from pc2scan.tf.placing import Placement
    from pc2scan.tf.static import StaticTransform

    from .report import Report
    from .scan_spec import ScanSpec

#: How many clouds are judged together if the first one is not enough.
_CLOUDS = 3


class SharedSample(NamedTuple):
    """A sample of a cloud, and the clouds that it belongs to."""

    clouds: TopicClouds
    sample: Sample

    def add(self, counts: PointCounts) -> None:
        """Add the cloud, in the order of writing."""
        self.clouds.add(self.sample, counts)


class Candidate(NamedTuple):
    """A cloud that may be among the first ones, as long as its message is in memory."""

    clouds: TopicClouds
    points: Points
    place: Placement

    def sample(self, log_time_ns: int) -> SharedSample | None:
        """Return a sample of the cloud's points; None if it is not among the first. On any thread."""
        clouds = self.clouds
        return clouds.sample(self.points, self.place) if clouds.may_be_first(log_time_ns) else None


class FirstClouds:
    """The first clouds of every topic that is converted.

    Parameters
    ----------
    report
        Receives warnings and notes.
    warn
        Also called with each warning immediately, so that a user can stop a conversion that makes empty scans.
    transforms
        Reads the recording's transforms between the robot's frames, in the few cases that need them.

    Attributes
    ----------
    buffer
        The transforms to the target frame; None where there is no target frame.
    static
        The transforms that options add.
    """

    def __init__(
        self,
        report: Report,
        warn: Callable[[str], None] | None,
        transforms: Callable[[], TransformBuffer | None],
    ) -> None:
        self.report = report
        self.transforms = transforms
        self.buffer: TransformBuffer | None = None
        self.static: Sequence[StaticTransform] = ()
        self._warn = warn
        self._topics: dict[tuple[str, ScanSpec], TopicClouds] = {}

    def of(self, spec: ScanSpec, topic: str) -> TopicClouds:
        """Return the checks of one topic for one output; the publishers of a topic share them."""
        return self._topics.setdefault((topic, spec), TopicClouds(topic, spec, self))

    def warn(self, text: str) -> None:
        """Warn immediately, but only once of what concerns several outputs."""
        if text in self.report.warnings:
            return
        self.report.warnings.append(text)
        if self._warn is not None:
            self._warn(text)

    def finish(self) -> None:
        """Judge topics that have fewer clouds than usual."""
        for clouds in self._topics.values():
            clouds.finish()


class TopicClouds:
    """The first clouds of one topic, for one output.

    Attributes
    ----------
    full
        Whether enough clouds have been judged; all threads read it.
    """

    def __init__(self, topic: str, spec: ScanSpec, every: FirstClouds) -> None:
        self.full = False
        self._topic = topic
        self._spec = spec
        self._every = every
        self._checks = CloudChecks(topic, spec)
        self._earliest: list[int] = []
        self._zeros_reported = False

    def may_be_first(self, log_time_ns: int) -> bool:
        """Return whether fewer clouds than are judged were converted from earlier log times; on any thread.

        Threads convert hundreds of small clouds before the first one is written. All clouds that are judged pass,
        whatever the order in which threads convert them: only earlier ones are written before them. If two threads
        change the list at once, it lacks one log time, and more clouds pass.
        """
        earliest = self._earliest
        if len(earliest) == _CLOUDS and earliest[-1] < log_time_ns:
            return False
        self._earliest = sorted([*earliest, log_time_ns])[:_CLOUDS]
        return True

    def sample(self, points: Points, place: Placement) -> SharedSample:
        """Return a sample of a cloud's points; on any thread."""
        return SharedSample(self, sample_of(points, place))

    def add(self, sample: Sample, counts: PointCounts) -> None:
        """Add the next cloud, in the order of writing."""
        if self.full:
            return
        checks = self._checks
        checks.add(sample, counts)
        is_first = len(checks.samples) == 1
        if is_first:
            self._check_target()
        if not self._zeros_reported and (zeros := checks.points_at_sensor(sample, counts, self._source)):
            self._zeros_reported = True
            self._warn(zeros)
        if is_first and checks.is_fine(self._every.static):
            self.full = True
        elif len(checks.samples) == _CLOUDS:
            self.finish()

    def finish(self) -> None:
        """Judge the clouds added so far."""
        if self.full or not self._checks.samples:
            return
        self.full = True
        with np.errstate(all="ignore"):
            if not self._checks.is_fine(self._every.static):
                self._judge()

    @property
    def _source(self) -> str:
        """The frame of the points."""
        return self._every.report.source_frame or self._checks.samples[0].frame_id

    def _warn(self, text: str) -> None:
        self._every.warn(self._spec.label + text)

    def _check_target(self) -> None:
        """Warn if the robot moves in the target frame: the scans are then measured from where the robot is not."""
        target, buffer = self._spec.params.target_frame, self._every.buffer
        if not target or buffer is None or buffer.is_rigid(target, self._source):
            return
        from pc2scan.tf.world_frames import find_body_motion  # noqa: PLC0415  # a lidar is usually rigid on its robot

        moving = find_body_motion(buffer, target, self._source)
        if moving is not None:
            self._warn(
                f"`target_frame` is {target}, in which {moving.body} moves (by {moving.metres:.2f} m): the scans are "
                f"measured from the origin of {target} instead of from the robot, as SLAM and navigation expect; "
                f"`target_frame={shlex.quote(moving.body)}`"
            )

    def _judge(self) -> None:
        every, checks = self._every, self._checks
        found = self._mounting()
        if found.warning:
            every.warn(found.warning)
        if swapped := checks.swapped(every.static):
            self._warn(swapped)
        if units := checks.mistaken_units():
            self._warn(units)
        advice = checks.advice(found, zeros_reported=self._zeros_reported)
        if checks.is_nearly_empty() and (emptiness := checks.emptiness(advice)):
            self._warn(emptiness)
        elif not units and (floor := checks.floor_within_heights(advice)):
            self._warn(floor)
        for entry in every.report.topics:
            if entry.topic == self._topic and entry.spec is self._spec:
                entry.advice = advice
        if advice and checks.lacks_heights():
            every.report.notes.append(
                f"{self._spec.label}{self._topic}: no heights are given, presets leave them to you, and the default "
                f"min_height drops everything at z <= 0; these suit the clouds: {advice}"
            )

    def _mounting(self) -> Mounting:
        """Return how the sensor is mounted; the robot's transforms are only read if it is not level."""
        from pc2scan.tf.mounting import mounting  # noqa: PLC0415  # only where there may be a warning

        every, checks, source = self._every, self._checks, self._source
        first = checks.samples[0]
        # A level first cloud is enough for the mounting and for the heights.
        points = [sample.points for sample in checks.samples[: 1 if checks.level_floor else None]]
        judged_in = first.scan_frame if first.scan_frame != source else ""

        def judged(buffer: TransformBuffer | None) -> Mounting:
            height = first.origin[2]
            return mounting(
                self._topic, source, points, buffer, judged_in=judged_in, origin_z=height, stamp_ns=first.stamp_ns
            )

        found = judged(every.buffer)
        return judged(every.transforms()) if found.fault and every.buffer is None else found

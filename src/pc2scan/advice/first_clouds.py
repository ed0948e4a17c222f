"""Samples the first clouds of a conversion, and runs the checks of them (`advice.checks`).

The threads that convert take a sample of each cloud that may be among the first, until enough samples have been judged.
Samples are judged in the order of writing, so the warnings do not depend on the number of threads. A level floor in the
first cloud ends the check within a millisecond.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.bags.observers import FirstTimes
from pc2scan.core.floor import JUDGED_CLOUDS, CloudSample

from .checks import EACH_CLOUD, FIRST_CLOUDS, FIRST_CLOUDS_NOTES, FRAME, found_by
from .checks.clouds import CloudFacts, KnownTransforms

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.core.points import Points
    from pc2scan.core.rule import PointCounts
    from pc2scan.request.options import ScanSpec
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.placing import Placement

    from .odometry import Surroundings


class SharedSample(NamedTuple):
    """A sample of a cloud, and the clouds that it belongs to."""

    clouds: TopicClouds
    sample: CloudSample


class FirstClouds:
    """The first clouds of every topic that is converted, and what they show.

    Parameters
    ----------
    source_frame, transforms
        See `KnownTransforms`.
    warn
        Called with each warning immediately, so that a user can stop a conversion that makes empty scans, and knows why
        one failed.

    Attributes
    ----------
    transforms
        The transforms that checks may use.
    warnings, notes
        What was found so far, the warnings also by the preparation of the conversion.
    advice
        Options with heights that suit the clouds, by their topic and the output.
    no_returns
        The share of points outside the heights that are no returns, by their topic and the output.
    surroundings
        What is seen where the robot moves most, with the labels of the outputs.
    """

    def __init__(
        self,
        source_frame: str,
        transforms: Callable[[], TransformBuffer | None],
        warn: Callable[[str], None] | None = None,
    ) -> None:
        self.transforms = KnownTransforms(source_frame, transforms)
        self.warnings: list[str] = []
        self.notes: list[str] = []
        self.advice: dict[tuple[str, ScanSpec], str] = {}
        self.no_returns: dict[tuple[str, ScanSpec], float] = {}
        self.surroundings: list[tuple[str, Surroundings]] = []
        self._warn = warn
        self._topics: dict[tuple[str, ScanSpec], TopicClouds] = {}

    def of(self, spec: ScanSpec, topic: str) -> TopicClouds:
        """Return the first clouds of one topic for one output; the publishers of a topic share them."""
        return self._topics.setdefault((topic, spec), TopicClouds(topic, spec, self))

    def warn(self, *texts: str) -> None:
        """Warn immediately, but only once of what concerns several outputs."""
        for text in texts:
            if text not in self.warnings:
                self.warnings.append(text)
                if self._warn is not None:
                    self._warn(text)

    def finish(self) -> None:
        """Judge topics that have fewer clouds than usual, and what was seen where the robot moved most."""
        for clouds in self._topics.values():
            clouds.finish()
        for label, seen in self.surroundings:
            for text in seen.warnings():
                self.warn(label + text)


class TopicClouds:
    """The first clouds of one topic, for one output.

    Attributes
    ----------
    full
        Whether enough clouds have been judged; all threads read it.
    times
        The earliest log times of clouds. Threads convert hundreds of small clouds before the first one is written.
    """

    def __init__(self, topic: str, spec: ScanSpec, every: FirstClouds) -> None:
        self.full = False
        self._topic = topic
        self._spec = spec
        self._every = every
        self._samples: list[CloudSample] = []
        self._counts: list[PointCounts] = []
        self.times = FirstTimes(JUDGED_CLOUDS)

    def sample(self, points: Points, place: Placement, log_time_ns: int | None = None) -> SharedSample | None:
        """Return a sample of a cloud's points; None if its log time is not among the first. On any thread."""
        if log_time_ns is not None and not self.times.may_have(log_time_ns):
            return None
        return SharedSample(self, CloudSample.of(points).placed_in(place.frame_id, place.target_from_source))

    def add(self, sample: CloudSample, counts: PointCounts) -> None:
        """Add the next cloud, in the order of writing."""
        if self.full:
            return
        self._samples.append(sample)
        self._counts.append(counts)
        facts = self._facts()
        for text in found_by(EACH_CLOUD, facts, self._spec.label):
            self._every.warn(text)
        if sample.zeros:
            self._every.no_returns[self._topic, self._spec] = facts.no_returns / max(facts.total.total, 1)
        # A level floor alone is not enough (`are_enough`): heights are judged by the points of all these clouds.
        if len(self._samples) == JUDGED_CLOUDS:
            self.finish()
        elif len(self._samples) == 1 and facts.are_fine:
            self.full = True

    def finish(self) -> None:
        """Judge the clouds added so far."""
        if self.full or not self._samples:
            return
        self.full = True
        facts, every, label = self._facts(), self._every, self._spec.label
        with np.errstate(all="ignore"):
            if facts.are_fine:
                return
            for text in (*found_by(FRAME, facts), *found_by(FIRST_CLOUDS, facts, label)):
                every.warn(text)
            every.advice[self._topic, self._spec] = facts.advice
            every.notes += found_by(FIRST_CLOUDS_NOTES, facts, label)

    def _facts(self) -> CloudFacts:
        return CloudFacts(self._topic, self._spec, self._every.transforms, tuple(self._samples), tuple(self._counts))

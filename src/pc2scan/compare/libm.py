"""Counts the differing beams that another libm explains: exactly from the clouds, or an upper limit from the scans."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from pc2scan.core.compare import differing
from pc2scan.core.rounding import CORRECT, GLIBC, Readings, marks, prove
from pc2scan.errors import MessageError, UsageError
from pc2scan.messages.pointcloud2 import POINTCLOUD2, decode_pointcloud2

from .match import TopicStream, header_stamp_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.core.compare import Tolerance
    from pc2scan.core.rigid import Rigid
    from pc2scan.core.rounding import Proof
    from pc2scan.messages.laserscan import LaserScan
    from pc2scan.messages.pointcloud2 import PointCloud2
    from pc2scan.model import RawMessage

    from .match import OpenRecording
    from .rules import Rules

__all__ = ["CloudsByStamp", "Explainer", "Explanation", "Lookup"]

#: Number of points that are processed at a time, which bounds the memory.
_BLOCK = 65_536
#: Fields that are equal in both messages if their beams are the same.
_ANGLES = ("angle_min", "angle_max", "angle_increment")


class Lookup(Protocol):
    """Looks up transforms."""

    def __call__(self, target: str, source: str, stamp_ns: int, /) -> Rigid:
        """Return the transform of points from ``source`` to ``target``; raise TransformError if there is none."""
        ...


@dataclass(slots=True, eq=False)
class Explanation:
    """The differing ranges of a topic that another libm explains.

    Attributes
    ----------
    cloud_topics, scans, beams
        Topics of the clouds; differing scans with a cloud, and their differing beams.
    a_glibc, b_glibc
        Beams of these that are explained if A has the angles of glibc 2.31 to 2.40 and B correct ones; and if B has
        those of glibc.
    returns, fitting
        Sums of the attributes of `pc2scan.core.rounding.Proof`: returns of A and B, and how many of them are points of
        the clouds with either rounding of angles.
    scans_alone, beams_alone
        Differing scans without a cloud, and their differing beams.
    in_neighbour, hidden
        Beams of these as in `pc2scan.core.rounding.Marks`.
    beams_not_judged
        Differing beams of scans with other angles.
    reasons
        Why scans were not compared with clouds, with the number of scans.
    """

    cloud_topics: set[str] = field(default_factory=set)
    scans: int = 0
    beams: int = 0
    a_glibc: int = 0
    b_glibc: int = 0
    returns: NDArray[np.intp] = field(default_factory=lambda: np.zeros(2, np.intp))
    fitting: NDArray[np.intp] = field(default_factory=lambda: np.zeros((2, 2), np.intp))
    scans_alone: int = 0
    beams_alone: int = 0
    in_neighbour: int = 0
    hidden: int = 0
    beams_not_judged: int = 0
    reasons: Counter[str] = field(default_factory=Counter)

    @property
    def glibc(self) -> str:
        """The side with the angles of glibc 2.31 to 2.40, ``a`` or ``b``; empty if both have the same angles.

        All returns decide, not only differing ones: each scan fits the points best with its own angles.
        """
        # Positive if the side fits glibc's angles better.
        a, b = (self.fitting[:, GLIBC] - self.fitting[:, CORRECT]).tolist()
        if a >= 0 >= b and a > b:
            return "a"
        return "b" if b >= 0 >= a and b > a else ""

    @property
    def explained(self) -> int:
        """Differing beams that the clouds explain."""
        return {"a": self.a_glibc, "b": self.b_glibc, "": 0}[self.glibc]

    def as_dict(self) -> dict[str, object]:
        """Return JSON's types."""
        return {
            "clouds": {
                "topics": sorted(self.cloud_topics),
                "scans": self.scans,
                "beams": self.beams,
                "explained": self.explained,
                "glibc": self.glibc or None,
                **{
                    side: {"returns": int(returns), "fit_glibc": int(fits[GLIBC]), "fit_correct": int(fits[CORRECT])}
                    for side, returns, fits in zip("ab", self.returns, self.fitting, strict=True)
                },
            },
            "scans_alone": {
                "scans": self.scans_alone,
                "beams": self.beams_alone,
                "in_neighbour": self.in_neighbour,
                "hidden": self.hidden,
            },
            "beams_not_judged": self.beams_not_judged,
            "reasons": dict(self.reasons),
        }


class CloudsByStamp:
    """Finds the clouds of recordings by their stamps.

    Parameters
    ----------
    sources
        Open recordings.
    transforms_of
        Reads the transforms of a recording, by its path; called for the first cloud in another frame.
    """

    def __init__(self, sources: Sequence[OpenRecording], transforms_of: Callable[[Path], Lookup]) -> None:
        self._topics: list[_CloudTopic] = []
        for source in sources:
            topics = {c.topic for c in source.connections if c.ros_type == POINTCLOUD2}
            for topic in sorted(topics):
                connections = tuple(c for c in source.connections if c.topic == topic and c.ros_type == POINTCLOUD2)
                self._topics.append(_CloudTopic(TopicStream(source, connections)))
        self._transforms_of = transforms_of
        self._transforms: dict[Path, Lookup] = {}
        self._by_stamp: dict[int, list[tuple[_CloudTopic, _StreamPosition]]] | None = None

    def __bool__(self) -> bool:
        return bool(self._topics)

    def of(self, scan: LaserScan) -> Iterator[tuple[str, Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]]]:
        """Yield clouds with the scan's stamp: the topic, and x and y in the scan's frame, part by part.

        Raises
        ------
        MessageError
            If one cannot be decoded, or there is no transform.
        UsageError
            If several robots have transforms.
        """
        if self._by_stamp is None:
            self._by_stamp = self._find()
        for topic, position in self._by_stamp.get(scan.stamp_ns, ()):
            message = topic.at(position)
            cloud = decode_pointcloud2(message.data, message.connection.serialization)
            yield message.connection.topic, _points(cloud, self._transform(topic.stream.source, cloud, scan))

    def _find(self) -> dict[int, list[tuple[_CloudTopic, _StreamPosition]]]:
        by_stamp: dict[int, list[tuple[_CloudTopic, _StreamPosition]]] = {}
        for topic in self._topics:
            for stamp_ns, position in topic.positions():
                known = by_stamp.setdefault(stamp_ns, [])
                # If both recordings have the clouds, the first recording's are used.
                if not known or known[0][0].stream.source is topic.stream.source:
                    known.append((topic, position))
        return by_stamp

    def _transform(self, source: OpenRecording, cloud: PointCloud2, scan: LaserScan) -> Rigid | None:
        # As in upstream, clouds are transformed only if the names differ.
        if cloud.frame_id.removeprefix("/") == scan.frame_id.removeprefix("/"):
            return None
        lookup = self._transforms.get(source.path)
        if lookup is None:
            lookup = self._transforms[source.path] = self._transforms_of(source.path)
        return lookup(scan.frame_id, cloud.frame_id, cloud.stamp_ns)


class _StreamPosition(NamedTuple):
    """The position of a message in a stream: its number, and its number among those of its log time."""

    number: int
    log_time_ns: int
    repeat: int


class _CloudTopic:
    """The clouds of one topic, read once if they are requested in order."""

    def __init__(self, stream: TopicStream) -> None:
        self.stream = stream
        self._following: Iterator[tuple[int, RawMessage]] = iter(())
        self._next = -1

    def positions(self) -> Iterator[tuple[int, _StreamPosition]]:
        """Yield every cloud's stamp and position."""
        last_ns, repeat = -1, 0
        for number, message in enumerate(self.stream.messages()):
            repeat = repeat + 1 if message.log_time_ns == last_ns else 0
            last_ns = message.log_time_ns
            stamp_ns = header_stamp_ns(message)
            if stamp_ns is not None:
                yield stamp_ns, _StreamPosition(number, last_ns, repeat)

    def at(self, position: _StreamPosition) -> RawMessage:
        """Return a cloud."""
        if self._next < 0:
            self._following, self._next = enumerate(self.stream.messages()), 0
        # Continue to read if possible, because seeking decompresses a chunk again for each cloud in it.
        if position.number >= self._next:
            for number, message in self._following:
                if number == position.number:
                    self._next = number + 1
                    return message
        return self.stream.at(position.log_time_ns, position.repeat)


def _points(cloud: PointCloud2, transform: Rigid | None) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    columns = [column.reshape(-1) for column in cloud.xyz()]
    for start in range(0, columns[0].size, _BLOCK):
        with np.errstate(all="ignore"):
            part = np.stack([column[start : start + _BLOCK].astype(np.float32) for column in columns], axis=1)
            if transform is not None:
                part = transform.apply(part)
        yield part[:, 0], part[:, 1]


class Explainer:
    """Explains pairs of scans of one topic, and sums up.

    Parameters
    ----------
    clouds
        The clouds.
    rules
        The tolerance of ranges.
    """

    def __init__(self, clouds: CloudsByStamp, rules: Rules) -> None:
        self._clouds = clouds
        self._tolerance: Tolerance = rules.tolerance("ranges")
        self.found = Explanation()

    def add(self, a: LaserScan, b: LaserScan) -> None:
        """Add a pair of scans with as many beams on both sides."""
        apart = differing(a.ranges, b.ranges, self._tolerance)
        beams = int(apart.sum())
        if not beams:
            return
        found = self.found
        if elsewhere := [name for name in _ANGLES if getattr(a, name) != getattr(b, name)]:
            found.beams_not_judged += beams
            found.reasons[f"{elsewhere[0]} differs"] += 1
            return
        # Copies, because the scans' bytes may be borrowed from a buffer that reading the cloud overwrites.
        sides = a.ranges.astype(np.float32), b.ranges.astype(np.float32)
        readings = Readings(a.angle_min, a.angle_max, a.angle_increment, a.range_min, a.range_max, *sides, apart)
        proof, topic, reason = self._proof(a, readings)
        if proof is None:
            alone = marks(readings)
            found.scans_alone += 1
            found.beams_alone += beams
            found.in_neighbour += alone.in_neighbour
            found.hidden += alone.hidden
            found.reasons[reason] += 1
            return
        found.cloud_topics.add(topic)
        found.scans += 1
        found.beams += beams
        found.a_glibc += int(proof.a_glibc.sum())
        found.b_glibc += int(proof.b_glibc.sum())
        found.returns += proof.returns
        found.fitting += proof.fitting

    def _proof(self, scan: LaserScan, readings: Readings) -> tuple[Proof | None, str, str]:
        """Return the proof by the cloud that fits best, and its topic; or why there is none."""
        best: tuple[Proof | None, str] = (None, "")
        reason = "there is no cloud with its stamp" if self._clouds else "there are no clouds (`clouds` names some)"
        try:
            for topic, points in self._clouds.of(scan):
                proof = prove(readings, points)
                reason = "its beams are in no known order"
                if proof is not None and (best[0] is None or proof.fitting.sum() > best[0].fitting.sum()):
                    best = (proof, topic)
        except (MessageError, UsageError) as err:
            reason = err.message
        return (*best, reason)

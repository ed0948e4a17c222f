"""Messages of recordings as objects with arrays: what a loop in Python gets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.unproject import UnprojectParams, unproject
from pc2scan.errors import stamp_text, visible

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.messages.pointcloud2 import PointCloud2

#: The smallest of 64 bits is NumPy's "not a time".
_MAX_INT64 = 2**63 - 1


def datetime64(nanoseconds: int) -> np.datetime64:
    """Return nanoseconds since 1970 as ``numpy.datetime64``; ``NaT`` for values beyond 64 bits."""
    return np.datetime64(nanoseconds, "ns") if abs(nanoseconds) <= _MAX_INT64 else np.datetime64("NaT", "ns")


class Message:
    """A message whose times are also NumPy's."""

    __slots__ = ()

    @property
    def stamp(self: Any) -> np.datetime64:
        """``header.stamp`` as ``numpy.datetime64`` in nanoseconds."""
        return datetime64(self.stamp_ns)

    @property
    def log_time(self: Any) -> np.datetime64:
        """The time of recording as ``numpy.datetime64`` in nanoseconds; ``NaT`` if that cannot represent it."""
        return datetime64(self.log_time_ns)


# Not frozen: made for every message, and making a frozen one takes twice as long.
@dataclass(slots=True, eq=False, repr=False)
class Scan(Message):
    """A LaserScan message.

    Attributes
    ----------
    topic
        The topic that it was published on.
    log_time_ns
        The time of recording, nanoseconds since 1970.
    stamp_ns
        ``header.stamp``, nanoseconds since 1970.
    frame
        ``header.frame_id``.
    sequence
        ``header.seq``; 0 from ROS 2.
    angle_min, angle_max, angle_increment
        Radians.
    time_increment, scan_time
        Seconds from one beam to the next, and from one scan to the next.
    range_min, range_max
        Metres.
    ranges
        float32, shape (beams,), metres.
    intensities
        float32, shape (beams,), or (0,) for a scan without any.
    """

    topic: str
    log_time_ns: int
    stamp_ns: int
    frame: str
    sequence: int
    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    ranges: NDArray[np.float32]
    intensities: NDArray[np.float32]

    @property
    def angles(self) -> NDArray[np.float64]:
        """The direction of each beam, shape (beams,), radians: ``angle_min + i * angle_increment``."""
        angles: NDArray[np.float64] = self.angle_min + np.arange(len(self.ranges)) * np.float64(self.angle_increment)
        return angles

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which beams have a return, shape (beams,): ``range_min <= range < range_max``, which NaN and inf are not."""
        with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
            valid: NDArray[np.bool_] = (self.ranges >= np.float64(self.range_min)) & (
                self.ranges < np.float64(self.range_max)
            )
        return valid & np.isfinite(self.ranges)

    def xy(self) -> NDArray[np.float32]:
        """The points of the beams that have a return, as laser_geometry computes them.

        Returns
        -------
        numpy.ndarray
            float32, shape (returns, 2), metres in `frame`, in the order of the beams: those of `valid`.

        Raises
        ------
        DecodeError
            If the angles are not finite.
        """
        points = unproject(
            self.ranges,
            np.empty(0, np.float32),
            angle_min=self.angle_min,
            angle_increment=self.angle_increment,
            range_min=self.range_min,
            range_max=self.range_max,
            params=UnprojectParams(index=False),
        )
        return points.xyz[np.isfinite(self.ranges[points.beams]), :2].copy()

    def __repr__(self) -> str:
        returns = np.count_nonzero(self.valid)
        return (
            f"<Scan on {visible(self.topic)} at {stamp_text(self.stamp_ns)} in {self.frame!r}: "
            f"{len(self.ranges)} beams, {returns} with a return>"
        )


# Not frozen: see `Scan`.
@dataclass(slots=True, eq=False, repr=False)
class Cloud(Message):
    """A message that is a cloud. ``cloud["intensity"]`` is a field of all points.

    Attributes
    ----------
    topic
        The topic that it was published on.
    log_time_ns
        The time of recording, nanoseconds since 1970.
    """

    topic: str
    log_time_ns: int
    _message: PointCloud2

    @property
    def stamp_ns(self) -> int:
        """``header.stamp``, nanoseconds since 1970."""
        return self._message.stamp_ns

    @property
    def frame(self) -> str:
        """``header.frame_id``."""
        return self._message.frame_id

    @property
    def sequence(self) -> int:
        """``header.seq``; 0 from ROS 2."""
        return self._message.sequence

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width; the height of a cloud that is not organised is 1."""
        return self._message.height, self._message.width

    @property
    def is_dense(self) -> bool:
        """Whether the publisher declares that no point is NaN (``is_dense``)."""
        return self._message.is_dense

    @property
    def fields(self) -> tuple[str, ...]:
        """The names of the fields, in the message's order."""
        return tuple(field.name for field in self._message.fields)

    def __len__(self) -> int:
        """Return the number of points, including NaN and (0, 0, 0)."""
        return self._message.points

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a field of all points.

        Parameters
        ----------
        name
            One of `fields`.

        Returns
        -------
        numpy.ndarray
            Shape (points,), in the recorded type; a copy. Only the first element of a field with several.

        Raises
        ------
        KeyError
            If there is no such field.
        DecodeError
            If the message contradicts itself: a field outside the points, or fewer bytes than declared.
        """
        if name not in self.fields:
            raise KeyError(f"{name!r}: the cloud's fields are {', '.join(self.fields) or 'none'}")
        values = self._message.field(name)
        return values.astype(values.dtype.newbyteorder("=")).ravel()

    def keys(self) -> tuple[str, ...]:
        """Return the names of the fields, so that a cloud is accepted wherever a mapping of fields is."""
        return self.fields

    def xyz(self) -> NDArray[np.floating[Any]]:
        """The coordinates of all points.

        Returns
        -------
        numpy.ndarray
            Shape (points, 3), metres in `frame`: float32, or float64 where a coordinate needs it. A copy, in the order
            of the fields; NaN is kept.

        Raises
        ------
        DecodeError
            If the cloud has no x, y or z, or contradicts itself.
        """
        columns = self._message.xyz()
        dtype = np.result_type(np.float32, *(column.dtype for column in columns))
        points = np.empty((len(self), 3), dtype)
        with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
            for index, column in enumerate(columns):
                points[:, index] = column.ravel()
        return points

    def points(self) -> NDArray[Any]:
        """All fields of all points.

        Returns
        -------
        numpy.ndarray
            Structured, shape (points,), little-endian and without padding: a copy, in the order of the points. A field
            with several elements is an array in each point.

        Raises
        ------
        DecodeError
            If two fields have one name, or the message contradicts itself.
        """
        return self._message.structured_points()

    def __reduce__(self) -> tuple[Any, ...]:
        # Pickles the bytes, because a view cannot be pickled.
        data: Any = bytes(self._message.data)
        return _restore, (self.topic, self.log_time_ns, replace(self._message, data=data))

    def __repr__(self) -> str:
        return (
            f"<Cloud on {visible(self.topic)} at {stamp_text(self.stamp_ns)} in {self.frame!r}: "
            f"{len(self):,} points of {', '.join(map(visible, self.fields))}>"
        )


def _restore(topic: str, log_time_ns: int, message: PointCloud2) -> Cloud:
    message.data = memoryview(message.data)
    return Cloud(topic, log_time_ns, message)

"""Clouds of recordings as objects with arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.errors import stamp_text, visible
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.messages.pointcloud2 import recorded_cloud
from pc2scan.model import own_data

from .stream import Message, Stream, StreamSource

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import ExitStack

    from numpy.typing import NDArray

    from pc2scan.bags.reader import Reader
    from pc2scan.messages.pointcloud2 import PointCloud2
    from pc2scan.model import Buffer, Connection


# Not frozen: made for every message, and making a frozen one takes twice as long.
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


class Clouds(Stream[Cloud]):
    """The clouds of a recording, read as they are iterated over; `pc2scan.clouds` makes it.

    The recording is opened immediately, so that a wrong request raises here and not in the loop.
    Each loop reads from the beginning. The files are closed when the loop ends or is left, or with `close` or a
    ``with`` statement.

    Attributes
    ----------
    topics
        The topics of the clouds.
    damage
        The damage that the last loop found.
    skipped, skipped_count
        Messages that the last loop could not use: the first hundred, and how many.
    """

    def _source(self, stack: ExitStack, reader: Reader) -> StreamSource:
        return self._recorded(
            stack, reader, CLOUDS, ((LASERSCAN,), "it has LaserScan topics: pc2scan.scans() reads these"), _decoder
        )

    def _object(self, topic: str, log_time_ns: int, message: PointCloud2) -> Cloud:
        return Cloud(topic, log_time_ns, message)


def _decoder(connection: Connection) -> Callable[[Buffer], PointCloud2]:
    """Return the decoder of clouds that do not keep more than their message in memory."""
    decode = CLOUDS[connection.ros_type](connection.serialization)
    return lambda data: recorded_cloud(decode(own_data(data)))

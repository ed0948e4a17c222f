"""Reads the messages of an IMU, and estimates the direction of up from them."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.bags.observers import Observer
from pc2scan.bags.topics import find_topic, types_by_topic
from pc2scan.core.gravity import TIME_CONSTANT, up_by_gravity, up_in
from pc2scan.core.percentiles import median
from pc2scan.core.sharpness import roughness
from pc2scan.errors import DecodeError, TopicError, UsageError, name_list
from pc2scan.messages.imu import IMU, decode_imu
from pc2scan.model import copied_message
from pc2scan.text import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pc2scan.bags.reader import Reader
    from pc2scan.model import RawMessage

    from .buffer import TransformBuffer


#: The standard acceleration of gravity, m/s^2, and the largest deviation of an accelerometer at rest, as a share.
GRAVITY = 9.80665
_GRAVITY_TOLERANCE = 0.15

#: If the median angle between up by orientation and by the accelerometer exceeds this, degrees, one of them is wrong.
_MAX_DISAGREEMENT = 20.0

#: Up that jitters by more than this, degrees, moves walls 10 m away by 9 cm.
_LARGEST_JITTER = 0.5

#: The largest values of an IMU: radians per second, m/s^2, or thousandths of g.
_MAX_VALUE = 1e5

_UNKNOWN = (math.nan, math.nan, math.nan)


class ImuRequest(NamedTuple):
    """The IMU that a user gives: its topic, and its frame if the messages' own is wrong or empty."""

    topic: str
    frame: str = ""

    @classmethod
    def parse(cls, text: str) -> ImuRequest:
        """Read ``TOPIC`` or ``TOPIC:FRAME``.

        Raises
        ------
        UsageError
            If a side of the colon is empty.
        """
        topic, colon, frame = text.partition(":")
        if not topic or (colon and not frame):
            raise UsageError(
                f"`imu` is {text!r}, it must be a topic, or a topic and a frame",
                hint="write `imu=/imu/data` or `imu=/imu/data:imu_link`",
            )
        return cls(topic, frame)


@dataclass(frozen=True, slots=True, eq=False)
class UpEstimate:
    """The direction of up, by the messages of an IMU.

    Attributes
    ----------
    topic, frame
        Topic and frame of the IMU.
    stamps_ns
        (N,) increasing.
    directions
        (N, 3) directions of unit length in its frame.
    notes, warnings
        Texts for the user.
    is_felt
        Whether it is estimated by the accelerometer, which also feels curves.
    """

    topic: str
    frame: str
    stamps_ns: NDArray[np.int64]
    directions: NDArray[np.float64]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    is_felt: bool = False

    def z_of(self, frame: str, buffer: TransformBuffer | None) -> float:
        """Return how much the z axis of a frame points up, -1 to 1; 0 if none is known to turn with the IMU."""
        own, other = self.frame.removeprefix("/"), frame.removeprefix("/")
        if own == other:
            return float(self.directions[:, 2].mean())
        rigid = buffer.known(own, other, 0) if buffer is not None and buffer.is_rigid(own, other) else None
        return 0.0 if rigid is None else float((self.directions @ rigid.matrix[:, 2]).mean())


class ImuReading:
    """The messages of an IMU in recordings, while these are read.

    Parameters
    ----------
    readers
        The sources first, then the recordings of ``tf_from``.
    requested
        The topic.
    most
        How many of the first messages of each recording are wanted; None: all.

    Raises
    ------
    TopicError
        If there is no such topic.
    """

    def __init__(self, readers: Sequence[Reader], requested: str, most: int | None = None) -> None:
        types = types_by_topic(connection for reader in readers for connection in reader.connections)
        candidates = sorted(topic for topic, kinds in types.items() if IMU in kinds)
        self._topic = find_topic(requested, types, candidates, IMU)
        self._most = most
        self._stamps_ns = array("q")
        #: Nine numbers a message: up by its orientation, rates, and accelerations; NaN where a value is missing.
        self._values = array("d")
        self._frames: dict[str, None] = {}
        self._undecoded: list[str] = []

    def observers(self, reader: Reader) -> list[Observer[RawMessage]]:
        """Return the observer of a recording; none if it does not have the topic."""
        connections = [c for c in reader.connections if c.topic == self._topic and c.ros_type == IMU and c.ros_version]
        return [Observer(connections, copied_message, self._most, keep=self._add)] if connections else []

    def _add(self, message: RawMessage) -> None:
        """Add the values of a message, or count it if it cannot be decoded."""
        try:
            imu = decode_imu(message.data, message.connection.serialization)
        except DecodeError as err:
            self._undecoded.append(err.message)
            return
        self._frames[imu.frame_id] = None
        self._stamps_ns.append(imu.stamp_ns)
        self._values.extend(_UNKNOWN if imu.orientation is None else up_in(imu.orientation))
        self._values.extend(_plausible(imu.angular_velocity))
        self._values.extend(_plausible(imu.linear_acceleration))

    def up(self, frame: str = "") -> UpEstimate:
        """Estimate the direction of up.

        Parameters
        ----------
        frame
            The frame of the IMU; empty: that of its messages.

        Raises
        ------
        TopicError
            If there are no messages.
        UsageError
            If they do not show the direction of up.
        """
        topic, warnings = self._topic, list[str]()
        if self._undecoded:
            number = counted(len(self._undecoded), "message")
            warnings.append(f"{topic}: {number} cannot be decoded: {self._undecoded[0]}")
        if not self._stamps_ns:
            message = "; ".join((f"there are no messages on {topic}", *warnings))
            raise TopicError(message, hint="give another topic to `imu`, or `fixed_frame`")
        frame = frame or _only_frame(topic, self._frames)
        stamps, order = np.unique(np.array(self._stamps_ns, np.int64), return_index=True)
        values = np.array(self._values, np.float64).reshape(-1, 9)[order]
        known, ups, note, further = _estimate_up(topic, stamps, values[:, :3], values[:, 3:6], values[:, 6:])
        is_felt = not np.array_equal(ups, values[known, :3])
        return UpEstimate(topic, frame, stamps[known], ups, (note,), (*warnings, *further), is_felt)


def _plausible(values: tuple[float, ...] | None) -> tuple[float, ...]:
    return _UNKNOWN if values is None or max(map(abs, values)) > _MAX_VALUE else values


def _only_frame(topic: str, frames: dict[str, None]) -> str:
    names = sorted({name.removeprefix("/") for name in frames})
    if len(names) > 1 or not names[0]:
        shown = name_list([name or "none" for name in names])
        message = f"the messages on {topic} do not have one frame_id, but {shown}"
        raise UsageError(message, hint=f"give it: `imu={topic}:{names[-1] or 'imu_link'}`")
    return names[0]


def _estimate_up(
    topic: str,
    stamps_ns: NDArray[np.int64],
    directions: NDArray[np.float64],
    turning: NDArray[np.float64],
    acceleration: NDArray[np.float64],
) -> tuple[NDArray[np.intp], NDArray[np.float64], str, list[str]]:
    """Return which messages show the direction of up, the directions, a note, and warnings."""
    oriented = ~np.isnan(directions[:, 0])
    felt = ~np.isnan(turning[:, 0]) & ~np.isnan(acceleration[:, 0])
    gravity, fault = _gravity(acceleration[felt])
    if not fault and not turning[felt].any():
        fault = "the gyroscope always shows 0"
    known = np.flatnonzero(oriented)
    number = f"{len(known):,} of {len(directions):,} have" if len(known) else "none has"
    why = f"{number} a valid orientation"
    if len(known) > 1 and not fault and (directions[known] == directions[known[0]]).all():
        why = "its orientation never changes"
    elif 2 * len(known) >= len(directions):
        both = oriented & felt
        warnings = [] if fault else _disagreement(topic, directions[both], acceleration[both])
        off = float(np.degrees(np.linalg.norm(roughness(stamps_ns[known], directions[known]))))
        warnings += _weaknesses(topic, off, len(directions) - len(known), "no valid orientation")
        note = f"{topic}: up is computed from the orientations of {len(known):,} messages"
        return known, directions[known], note, warnings
    if fault:
        raise UsageError(
            f"the messages on {topic} do not show the direction of up: {why}, and {fault}",
            hint="give another topic to `imu`, or level by transforms: `fixed_frame=odom`",
        )
    known = np.flatnonzero(felt)
    interval = median(np.diff(stamps_ns[known])) / 1e9 if len(known) > 1 else 0.0
    rough = float(roughness(stamps_ns[known], turning[known]).max())
    off = math.degrees(rough * math.sqrt(interval * TIME_CONSTANT))
    unit = " (in units of g)" if gravity < 2 else ""
    note = f"{topic}: up is estimated from gyroscope and accelerometer{unit} of {len(known):,} messages: {why}"
    ups = up_by_gravity(stamps_ns[known], turning[known], acceleration[known], gravity)
    return known, ups, note, _weaknesses(topic, off, len(directions) - len(known), "no rates or accelerations")


def _weaknesses(topic: str, off: float, missing: int, what: str) -> list[str]:
    """Return warnings about directions that are off by some degrees, and about messages that lack what is needed."""
    warnings = []
    if off > _LARGEST_JITTER:
        warnings.append(
            f"{topic}: up is off by about {off:.2g} degrees, as with an IMU that vibrates, and so are level scans; "
            "`fixed_frame` levels by transforms instead"
        )
    if missing:
        warnings.append(f"{topic}: {counted(missing, 'message')} ignored: {what}")
    return warnings


def _gravity(acceleration: NDArray[np.float64]) -> tuple[float, str]:
    """Return the length of the acceleration at rest, in its own unit; or why it is not usable."""
    if not len(acceleration):
        return 0.0, "none has both an angular velocity and an acceleration"
    length = median(np.sqrt(np.square(acceleration).sum(axis=1)))
    if any(abs(length / expected - 1) < _GRAVITY_TOLERANCE for expected in (GRAVITY, 1.0)):
        return length, ""
    return 0.0, f"the median of the accelerometer is {length:.3g} m/s^2, gravity is {GRAVITY:.4g} m/s^2"


def _disagreement(topic: str, directions: NDArray[np.float64], acceleration: NDArray[np.float64]) -> list[str]:
    """Return a warning if up by orientations differs from up by the accelerometer."""
    with np.errstate(all="ignore"):
        cosines = np.einsum("ni,ni->n", directions, acceleration) / np.sqrt(np.square(acceleration).sum(axis=1))
    known = cosines[np.isfinite(cosines)]
    angle = math.degrees(math.acos(max(-1.0, min(1.0, median(known))))) if known.size else 0.0
    if angle < _MAX_DISAGREEMENT:
        return []
    what = f"{topic}: up by its orientations is {angle:.0f} degrees from up by its accelerometer (median)"
    return [f"{what}: orientations must refer to a world whose z is up, and an accelerometer at rest must point up"]

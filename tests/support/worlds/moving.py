"""A simulated robot that drives, turns and tilts in a room, with lidars whose every return is exact.

The room has four walls and a floor. Each return is measured from where its sensor is at that moment. So whoever places
all returns rightly finds each of them on the wall that it hit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pc2scan.core.rigid import Rigid
from pc2scan.messages.laserscan import LaserScan, encode_laserscan
from pc2scan.messages.tfmessage import encode_transforms
from support.builders import CLOUD, IMU, SCAN, TF, imu_message
from support.clouds import structured
from support.containers import write_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

#: The time 0 of the world, nanoseconds.
BEGIN_NS = 1_700_000_000_000_000_000

#: The walls: an axis of odom (0 is x), and where on it the wall is, metres. The floor is z = 0.
WALLS = ((0, -5.0), (0, 7.0), (1, -6.0), (1, 6.0))


@dataclass(frozen=True, slots=True)
class Drive:
    """How the robot moves; the defaults are those of a turning lidar that distorts visibly.

    Attributes
    ----------
    speed, turn
        Metres and radians a second: a circle, from the origin along x.
    tilt, tilt_hz
        Roll and pitch, radians at most, and how often in a second they come back.
    """

    speed: float = 1.5
    turn: float = 1.0
    tilt: float = 0.0
    tilt_hz: float = 1.3

    def angles(self, times: Floats) -> tuple[Floats, Floats, Floats]:
        """Roll, pitch and yaw at some times, radians."""
        phase = 2 * math.pi * self.tilt_hz * times
        return self.tilt * np.sin(phase), self.tilt * np.cos(phase), self.turn * times

    def rotations(self, times: Floats) -> Floats:
        """odom_from_base_link, (N, 3, 3)."""
        roll, pitch, yaw = self.angles(times)
        (sr, cr), (sp, cp), (sy, cy) = ((np.sin(angle), np.cos(angle)) for angle in (roll, pitch, yaw))
        rows = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
        return np.moveaxis(np.array(rows), -1, 0)

    def positions(self, times: Floats) -> Floats:
        """Where base_link is in odom, (N, 3)."""
        if self.turn:
            radius = self.speed / self.turn
            return np.stack(
                [radius * np.sin(self.turn * times), radius * (1 - np.cos(self.turn * times)), 0 * times], axis=1
            )
        return np.stack([self.speed * times, 0 * times, 0 * times], axis=1)

    def pose(self, time: float) -> Rigid:
        """odom_from_base_link at one time."""
        at = np.array([time])
        roll, pitch, yaw = (float(angle[0]) for angle in self.angles(at))
        x, y, z = self.positions(at)[0].tolist()
        return Rigid.from_rpy(roll, pitch, yaw, (x, y, z))


@dataclass(frozen=True, slots=True)
class Lidar:
    """A sensor on the robot.

    Attributes
    ----------
    topic, frame
        Where its messages are, and their frame.
    mount
        base_link_from_frame.
    kind
        ``turning``: a cloud for each turn. ``packets``: a cloud for each tenth of a turn. ``rosette``: a cloud for each
        period, of a pattern that does not come back. ``flat``: a LaserScan for each turn, whose number of beams varies.
    period
        Seconds for a turn.
    phase
        When its first turn begins, seconds.
    clock
        Seconds by which its clock is ahead.
    columns
        Directions in a turn.
    elevations
        Of the rings, degrees.
    latency
        Seconds from the end of a measurement to its log time.
    jitter
        Seconds that log times are off at most.
    time_scale
        Of the times that are written, for those in another unit.
    points_clock
        Seconds by which the points' own clock is ahead: they have absolute times then.
    """

    topic: str = "/points"
    frame: str = "lidar"
    mount: Rigid = field(default_factory=lambda: Rigid.from_rpy(0.0, 0.0, 0.0, (0.2, 0.0, 0.5)))
    kind: str = "turning"
    period: float = 0.1
    phase: float = 0.0
    clock: float = 0.0
    columns: int = 1800
    elevations: tuple[float, ...] = (-15.0, -5.0, 0.0, 1.0, 5.0)
    latency: float = 0.002
    jitter: float = 0.0
    time_scale: float = 1.0
    points_clock: float | None = None

    def sweeps(self, seconds: float) -> Iterator[tuple[float, Floats, Floats]]:
        """When each message begins, the times of its rays after that, and their directions (N, 3)."""
        count = math.floor((seconds - self.phase) / self.period + 1e-9)
        for number in range(count):
            begin = self.phase + number * self.period
            if self.kind == "rosette":
                times = np.linspace(0.0, self.period, self.columns, endpoint=False, dtype=np.float64)
                angle = 2 * math.pi * (begin + times)
                off = np.radians(70) * np.sin(17.3 * angle)
                yield begin, times, _directions(off * np.cos(3.1 * angle), 0.25 * off * np.sin(3.1 * angle))
            elif self.kind == "flat":
                columns = self.columns + (7 * number) % 5 - 2
                azimuth = -math.pi + np.arange(columns) * (2 * math.pi / columns)
                times = np.linspace(0.0, self.period, columns, endpoint=False, dtype=np.float64)
                yield begin, times, _directions(azimuth, 0 * azimuth)
            else:
                column = np.repeat(np.arange(self.columns), len(self.elevations))
                times = (column * (self.period / self.columns)).astype(np.float64)
                elevation = np.tile(np.radians(self.elevations), self.columns)
                directions = _directions(-math.pi + column * (2 * math.pi / self.columns), elevation)
                parts = 10 if self.kind == "packets" else 1
                for times_of, rays in zip(np.split(times, parts), np.split(directions, parts), strict=True):
                    yield begin + times_of[0], times_of - times_of[0], rays


class Message(NamedTuple):
    """A message of a sensor: when it was logged and stamped, nanoseconds, and itself."""

    log_time_ns: int
    stamp_ns: int
    data: bytes


def _directions(azimuth: NDArray[np.floating[Any]], elevation: NDArray[np.floating[Any]]) -> Floats:
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1).astype(np.float64)


def measured(drive: Drive, lidar: Lidar, times: Floats, directions: Floats) -> Floats:
    """Distances to what rays hit, each at its own time."""
    base, positions = drive.rotations(times), drive.positions(times)
    origins = positions + base @ lidar.mount.translation
    rays = np.einsum("nij,jk,nk->ni", base, lidar.mount.matrix, directions)
    nearest = np.full(len(rays), np.inf)
    for axis, wall in (*WALLS, (2, 0.0)):
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (wall - origins[:, axis]) / rays[:, axis]
        nearest = np.where((distance > 0) & (distance < nearest), distance, nearest)
    return nearest


@lru_cache(maxsize=8)
def messages(drive: Drive, lidar: Lidar, seconds: float) -> tuple[Message, ...]:
    """Everything that a lidar measures, as serialised messages; remembered, since drives differ in their odometry."""
    random = np.random.default_rng(7)
    found = []
    for begin, times, directions in lidar.sweeps(seconds):
        distances = measured(drive, lidar, begin + times, directions)
        stamp_ns = BEGIN_NS + round((begin + lidar.clock) * 1e9)
        late = times[-1] + lidar.latency + lidar.jitter * random.uniform()
        log_time_ns = BEGIN_NS + round((begin + late) * 1e9)
        if lidar.kind == "flat":
            data = _scan(lidar, stamp_ns, distances)
        else:
            data = _cloud(lidar, stamp_ns, times, directions, distances)
        found.append(Message(log_time_ns, stamp_ns, data))
    return tuple(found)


def _scan(lidar: Lidar, stamp_ns: int, distances: Floats) -> bytes:
    count = len(distances)
    step = 2 * math.pi / count
    # Intensities tell in which quarter of a turn a beam is.
    lit = (np.arange(count) * 4 // count * 10 + 10).astype(np.float32)
    last = -math.pi + (count - 1) * step
    scan = LaserScan(
        0, stamp_ns, lidar.frame, -math.pi, last, step, lidar.time_scale * lidar.period / count, lidar.period,
        0.05, 40.0, distances.astype(np.float32), lit,
    )  # fmt: skip
    return encode_laserscan(scan, "cdr")


def _cloud(lidar: Lidar, stamp_ns: int, times: Floats, directions: Floats, distances: Floats) -> bytes:
    # A field with the points' times.
    name, kind = ("t", "<u4") if lidar.points_clock is None else ("timestamp", "<f8")
    points = np.empty(len(times), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), (name, kind)])
    with np.errstate(invalid="ignore"):
        for axis, values in zip("xyz", (directions * distances[:, np.newaxis]).T, strict=True):
            points[axis] = np.where(np.isfinite(distances), values, np.nan)
    points["intensity"] = np.where(np.isfinite(distances), 50, 0)
    if lidar.points_clock is None:
        points[name] = np.round(times * 1e9 * lidar.time_scale)
    else:
        points[name] = stamp_ns / 1e9 + lidar.points_clock + times
    return structured(points, 2, stamp_ns=stamp_ns, frame_id=lidar.frame)


def write_world(
    path: Path,
    lidars: Sequence[Lidar] = (Lidar(),),
    drive: Drive = Drive(),
    *,
    seconds: float = 2.0,
    odometry_hz: float = 100.0,
    odometry: Callable[[float], Rigid] | None = None,
    frames: Callable[[str], str] = str,
    pair: tuple[str, str] = ("odom", "base_link"),
    known: tuple[float, float] | None = None,
    compression: str | None = None,
) -> Path:
    """Write an MCAP file of what lidars measure while the robot drives, with the transforms odom, base_link, lidars.

    ``odometry`` is odom_from_base_link at a time, if not the robot's pose, ``frames`` the names that frames have in the
    transforms, ``pair`` the parent and the child of the robot's poses. Transforms of the robot are ``known`` from 0.4 s
    before the clouds to 0.5 s after them, if not at other times.
    """
    odometry = odometry or drive.pose
    first, last = known or (-0.4, seconds + 0.5)
    rows: list[tuple[int, str, bytes]] = []
    static = [(frames("base_link"), frames(lidar.frame), BEGIN_NS, *lidar.mount.pose) for lidar in lidars]
    rows.append((BEGIN_NS - 500_000_000, "/tf_static", encode_transforms(static, "cdr")))
    for number in range(round(first * odometry_hz), round(last * odometry_hz)):
        time = number / odometry_hz
        stamp_ns = BEGIN_NS + round(time * 1e9)
        pose = odometry(time).pose
        moved = encode_transforms([(frames(pair[0]), frames(pair[1]), stamp_ns, *pose)], "cdr")
        rows.append((stamp_ns, "/tf", moved))
    types = {"/tf_static": TF, "/tf": TF}
    for lidar in lidars:
        types[lidar.topic] = SCAN if lidar.kind == "flat" else CLOUD
        rows += ((message.log_time_ns, lidar.topic, message.data) for message in messages(drive, lidar, seconds))
    return write_rows(path, types, sorted(rows), compression)


def write_imu(
    path: Path,
    drive: Drive,
    mount: Rigid,
    seconds: float = 2.0,
    *,
    orientation: bool = False,
    clock_ns: int = 0,
    gap: float = 0.0,
    vibration: float = 0.0,
    first: float = -20.0,
) -> Path:
    """Write an MCAP file of what an IMU measures, at 100 Hz from the ``first`` second on, with a bias.

    ``mount`` is base_link_from_imu_link. For ``gap`` seconds in the middle it is silent. Its gyroscope is off by
    ``vibration`` (standard deviation, radians a second).
    """
    rows = []
    times = np.arange(first, seconds + 0.4, 0.01)
    times = times[np.abs(times - seconds / 2) >= gap / 2]
    ends = [drive.rotations(times + off) for off in (-5e-5, 5e-5)]
    rates = mount.matrix.T @ (np.einsum("nji,njk->nik", ends[0], ends[1]) - np.eye(3)) @ mount.matrix / 1e-4
    velocities = [(drive.positions(times + off) - drive.positions(times + off - 1e-3)) / 1e-3 for off in (0, 1e-3)]
    shaken = np.random.default_rng(9).normal(0, vibration, (len(times), 3))
    felt = (velocities[1] - velocities[0]) / 1e-3 + (0.0, 0.0, 9.81)
    attitudes = drive.rotations(times) @ mount.matrix
    for place, time in enumerate(times.tolist()):
        log_time_ns = BEGIN_NS + round(time * 1e9)
        rate = rates[place]
        data = imu_message(
            2,
            orientation=drive.pose(time).compose(mount).quaternion.tolist() if orientation else (0, 0, 0, 0),
            first=(0.0, 0.0, 0.0),
            turning=(shaken[place] + (rate[2, 1] + 0.02, rate[0, 2] - 0.02, rate[1, 0])).tolist(),
            acceleration=attitudes[place].T @ felt[place],
            stamp_ns=log_time_ns + clock_ns,
        )
        rows.append((log_time_ns, "/imu", data))
    return write_rows(path, {"/imu": IMU}, rows)


def returns_in_odom(scan: LaserScan, drive: Drive, mount: Rigid | None = None) -> Floats:
    """Return where the returns of a scan are in odom, (N, 2), as its header says.

    ``mount`` is base_link_from_frame of the scan's frame; None: it is in base_link.
    """
    time = (scan.stamp_ns - BEGIN_NS) / 1e9
    place = drive.pose(time) if mount is None else drive.pose(time).compose(mount)
    seen = np.flatnonzero(np.isfinite(scan.ranges))
    angles = scan.angle_min + seen * scan.angle_increment
    ranges = scan.ranges[seen].astype(np.float64)
    flat = np.stack([ranges * np.cos(angles), ranges * np.sin(angles), 0 * ranges], axis=1)
    placed: Floats = place.apply(flat)[:, :2]
    return placed


def off_the_walls(points: Floats) -> Floats:
    """How far points are from the nearest wall, metres."""
    distances = [np.abs(points[:, axis] - wall) for axis, wall in WALLS]
    nearest: Floats = np.min(distances, axis=0)
    return nearest

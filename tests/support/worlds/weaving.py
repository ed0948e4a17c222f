"""A simulated robot that weaves, and odometry of it that is not as it should be: late, rough, with another scale."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.rigid import Rigid
from support.worlds.moving import Drive, Lidar, write_world

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Weaving(Drive):
    """A robot that turns to and fro by 0.8 rad, every 2.5 s, on its way through the room."""

    def angles(self, times: Floats) -> tuple[Floats, Floats, Floats]:
        """Roll, pitch and yaw; see `Drive`."""
        phase = 2 * math.pi * self.tilt_hz * times
        yaw = 0.8 * np.sin(2 * math.pi * 0.4 * times)
        return self.tilt * np.sin(phase), self.tilt * np.cos(phase), yaw

    def positions(self, times: Floats) -> Floats:
        """Where base_link is in odom; see `Drive`."""
        return np.stack([0.8 * np.sin(0.8 * times), 0.5 * np.cos(0.5 * times), 0 * times], axis=1)


class Winding(Drive):
    """A robot on wheels, which drives ahead and turns to and fro by 1.2 rad."""

    def angles(self, times: Floats) -> tuple[Floats, Floats, Floats]:
        """Roll, pitch and yaw; see `Drive`."""
        return 0 * times, 0 * times, 1.2 * np.sin(2 * math.pi * 0.4 * times)

    def positions(self, times: Floats) -> Floats:
        """Where base_link is in odom; see `Drive`."""
        nodes = np.arange(-1.0, 5.0, 0.001)
        yaw = self.angles(nodes)[2]
        ways = (np.cumsum(self.speed * 0.001 * each) for each in (np.cos(yaw), np.sin(yaw)))
        return np.stack([*(np.interp(times, nodes, way) for way in ways), 0 * times], axis=1)


#: A lidar with sixteen rings, and one that looks to the rear.
RINGS = Lidar(elevations=tuple(np.linspace(-15, 15, 16).tolist()), columns=400)
REAR = replace(RINGS, topic="/rear", frame="rear", mount=Rigid.from_rpy(0.0, 0.0, math.pi, (-0.3, 0.0, 0.5)))


class Fault(NamedTuple):
    """What is wrong with odometry.

    Attributes
    ----------
    late
        Seconds by which its poses are older than their stamps.
    metres, degrees
        The standard deviations of its noise.
    scale
        The share of the yaw that it measures.
    pair
        The parent and the child of its transforms.
    inverted
        Whether its poses are those of odom in base_link.
    """

    late: float = 0.0
    metres: float = 0.0
    degrees: float = 0.0
    scale: float = 1.0
    pair: tuple[str, str] = ("odom", "base_link")
    inverted: bool = False


_SOUND = Fault()
_WEAVING = Weaving()


def write_weaving(
    path: Path,
    lidars: Sequence[Lidar] | None = None,
    fault: Fault = _SOUND,
    drive: Drive = _WEAVING,
    *,
    frames: Callable[[str], str] = str,
) -> Path:
    """Write three seconds of a robot that drives, with odometry that has a fault."""

    def odometry(time: float) -> Rigid:
        at = np.array([time - fault.late])
        roll, pitch, yaw = (float(angle[0]) for angle in drive.angles(at))
        noise = np.random.default_rng(round((time + 10) * 1e6)).normal(0, 1, 3) if fault.metres else np.zeros(3)
        dx, dy, turned = (noise * (fault.metres, fault.metres, math.radians(fault.degrees))).tolist()
        x, y, _ = drive.positions(at)[0].tolist()
        pose = Rigid.from_rpy(roll, pitch, fault.scale * yaw + turned, (x + dx, y + dy, 0.0))
        return pose.inverse() if fault.inverted else pose

    return write_world(path, lidars or [RINGS], drive, seconds=3.0, odometry=odometry, frames=frames, pair=fault.pair)

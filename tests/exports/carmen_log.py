"""A reader of CARMEN's log files, written after the published rules alone (logger_playback.html of CARMEN's manual).

One message a line: its name, its content, ``ipc_timestamp ipc_hostname logger_timestamp``. A scan's beams: the first at
``start_angle``, each ``angular_resolution`` from the next; of FLASER, what CARMEN guesses for a SICK laser.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


@dataclass
class Message:
    name: str
    words: list[str]

    def number(self) -> float:
        return float(self.words.pop(0))

    def numbers(self, count: int) -> list[float]:
        return [self.number() for _ in range(count)]

    def counted(self) -> list[float]:
        return self.numbers(int(self.words.pop(0)))


@dataclass
class Reading:
    start_angle: float
    resolution: float
    maximum: float
    ranges: list[float]
    remissions: list[float]
    laser: list[float]
    robot: list[float]
    stamp: str
    host: str
    since_start: str
    field_of_view: float = 0.0

    @property
    def angles(self) -> list[float]:
        return [self.start_angle + i * self.resolution for i in range(len(self.ranges))]


def read_log(path: Path) -> tuple[list[Reading], dict[str, str]]:
    """The laser messages of a log, and its parameters."""
    readings, parameters = [], {}
    for line in path.read_text("ascii").splitlines():
        name, *words = line.split()
        message = Message(name, words)
        if name == "ROBOTLASER1":
            _type, start, view, step, most, _accuracy, _mode = message.numbers(7)
            ranges, remissions = message.counted(), message.counted()
            laser, robot = message.numbers(3), message.numbers(3)
            # laser_tv laser_rv forward_safety_dist side_safety_dist turn_axis
            message.numbers(5)
            stamp, host, since = message.words
            found = Reading(start, step, most, ranges, remissions, laser, robot, stamp, host, since, view)
        elif name == "FLASER":
            ranges = message.counted()
            laser, robot = message.numbers(3), message.numbers(3)
            known = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5, 400: 0.25, 401: 0.25}
            step = math.radians(known.get(len(ranges), 180 / (len(ranges) - 1)))
            stamp, host, since = message.words
            found = Reading(-math.pi / 2, step, 80.0, ranges, [], laser, robot, stamp, host, since)
        elif name == "PARAM":
            key, value, *_ = words
            parameters[key] = value
            continue
        else:
            assert name == "#", line
            continue
        readings.append(found)
    return readings, parameters

"""CARMEN's log files: ``ROBOTLASER1`` has the directions of beams, for ``FLASER`` readers assume them.

Sources of the rules: "Logger and Playback" of CARMEN's manual (carmen.sourceforge.net/logger_playback.html), what
CARMEN's ``readlog`` (order of the fields, guesses about FLASER), and MRPT's ``carmen_log_parse_line``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.errors import UnwritableError, UsageError, stamp_text

from .files import TextFile, float32_text, float32_texts, has_intensities, planar

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.streams.scans import Scan

    from .poses import PosesAtStamp

#: The name of the computer in each line; readers need one word.
_HOST = "pc2scan"

#: laser_type of a sensor that CARMEN has no number for.
_OTHER_LASER = 99

#: accuracy, and remission_mode without and with intensities.
_ACCURACY, _NO_REMISSION, _DIRECT_REMISSION = 0.01, 0, 1

#: laser_tv, laser_rv, forward_safety_dist, side_safety_dist, turn_axis: the state of CARMEN's own robot.
_STATE = "0 0 0 0 0"

#: What readers of FLASER assume, by the number of readings: degrees from one to the next. For any other number: 180
#: degrees from the first to the last.
_GUESSED_DEGREES = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5, 400: 0.25, 401: 0.25}

#: The range from which on readers of FLASER see no return, and the range of a SICK laser without a return.
_FLASER_LIMIT, _FLASER_NONE = 80.0, 81.91

#: How far a beam may be from the place that a reader of FLASER assumes, in beam widths.
_MOST_OFF = 0.1

#: The longest line: CARMEN's own tools cut longer ones.
_LONGEST_LINE = 9_998


class CarmenWriter:
    """Writes a line ``ROBOTLASER1`` for each scan: beams, readings, the poses of the laser and the robot."""

    _message = "ROBOTLASER1"

    def __init__(self, path: Path, *, posed: bool) -> None:
        assert posed
        self._file = TextFile(path)
        self._first_ns: int | None = None
        self._long_lines = 0

    def add(self, item: Scan, placed: PosesAtStamp | None) -> None:
        """Write a line; raise a `UsageError` for scans that the format cannot represent."""
        assert placed is not None
        numbers = (item.angle_min, item.angle_increment)
        if not all(map(math.isfinite, numbers)):
            raise UnwritableError(f"its angles are not finite: angle_min {numbers[0]}, angle_increment {numbers[1]}")
        laser = placed.sensor()
        if laser.matrix[2, 2] <= 0:
            raise UsageError(
                f"the laser {item.frame!r} is upside down in {placed.pose_frame!r}, but x, y and yaw cannot say so",
                topic=item.topic,
                hint="scans that are made of clouds may be in any frame: `target_frame=base_link`",
            )
        body = self._body(item)
        if self._first_ns is None:
            self._first_ns = item.stamp_ns
            self._head(item)
        poses = " ".join(map(repr, (*planar(laser), *planar(placed.robot))))
        self._line(f"{self._message} {body} {poses}{self._state()}", item.stamp_ns)

    def _head(self, scan: Scan) -> None:  # noqa: ARG002  # FLASER needs it
        self._file.line("# CARMEN Logfile")
        self._file.line("# file format is one message per line")
        self._file.line("# message_name [message contents] ipc_timestamp ipc_hostname logger_timestamp")

    def _line(self, text: str, stamp_ns: int) -> None:
        assert self._first_ns is not None
        line = f"{text} {stamp_text(stamp_ns)} {_HOST} {stamp_text(stamp_ns - self._first_ns)}"
        self._long_lines += len(line) > _LONGEST_LINE
        self._file.line(line)

    def _state(self) -> str:
        return f" {_STATE}"

    def _body(self, scan: Scan) -> str:
        if not math.isfinite(scan.range_max):
            raise UsageError(
                "range_max is infinite, but the format writes beams without a return as the maximum range",
                topic=scan.topic,
                stamp_ns=scan.stamp_ns,
                hint="for scans that are made of clouds, `range_max=30` sets it",
            )
        start, step, ranges, intensities = _counterclockwise(scan)
        readings = np.where(_order(scan, scan.valid), ranges, np.float32(scan.range_max))
        with_intensities = has_intensities(scan)
        remissions = float32_texts(intensities) if with_intensities else []
        sensor = (
            f"{_OTHER_LASER} {float32_text(start)} {_sweep_text(step, len(ranges))} {float32_text(step)} "
            f"{float32_text(scan.range_max)} {_ACCURACY} {_DIRECT_REMISSION if with_intensities else _NO_REMISSION}"
        )
        return " ".join((sensor, str(len(ranges)), *float32_texts(readings), str(len(remissions)), *remissions))

    def finish(self) -> list[str]:
        """Complete the file."""
        self._file.finish()
        if not self._long_lines:
            return []
        return [f"{self._long_lines:,} lines have more than {_LONGEST_LINE:,} characters: CARMEN's own tools cut them"]

    def abort(self) -> None:
        """Release the file."""
        self._file.abort()


class FlaserWriter(CarmenWriter):
    """Writes a line ``FLASER`` for each scan: readings, and the poses of the laser and the robot, no beams."""

    _message = "FLASER"

    def _head(self, scan: Scan) -> None:
        super()._head(scan)
        degrees = math.degrees(_guess_step(len(scan.ranges)))
        self._line(f"PARAM laser_front_laser_resolution {degrees:.6g}", scan.stamp_ns)
        self._line(f"PARAM robot_front_laser_max {_FLASER_LIMIT:g}", scan.stamp_ns)

    def _state(self) -> str:
        return ""

    def _body(self, scan: Scan) -> str:
        start, step, ranges, _ = _counterclockwise(scan)
        count = len(ranges)
        guessed = _guess_step(count)
        off = max(abs(start + math.pi / 2), abs(start + (count - 1) * step + math.pi / 2 - (count - 1) * guessed))
        if count < 2 or off > _MOST_OFF * guessed:
            raise UsageError(
                f"FLASER has no directions of beams: readers assume that {count} readings begin at -90 degrees and are "
                f"{math.degrees(guessed):.6g} degrees apart, those of this scan begin at {math.degrees(start):.6g} and "
                f"are {math.degrees(step):.6g} apart",
                topic=scan.topic,
                stamp_ns=scan.stamp_ns,
                hint="`format=carmen` writes ROBOTLASER1, which has the directions",
            )
        valid = _order(scan, scan.valid)
        if (farthest := float(ranges[valid].max(initial=0))) >= _FLASER_LIMIT:
            raise UsageError(
                f"a reading of {farthest:.6g} m: in FLASER, readings from {_FLASER_LIMIT:g} m on mean no return",
                topic=scan.topic,
                stamp_ns=scan.stamp_ns,
                hint="`format=carmen` writes ROBOTLASER1, which has the maximum range",
            )
        readings = np.where(valid, ranges, np.float32(_FLASER_NONE))
        return " ".join((str(count), *float32_texts(readings)))


def _guess_step(count: int) -> float:
    """Return the radians from one reading to the next, as readers of FLASER assume them."""
    degrees = _GUESSED_DEGREES.get(count)
    return math.pi / max(count - 1, 1) if degrees is None else math.radians(degrees)


def _order(scan: Scan, values: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the values of the beams, counterclockwise."""
    return values[::-1] if scan.angle_increment < 0 else values


def _counterclockwise(scan: Scan) -> tuple[float, float, NDArray[np.float32], NDArray[np.float32]]:
    """Return the first angle, the step, ranges and intensities, in CARMEN's order of beams."""
    step = scan.angle_increment
    if step >= 0:
        return scan.angle_min, step, scan.ranges, scan.intensities
    return scan.angle_min + (len(scan.ranges) - 1) * step, -step, scan.ranges[::-1], scan.intensities[::-1]


def _sweep_text(step: float, count: int) -> str:
    """Return the field of view, from the first beam to the last."""
    return float32_text((count - 1) * step) if count else "0"

"""Decodes sensor_msgs/MultiEchoLaserScan, with one of the echoes of each beam, to a LaserScan.

Sources: MultiEchoLaserScan.msg and LaserEcho.msg: a LaserScan in which each range and each intensity is an array of
float32. laser_proc's LaserProc.cpp: the ranges and intensities of the first, last and most intense echoes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.errors import DecodeError

from .laserscan import LaserScan
from .wire import Cursor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.model import Buffer


class _Echoes(NamedTuple):
    """The echoes of all beams: where those of each begin among the values, and how many it has."""

    values: NDArray[np.float32]
    starts: NDArray[np.int64]
    counts: NDArray[np.int64]


def decode_multi_echo(data: Buffer, serialization: str, echo: str = "first") -> LaserScan:
    """Decode a serialised MultiEchoLaserScan.

    Parameters
    ----------
    data
        The whole message.
    serialization
        ``ros1`` or ``cdr``.
    echo
        Which echo of each beam: the ``first``, the ``last`` or the ``strongest``, which has the highest intensity; of
        several, the first of these.

    Returns
    -------
    LaserScan
        NaN where a beam has no echo, as laser_proc has it; its intensity is 0.

    Raises
    ------
    DecodeError
        If the message ends too early, a beam has other numbers of ranges and of intensities, or the strongest of
        echoes without intensities is requested.
    """
    cursor = Cursor(data, serialization)
    header, geometry = cursor.header(), cursor.read("7f")
    try:
        ranges, intensities = _echoes(cursor), _echoes(cursor)
        lit = intensities.counts.size > 0
        if lit and not np.array_equal(ranges.counts, intensities.counts):
            raise DecodeError("it does not have as many intensities as ranges")
        if echo == "strongest" and ranges.counts.size and not lit:
            raise DecodeError("it has no intensities, so no echo is the strongest", hint="`echo` is first or last")
    except DecodeError as err:
        err.stamp_ns = header[1]
        raise
    chosen = _chosen(intensities, echo) if lit else _chosen(ranges, echo)
    values = [_take(ranges, chosen, np.nan), _take(intensities, chosen if lit else intensities.counts, 0.0)]
    return LaserScan(*header, *geometry, *values)


def _echoes(cursor: Cursor) -> _Echoes:
    (beams,) = cursor.read("I")
    rest = cursor.data[cursor.position :]
    rest = rest[: len(rest) // 4 * 4]
    words = np.frombuffer(rest, cursor.byte_order + "u4")
    if beams > words.size:
        raise DecodeError(f"message ends after {len(cursor.data)} bytes, but has {beams:,} beams")
    starts, counts = np.empty(beams, np.int64), np.empty(beams, np.int64)
    place = 0
    for beam in range(beams):
        count = int(words[place]) if place < words.size else 0
        starts[beam], counts[beam] = place + 1, count
        place += 1 + count
        if place > words.size:
            raise DecodeError(f"message ends after {len(cursor.data)} bytes, but beam {beam} has {count:,} echoes")
    cursor.take(4 * place)
    return _Echoes(words.view(cursor.byte_order + "f4").astype(np.float32, copy=False), starts, counts)


def _chosen(echoes: _Echoes, echo: str) -> NDArray[np.int64]:
    """Return the number of the echo that each beam uses; any number for a beam without echoes."""
    if echo == "first":
        return np.zeros_like(echoes.counts)
    chosen = np.maximum(echoes.counts - 1, 0)
    if echo == "strongest":
        for beam in np.flatnonzero(echoes.counts > 1):
            start = echoes.starts[beam]
            own = echoes.values[start : start + echoes.counts[beam]].tolist()
            chosen[beam] = max(range(len(own)), key=own.__getitem__)
    return chosen


def _take(echoes: _Echoes, chosen: NDArray[np.int64], missing: float) -> NDArray[np.float32]:
    values = np.full(echoes.counts.size, missing, np.float32)
    has_echo = echoes.counts > 0
    values[has_echo] = echoes.values[(echoes.starts + chosen)[has_echo]]
    return values

"""Explains differences of two scans by another rounding of angles (another libm), from the scans and from a cloud.

An angle that differs in its last bit puts a point that is this close to the edge of a beam into the neighbouring beam.
Nothing else changes. So if two scans of closest returns differ only by the rounding, the smaller of two readings
belongs to a point that is in this beam with one rounding, and in the next beam with the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from . import kernel, plain
from .layout import TURN, BeamLayout, beam_count
from .rule import centered_beams, upstream_beams

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

__all__ = ["CORRECT", "GLIBC", "Marks", "Proof", "Readings", "marks", "prove"]

#: Roundings of angles, as indices: correct ones, and those of glibc 2.31 to 2.40.
CORRECT, GLIBC = 0, 1


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Two scans with the same beams.

    Attributes
    ----------
    angle_min, angle_max, angle_increment, range_min, range_max
        As both messages have them, radians and metres.
    a, b
        (N,) float32, metres: the ranges of the beams.
    differing
        (N,): which beams differ.
    """

    angle_min: float
    angle_max: float
    angle_increment: float
    range_min: float
    range_max: float
    a: NDArray[np.float32]
    b: NDArray[np.float32]
    differing: NDArray[np.bool_]

    @np.errstate(all="ignore")  # a header's limits may be any numbers
    def returns(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the ranges, infinity for beams without a return."""
        a, b = (
            np.where(np.isfinite(side) & (side >= self.range_min) & (side <= self.range_max), side, np.float32(np.inf))
            for side in (self.a, self.b)
        )
        return a, b

    def rules(self) -> list[NDArray[np.float64]]:
        """Return the rules that fit the header: upstream's geometry, the centered one, both or none."""
        count, low, high, step = len(self.a), self.angle_min, self.angle_max, self.angle_increment
        if not (np.isfinite([low, high, step]).all() and step > 0 and low < high):
            return []
        beams = []
        if beam_count(low, high, step) == count:
            beams.append(upstream_beams(BeamLayout(count, low, high, step)))
        # As a float64, because the quotient may be too large for an integer.
        if np.rint((high - low) / step) + 1 == count:
            # The last beam and the first one of a circle are neighbours, except for the rounding of the increment.
            full_circle = count * step >= TURN * (1 - 2.0**-22) - step / 1000
            beams.append(centered_beams(BeamLayout(count, low, high, step, full_circle)))
        return [np.array([-np.inf, np.inf, 0.0, np.inf, *numbers, 0.0]) for numbers in beams]


class Marks(NamedTuple):
    """Counts of differing beams, from two scans alone.

    Attributes
    ----------
    in_neighbour
        Beams whose smaller reading equals, to the bit, that of a neighbouring beam of the other scan.
    hidden
        Beams for which it may be there, behind a closer return, or outside of the scan.
    """

    in_neighbour: int
    hidden: int


def marks(readings: Readings) -> Marks:
    """Count the differing beams that another rounding can have changed, from the scans alone."""
    a, b = readings.returns()
    equal = np.zeros(a.size, bool)
    closer = np.zeros(a.size, bool)
    for one, other in ((a, b), (b, a)):
        smaller = one < other
        # The point of this reading is in a neighbouring beam of the other scan, which reads its range or less.
        for beams, neighbours in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
            equal[beams] |= smaller[beams] & (other[neighbours] == one[beams])
            closer[beams] |= smaller[beams] & (other[neighbours] < one[beams])
        # The neighbour of the first and the last beam is outside of the scan.
        closer[[0, -1]] |= smaller[[0, -1]]
    in_neighbour = readings.differing & equal
    return Marks(int(in_neighbour.sum()), int((readings.differing & closer & ~in_neighbour).sum()))


class Proof(NamedTuple):
    """The result of comparing two scans with the points of their cloud.

    Attributes
    ----------
    a_glibc, b_glibc
        (N,): differing beams that are explained if A has the angles of glibc 2.31 to 2.40 and B correct ones; and in
        the opposite case.
    returns
        (2,): how many returns A and B have.
    fitting
        (2, 2): how many of the returns are points of the cloud in that beam, by side and by the rounding of the points'
        angles. For a scan that was made of the cloud with one rounding, these are all returns.
    """

    a_glibc: NDArray[np.bool_]
    b_glibc: NDArray[np.bool_]
    returns: NDArray[np.intp]
    fitting: NDArray[np.intp]


def prove(readings: Readings, points: Iterable[tuple[NDArray[np.float32], NDArray[np.float32]]]) -> Proof | None:
    """Compare two scans with the points that they were made of.

    A differing beam is explained if the smaller reading is the range, to the bit, of a point that is in the beam with
    one rounding of angles and in another one with the other; if this other beam reads the same or less in the other
    scan; and if the larger reading, unless it is no return, is the range of a point in the beam. So it need not be
    known which points were accepted.

    Parameters
    ----------
    points
        x and y in the scans' frame, metres, part by part.

    Returns
    -------
    Proof or None
        By upstream's geometry or the centered one: the one that finds more returns among the points. None if the scans
        have neither.
    """
    rules = readings.rules()
    if not rules:
        return None
    returns = readings.returns()
    looks = [_PointMatches(rule, returns) for rule in rules]
    with np.errstate(all="ignore"):
        for x, y in points:
            reach = np.sqrt(np.square(x, dtype=np.float64) + np.square(y, dtype=np.float64)).astype(np.float32)
            seen = np.isfinite(reach)
            angles = np.empty((2, np.count_nonzero(seen)), np.float32)
            for rounding in (CORRECT, GLIBC):
                kernel.angles(x[seen], y[seen], angles[rounding], rounding == GLIBC)
            for look in looks:
                look.add(angles, reach[seen])
    fitting = [look.there.sum(axis=-1) for look in looks]
    best = int(np.argmax([fits.max(axis=-1).sum() for fits in fitting]))
    a_glibc, b_glibc = (
        looks[best].explained(roundings) & readings.differing for roundings in ((GLIBC, CORRECT), (CORRECT, GLIBC))
    )
    return Proof(a_glibc, b_glibc, np.isfinite(returns).sum(axis=-1), fitting[best])


class _PointMatches:
    """Compares the points of a cloud with two scans, if beams are numbered by a rule."""

    def __init__(self, rule: NDArray[np.float64], returns: tuple[NDArray[np.float32], NDArray[np.float32]]) -> None:
        self._rule = rule
        self._returns = returns
        # One more element for points that are in no beam.
        self._nearest = [np.append(side, np.zeros(2, np.float32)) for side in returns]
        #: By side, rounding and beam: whether a point has the beam's reading, and whether such a point changes its
        #: beam.
        self.there, self._moving = np.zeros((2, 2, 2, returns[0].size), bool)

    def add(self, angles: NDArray[np.float32], reach: NDArray[np.float32]) -> None:
        """Add points: their angles by rounding, (2, M), and their ranges."""
        beams = self._returns[0].size
        bins = [plain.bins_of(angle, self._rule, beams) for angle in angles]
        apart = bins[0] != bins[1]
        for side, reading in enumerate(self._returns):
            for rounding, index in enumerate(bins):
                inside = index < beams
                hit = inside.copy()
                hit[inside] = reading[index[inside]] == reach[inside]
                self.there[side, rounding, index[hit]] = True
                # In the other scan the point is in another beam, which therefore reads its range or less.
                moves = hit & apart & (self._nearest[1 - side][bins[1 - rounding]] <= reach)
                self._moving[side, rounding, index[moves]] = True

    def explained(self, roundings: tuple[int, int]) -> NDArray[np.bool_]:
        """Return the beams that are explained if the sides have these roundings."""
        result = np.zeros(self._returns[0].size, bool)
        for side, other in ((0, 1), (1, 0)):
            smaller = self._returns[side] < self._returns[other]
            known = np.isinf(self._returns[other]) | self.there[other, roundings[other]]
            result |= smaller & self._moving[side, roundings[side]] & known
        return result

"""The rules of a comparison: tolerances, the allowed share, and names to ignore."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pc2scan.core.compare import Tolerance
from pc2scan.errors import UsageError
from pc2scan.text import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pc2scan.options.call import Options

#: The single numbers of a LaserScan; they are compared bit for bit.
GEOMETRY = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")

#: The names that `Rules.ignore` may have: of all messages, of scans, of clouds, and of clouds of other types.
IGNORABLE = (
    *("log_time", "seq", "frame_id", "order"),
    *(*GEOMETRY, "ranges", "intensities"),
    *("shape", "layout", "padding", "is_dense"),
    *("format", "packets", "timebase", "point_num", "lidar_id", "rsvd"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """The rules of a comparison. By default all bits must be equal.

    Attributes
    ----------
    atol, rtol
        Tolerances by name: ``ranges``, ``intensities``, or a field of a cloud; the empty name is for all others.
        See `pc2scan.core.compare.Tolerance`; A is the reference.
    allow_beams
        The share of a topic's beams (of a cloud: points), over all its messages, that may be beyond the tolerance.
    ignore
        Names of `IGNORABLE` that are not compared.

    Raises
    ------
    UsageError
        If a tolerance is negative, the share not within 0 and 1, or a name unknown.
    """

    atol: Mapping[str, float] = field(default_factory=dict)
    rtol: Mapping[str, float] = field(default_factory=dict)
    allow_beams: float = 0.0
    ignore: frozenset[str] = frozenset()

    @classmethod
    def of(cls, options: Options) -> Rules:
        """Return the rules among the options of a call."""
        return cls(
            atol=options.atol or {},
            rtol=options.rtol or {},
            allow_beams=options.allow_beams,
            ignore=frozenset(options.ignore),
        )

    def __post_init__(self) -> None:
        for name in {*self.atol, *self.rtol}:
            self.tolerance(name)
        if not (math.isfinite(self.allow_beams) and 0 <= self.allow_beams <= 1):
            raise UsageError(
                f"allow_beams is {self.allow_beams}, it must be a share from 0 to 1",
                hint="0.001 allows one beam in a thousand",
            )
        if unknown := sorted(self.ignore - {*IGNORABLE}):
            near = did_you_mean(unknown[0], IGNORABLE)
            hint = f"{near} these can be ignored: {', '.join(IGNORABLE)}".strip()
            raise UsageError(f"{unknown[0]!r} cannot be ignored", hint=hint)

    def tolerance(self, name: str) -> Tolerance:
        """Return the tolerance of ``ranges``, ``intensities`` or a field."""
        return Tolerance(self.atol.get(name, self.atol.get("", 0.0)), self.rtol.get(name, self.rtol.get("", 0.0)))

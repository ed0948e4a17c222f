"""How many points of a cloud are used, and how many are rejected for which reason."""

from __future__ import annotations

from operator import add
from typing import TYPE_CHECKING

from .rule import NO_TIME, NO_TRANSFORM, REJECTIONS

if TYPE_CHECKING:
    from collections.abc import Mapping

_REASONS = tuple(rejection.name for rejection in REJECTIONS)
_MOVING_REASONS = (*_REASONS, NO_TIME.name, NO_TRANSFORM.name)
_NONE = dict.fromkeys(_REASONS, 0)


class PointCounts:
    """How many points a cloud has, and how many are used and rejected. All counts except ``total`` sum to ``total``.

    Each point is counted once, under the first reason that rejects it. Filters come first, then the reasons of the
    projection, which always exist: ``nan`` (x, y or z is NaN), ``height``, ``range`` and ``angle`` (outside of the
    limits), and ``past_end`` (in the sector, but after its last beam). Each is an attribute: ``counts.height``.

    Attributes
    ----------
    total
        Points of the cloud.
    used
        Points that fall into a beam, even if another point is closer, or the range of a beam without a return.
    rejected
        The other points, by reason: those of the projection, then those of filters.

    Examples
    --------
    >>> counts = PointCounts(5, 2, height=1, exclude_box=2)
    >>> counts.exclude_box, counts.angle
    (2, 0)
    >>> counts + PointCounts(1, 0, nan=1)
    PointCounts(total=6, used=2, nan=1, height=1, range=0, angle=0, past_end=0, exclude_box=2)
    """

    # Tuples instead of a dictionary, because counts are made and added for every cloud.
    __slots__ = ("_reasons", "_values", "total", "used")

    total: int
    used: int
    _reasons: tuple[str, ...]
    _values: tuple[int, ...]

    def __init__(self, total: int = 0, used: int = 0, **rejected: int) -> None:
        self.total = total
        self.used = used
        known = _NONE | rejected
        self._reasons, self._values = tuple(known), tuple(known.values())

    @classmethod
    def of_filters(cls, rejected: Mapping[str, int]) -> PointCounts:
        """Return the counts of points that filters rejected, by the filter's name."""
        return cls(sum(rejected.values()), **rejected)

    @classmethod
    def of_projection(cls, total: int, rejected: tuple[int, ...]) -> PointCounts:
        """Return the counts of a cloud, from the result of the loops over points.

        These are in the order of `REJECTIONS`; for deskewed points, the points without a time and the points without a
        transform follow.
        """
        counts = cls.__new__(cls)
        counts.total = total
        counts.used = total - sum(rejected)
        reasons = _REASONS if len(rejected) == len(_REASONS) else _MOVING_REASONS
        counts._reasons, counts._values = reasons, rejected  # noqa: SLF001  # its own class
        return counts

    @property
    def rejected(self) -> dict[str, int]:
        """The points that are not used, by reason."""
        return dict(zip(self._reasons, self._values, strict=True))

    def __getattr__(self, name: str) -> int:
        # Python calls this only for names that are no attributes. An object that is being unpickled has no counts yet.
        if name in self.__slots__ or name.startswith("__"):
            raise AttributeError(name)
        if name in self._reasons:
            return self._values[self._reasons.index(name)]
        raise AttributeError(f"there is no count {name!r}, only {', '.join(self.as_dict())}")

    def __add__(self, other: PointCounts) -> PointCounts:
        # Not by keywords, which take as long as all of it.
        added = PointCounts.__new__(PointCounts)
        added.total, added.used = self.total + other.total, self.used + other.used
        reasons = self._reasons
        if reasons == other._reasons:
            added._reasons, added._values = reasons, tuple(map(add, self._values, other._values))
            return added
        rejected = self.rejected
        for name, count in other.rejected.items():
            rejected[name] = rejected.get(name, 0) + count
        added._reasons, added._values = tuple(rejected), tuple(rejected.values())
        return added

    def __eq__(self, other: object) -> bool:
        return self.as_dict() == other.as_dict() if isinstance(other, PointCounts) else NotImplemented

    def __hash__(self) -> int:
        return hash(frozenset(self.as_dict().items()))

    def __repr__(self) -> str:
        return f"PointCounts({', '.join(f'{name}={count}' for name, count in self.as_dict().items())})"

    def as_dict(self) -> dict[str, int]:
        """Return all counts by name, ``total`` and ``used`` first."""
        return {"total": self.total, "used": self.used, **self.rejected}

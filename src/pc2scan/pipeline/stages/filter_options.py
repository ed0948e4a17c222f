"""The filters that options ask for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from .filters import Filter


def _where(conditions: Iterable[str], _: float) -> Iterator[Filter]:
    from .where import Where  # noqa: PLC0415

    return map(Where, conditions)


def _boxes(texts: Iterable[str], _: float) -> Iterator[Filter]:
    from .regions import ExcludeBox  # noqa: PLC0415

    return map(ExcludeBox.parse, texts)


def _polygons(texts: Iterable[str], _: float) -> Iterator[Filter]:
    from .regions import ExcludePolygon  # noqa: PLC0415

    return map(ExcludePolygon.parse, texts)


def _ground(text: str, _: float) -> Iterable[Filter]:
    from .ground import RemoveGround  # noqa: PLC0415

    return () if text == "keep" else (RemoveGround.parse(text),)


def _min_height_slope(slope: float, min_height: float) -> Iterable[Filter]:
    from .ground import MinHeightSlope  # noqa: PLC0415

    return (MinHeightSlope(min_height, slope),)


#: What makes the filters of each option, of its value and of the parameter ``min_height``; in the order in which the
#: filters are applied. Finding the ground comes before the limits of height, because it needs the points that these
#: reject. A filter's module is imported when it is asked for: other conversions do not need it.
FILTERS: Mapping[str, Callable[[Any, float], Iterable[Filter]]] = {
    "where": _where,
    "exclude_box": _boxes,
    "exclude_polygon": _polygons,
    "ground": _ground,
    "min_height_slope": _min_height_slope,
}


def filters_from(values: Mapping[str, Any], min_height: float) -> Iterator[Filter]:
    """Yield the requested filters.

    Parameters
    ----------
    values
        Values of options by name; others than those in `FILTERS` are ignored.
    min_height
        The parameter of the projection.

    Raises
    ------
    UsageError
        If a value cannot be read.
    """
    for name, make in FILTERS.items():
        if name in values:
            yield from make(values[name], min_height)

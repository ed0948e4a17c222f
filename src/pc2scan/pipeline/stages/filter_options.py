"""The table of filters that options ask for: what each option takes, and the filters that it makes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from .filters import Filter

__all__ = ["FILTER_OPTIONS", "FilterOption", "filters_from"]


class FilterOption(NamedTuple):
    """An option that asks for filters.

    Attributes
    ----------
    kind
        ``text``, ``texts`` (one or a list) or ``number``.
    help
        A description, for the JSON schemas of files with options.
    filters
        Makes the filters of the option's value and of the parameter ``min_height``. It imports their module, which
        other conversions do not need.
    words
        The allowed texts; empty if any is allowed.
    """

    kind: Literal["text", "texts", "number"]
    help: str
    filters: Callable[[Any, float], Iterable[Filter]]
    words: tuple[str, ...] = ()


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
    from .height_slope import MinHeightSlope  # noqa: PLC0415

    return (MinHeightSlope(min_height, slope),)


#: Each option by its name in Python, in the order in which the filters are applied. Finding the ground comes before
#: the limits of height, because it needs the points that these reject.
FILTER_OPTIONS: Mapping[str, FilterOption] = {
    "where": FilterOption(
        "texts", "Use only points whose fields fulfil a condition: ring in (3, 4) and intensity > 10.", _where
    ),
    "exclude_box": FilterOption("texts", "Reject points in a box: frame x0 x1 y0 y1 z0 z1.", _boxes),
    "exclude_polygon": FilterOption(
        "texts", "Reject points above, below and in a polygon: frame x0 y0 x1 y1 x2 y2 ...", _polygons
    ),
    "ground": FilterOption("text", "Keep or remove points on the ground.", _ground, ("keep", "remove")),
    "min_height_slope": FilterOption("number", "Reject points below min_height + this * range.", _min_height_slope),
}


def filters_from(values: Mapping[str, Any], min_height: float) -> Iterator[Filter]:
    """Yield the requested filters.

    Parameters
    ----------
    values
        Values of options by name; others than those in `FILTER_OPTIONS` are ignored.
    min_height
        The parameter of the projection.

    Raises
    ------
    UsageError
        If a value cannot be read.
    """
    for name, option in FILTER_OPTIONS.items():
        if name in values:
            yield from option.filters(values[name], min_height)

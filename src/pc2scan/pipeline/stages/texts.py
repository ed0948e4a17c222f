"""Reads filters from the texts of options."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from .filters import Filter

__all__ = ["filters_from"]


def filters_from(
    where: Sequence[str],
    exclude_box: Sequence[str],
    exclude_polygon: Sequence[str],
    min_height_slope: float | None,
    min_height: float,
    ground: str = "keep",
) -> Iterator[Filter]:
    """Yield the requested filters; their modules are imported only if needed.

    Parameters
    ----------
    where
        Conditions, see `pc2scan.pipeline.stages.where.Where`.
    exclude_box, exclude_polygon
        As `pc2scan.pipeline.stages.regions.ExcludeBox.parse` and that of ``ExcludePolygon`` read them.
    min_height_slope, min_height
        See `pc2scan.pipeline.stages.height_slope.MinHeightSlope`.
    ground
        ``remove`` or ``keep``; see `pc2scan.pipeline.stages.ground.RemoveGround`.

    Raises
    ------
    UsageError
        If one of them cannot be read.
    """
    if where:
        from .where import Where  # noqa: PLC0415

        yield from map(Where, where)
    if exclude_box or exclude_polygon:
        from .regions import ExcludeBox, ExcludePolygon  # noqa: PLC0415

        yield from map(ExcludeBox.parse, exclude_box)
        yield from map(ExcludePolygon.parse, exclude_polygon)
    if ground != "keep":
        from .ground import RemoveGround  # noqa: PLC0415

        # Before the limits of height, because finding the ground needs the points that these reject.
        yield RemoveGround.parse(ground)
    if min_height_slope is not None:
        from .height_slope import MinHeightSlope  # noqa: PLC0415

        yield MinHeightSlope(min_height, min_height_slope)

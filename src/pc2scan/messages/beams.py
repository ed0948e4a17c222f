"""The beams of LaserScans as points, each with the time at which it was measured."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.layout import float32
from pc2scan.core.points import TIME, Points
from pc2scan.core.unproject import unproject
from pc2scan.errors import DecodeError

if TYPE_CHECKING:
    from pc2scan.core.unproject import UnprojectedScan, UnprojectParams

    from .laserscan import LaserScan


#: What drivers of SICK's LMS1xx have where nothing returns, whatever their range_max is: metres.
_NO_RETURN = float32(65.533)


def unproject_scan(scan: LaserScan, params: UnprojectParams | None = None) -> UnprojectedScan:
    """Return the points of a scan; see `unproject`.

    Raises
    ------
    DecodeError
        See `unproject`; with the scan's stamp.
    """
    try:
        return unproject(
            scan.ranges,
            scan.intensities,
            angle_min=scan.angle_min,
            angle_increment=scan.angle_increment,
            range_min=scan.range_min,
            range_max=scan.range_max,
            time_increment=scan.time_increment,
            params=params,
        )
    except DecodeError as err:
        err.stamp_ns = scan.stamp_ns
        raise


def scan_points(scan: LaserScan) -> tuple[Points, dict[str, int]]:
    """Return the returns of a scan as points, and how many beams have none.

    Returns
    -------
    points
        In the plane z = 0 of the scan's frame, as laser_geometry places them: float32 ``x``, ``y``, ``z``, and
        ``intensity`` if the scan has intensities; ``index``, the number of the beam, int32; and `TIME`.
    rejected
        How many beams are no points, by the projection's reasons: ``nan``, and ``range``: infinite, below
        ``range_min``, or ``range_max`` and more.

    Raises
    ------
    DecodeError
        If its angles are not finite, or it has intensities, but not one for each range.
    """
    if (missing := scan.ranges == _NO_RETURN).any():
        scan = replace(scan, ranges=np.where(missing, float32(np.inf), scan.ranges))
    unprojected = unproject_scan(scan)
    fields = {name: np.ascontiguousarray(unprojected.points[name]) for name in unprojected.points.dtype.names or ()}
    with np.errstate(all="ignore"):
        fields[TIME] = unprojected.beams * np.float64(float32(scan.time_increment))
    return Points(scan.sequence, scan.stamp_ns, scan.frame_id, fields), unprojected.rejected

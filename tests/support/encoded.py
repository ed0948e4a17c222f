"""Clouds that pc2scan's own encoder writes, of any layout."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pc2scan.messages.pointcloud2 import PointCloud2, PointField, encode_cloud

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.model import Buffer


def encode_pointcloud2(
    *,
    serialization: str,
    sequence: int,
    stamp_ns: int,
    frame_id: str,
    fields: Sequence[PointField],
    point_step: int,
    data: Buffer,
    height: int = 1,
    is_dense: bool = False,
    is_bigendian: bool = False,
) -> bytes:
    """Serialise a cloud whose rows follow each other without a gap."""
    width = len(data) // (point_step * height) if point_step * height else 0
    layout = height, width, tuple(fields), is_bigendian, point_step, width * point_step
    return encode_cloud(PointCloud2(sequence, stamp_ns, frame_id, *layout, memoryview(data), is_dense), serialization)

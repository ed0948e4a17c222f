"""Buffers of a few transforms, and what is found in them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from pc2scan.errors import TransformError
from pc2scan.transforms.builder import TransformBuilder

if TYPE_CHECKING:
    from pc2scan.core.rigid import TransformRow
    from pc2scan.transforms.buffer import TransformBuffer

SECOND = 1_000_000_000
EPOCH = 1_700_000_000 * SECOND


def row(parent: str, child: str, second: float, x: float = 0.0, yaw: float = 0.0, *, norm: float = 1.0) -> TransformRow:
    z, w = math.sin(yaw / 2) * norm, math.cos(yaw / 2) * norm
    return (parent, child, EPOCH + round(second * SECOND), x, 0.0, 0.0, 0.0, 0.0, z, w)


def at(second: float) -> int:
    return EPOCH + round(second * SECOND)


def built(dynamic: list[TransformRow] | None = None, static: list[TransformRow] | None = None) -> TransformBuffer:
    builder = TransformBuilder()
    builder.add(static or [], static=True)
    builder.add(dynamic or [], static=False)
    return builder.build()


def x_of(buffer: TransformBuffer, target: str, source: str, stamp_ns: int, tolerance_ns: int = 0) -> float:
    return float(buffer.lookup(target, source, stamp_ns, tolerance_ns).translation[0])


def refusal(buffer: TransformBuffer, target: str, source: str, stamp_ns: int, tolerance_ns: int = 0) -> TransformError:
    with pytest.raises(TransformError) as caught:
        buffer.lookup(target, source, stamp_ns, tolerance_ns)
    return caught.value

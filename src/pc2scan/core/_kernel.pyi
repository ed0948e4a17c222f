from typing import Any

from numpy.typing import NDArray

from .rigid import MovingTransform

def project(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    rule: NDArray[Any],
    transform: NDArray[Any] | MovingTransform | None,
    ranges: NDArray[Any],
    limit: float,
    empty: float,
    /,
) -> tuple[int, ...]: ...
def gather(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    rule: NDArray[Any],
    transform: NDArray[Any] | MovingTransform | None,
    beams: int,
    bins: NDArray[Any],
    ranges: NDArray[Any],
    numbers: NDArray[Any],
    /,
) -> tuple[int, ...]: ...
def deskew(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    motion: MovingTransform,
    out: NDArray[Any],
    /,
) -> tuple[int, int]: ...
def span(x: NDArray[Any], values: NDArray[Any], /) -> tuple[float, float, int, int]: ...
def follow(times: NDArray[Any], stamps: NDArray[Any], poses: NDArray[Any], rows: NDArray[Any], /) -> None: ...
def nodes(stamps: tuple[NDArray[Any], ...], begin_ns: int, end_ns: int, step_ns: int, /) -> tuple[bytes, int]: ...
def lanes(most: int, /) -> int: ...
def trace(cells: NDArray[Any], width: int, mark: int, rays: NDArray[Any], hits: NDArray[Any], /) -> None: ...
def angles(x: NDArray[Any], y: NDArray[Any], out: NDArray[Any], glibc: bool = ..., /) -> None: ...

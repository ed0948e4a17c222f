from typing import Any

from numpy.typing import NDArray

def project(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    rule: NDArray[Any],
    transform: NDArray[Any] | None,
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
    transform: NDArray[Any] | None,
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
    times: NDArray[Any],
    node_times: NDArray[Any],
    transforms: NDArray[Any],
    out: NDArray[Any],
    /,
) -> int: ...
def trace(cells: NDArray[Any], width: int, mark: int, rays: NDArray[Any], hits: NDArray[Any], /) -> None: ...
def angles(x: NDArray[Any], y: NDArray[Any], out: NDArray[Any], glibc: bool = ..., /) -> None: ...

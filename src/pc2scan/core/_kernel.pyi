from typing import Any

from numpy.typing import NDArray

def project(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    rule: NDArray[Any],
    moved: NDArray[Any] | None,
    ranges: NDArray[Any],
    limit: float,
    empty: float,
    /,
) -> tuple[int, int, int, int, int]: ...
def gather(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    rule: NDArray[Any],
    moved: NDArray[Any] | None,
    beams: int,
    slots: NDArray[Any],
    ranges: NDArray[Any],
    numbers: NDArray[Any],
    /,
) -> tuple[int, int, int, int, int]: ...
def angles(x: NDArray[Any], y: NDArray[Any], out: NDArray[Any], glibc: bool = ..., /) -> None: ...

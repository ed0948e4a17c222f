from typing import Any

from numpy.typing import NDArray

def project(
    x: NDArray[Any],
    y: NDArray[Any],
    z: NDArray[Any],
    limits: NDArray[Any],
    moved: NDArray[Any] | None,
    ranges: NDArray[Any],
    no_return: float,
    /,
) -> tuple[int, int, int, int, int]: ...
def angles(x: NDArray[Any], y: NDArray[Any], out: NDArray[Any], /) -> None: ...

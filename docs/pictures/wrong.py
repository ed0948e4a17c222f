"""Makes ``wrong.png`` of the README again: ``python docs/pictures/wrong.py [FOLDER]``.

A scan of the fixtures with options that are wrong, over the scan with those that are right. Needs matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import pc2scan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
HALL = HERE.parents[1] / "fixtures" / "hall.bag"

RIGHT = {"target_frame": "base_link", "min_height": 0.1, "max_height": 1.5}
#: What one sees, what to type, and the options that lead to it. A camera's optical frame looks along its z axis.
WRONG: tuple[tuple[str, str, dict[str, Any]], ...] = (
    (
        "things are missing, or all: the heights",
        "--min-height 0.1 --max-height 1.5",
        RIGHT | {"min_height": 1.85, "max_height": 3.0},
    ),
    ("everything is an obstacle: the floor", "--min-height 0.1", RIGHT | {"min_height": -0.1}),
    (
        "pieces: z looks forward, as a camera's",
        "--target-frame base_link",
        RIGHT | {"target_frame": "optical", "static_tf": ["lidar optical 0 0 0 -90deg 0 -90deg"]},
    ),
)
GREY, RED = "#b8b8b8", "#d1342f"


def returns(options: dict[str, Any]) -> NDArray[np.float64]:
    """Return where the returns of the third scan are, (N, 2), metres."""
    scan = list(pc2scan.scans(HALL, **options))[2]
    found = np.isfinite(scan.ranges)
    angles, ranges = scan.angles[found], scan.ranges[found]
    return np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1)


def draw(axes: Axes, wrong: NDArray[np.float64], right: NDArray[np.float64], title: str, cure: str) -> None:
    """Draw a scan over the right one."""
    axes.plot(*right.T, ".", color=GREY, markersize=4)
    axes.plot(*wrong.T, ".", color=RED, markersize=3)
    axes.plot(0, 0, "o", color="#202020", markersize=5)
    axes.set_title(title, fontsize=9)
    axes.set_xlabel(cure, fontsize=8, family="monospace")
    axes.set(aspect="equal", xlim=(-7, 7), ylim=(-5, 5), xticks=[], yticks=[])
    axes.set_frame_on(False)


def main(folder: Path) -> None:
    """Make the picture."""
    from matplotlib.figure import Figure  # noqa: PLC0415  # an extra

    figure = Figure(figsize=(9, 2.9), layout="constrained")
    right = returns(RIGHT)
    for number, (title, cure, options) in enumerate(WRONG, 1):
        draw(figure.add_subplot(1, len(WRONG), number), returns(options), right, title, cure)
    figure.savefig(folder / "wrong.png", dpi=100, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else HERE)

"""Draws the chart of docs/benchmarks.md from the table there: how much faster than the robot conversions are."""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt  # after the choice of what draws

PAGE = Path(__file__).resolve().parents[1] / "benchmarks.md"

#: How often a lidar turns.
HZ = 10


def rows() -> dict[str, tuple[float, float]]:
    """Clouds a second with one job and with two, by source."""
    table = PAGE.read_text("utf-8").partition("| source | 1 job | 2 jobs |")[2].split("\n\n")[0]
    found = {}
    for line in table.splitlines()[2:]:
        source, one, two, *_ = (cell.strip() for cell in line.strip("|").split("|"))
        found[source] = (clouds(one), clouds(two))
    return found


def clouds(cell: str) -> float:
    """Clouds a second, of a cell such as ``929 MB/s, 222/s``."""
    found = re.search(r"([\d,]+)/s$", cell)
    assert found is not None
    return float(found[1].replace(",", ""))


def main(folder: Path) -> None:
    """Draw it."""
    found = rows()
    figure, axes = plt.subplots(figsize=(7.2, 2.9), dpi=110, layout="constrained")
    for place, (one, two) in enumerate(reversed(found.values())):
        axes.barh(place + 0.19, two / HZ, 0.36, color="#1f6f8b", label="2 jobs" if not place else None)
        axes.barh(place - 0.19, one / HZ, 0.36, color="#9cc3cf", label="1 job" if not place else None)
        axes.text(two / HZ + 1.5, place + 0.19, f"{two / HZ:.0f}", va="center", fontsize=8)
        axes.text(one / HZ + 1.5, place - 0.19, f"{one / HZ:.0f}", va="center", fontsize=8)
    axes.set_yticks(range(len(found)), list(reversed(found)))
    axes.set_xlabel(
        f"times faster than the robot: clouds of 131,072 points, recorded at {HZ} Hz, on two cores", fontsize=9
    )
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="lower right", fontsize=8)
    figure.savefig(folder / "speed.png")
    plt.close(figure)


if __name__ == "__main__":
    main(Path(__file__).resolve().parent)

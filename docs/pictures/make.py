"""Makes the pictures of the README again: ``python docs/pictures/make.py [FOLDER]``.

A cloud of the fixtures and scans of it that are wrong, the map of a drive that the tests simulate, and scans of robots
that move. Needs what the tests need.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import moving  # noqa: E402  # beside this one
import wrong  # noqa: E402  # and this

from support.builders import write_mcap  # noqa: E402  # a folder of its own
from support.worlds.drives import drive_recording  # noqa: E402


def pc2scan(*words: str | Path) -> None:
    """Run a command."""
    subprocess.run([sys.executable, "-m", "pc2scan", *map(str, words), "--overwrite"], check=True)  # noqa: S603


def main(folder: Path) -> None:
    """Make all of them."""
    heights = ("--min-height", "-0.3", "--max-height", "1")
    pc2scan("plot", ROOT / "fixtures" / "hall.bag", "-o", folder / "plot.png", "--at", "0.2", *heights)
    with TemporaryDirectory() as temporary:
        drive = write_mcap(Path(temporary) / "drive.mcap", drive_recording())
        pc2scan("map", drive, "-o", folder / "map.png")
    moving.main(folder)
    wrong.main(folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else HERE)

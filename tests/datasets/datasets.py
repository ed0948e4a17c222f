"""A made-up dataset: tiny recordings in every container, good, damaged, and not recordings at all."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING

import zstandard

from support.batches import place
from support.builders import CHATTER, CONTENT, Recording, write_mcap, write_rosbag1

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["make_dataset"]

WITHOUT_CLOUDS = Recording((CHATTER,), tuple(CONTENT.of(CHATTER.topic)))

#: Files and folders of the dataset, and what becomes of them; ``-`` for files that are ignored.
OUTCOMES = {
    **dict.fromkeys(("good.bag", "good.mcap", "good.db3", "rosbag2", "split", "packed.mcap.zst"), "converted"),
    "nameless": "converted",
    "cut.bag": "incomplete",
    "cut.mcap": "incomplete",
    **dict.fromkeys(("empty.bag", "text.mcap"), "failed"),
    "without.mcap": "no clouds",
    "thumbs.db": "-",
    "README.txt": "-",
}


def make_templates(folder: Path) -> None:
    """Write one recording of each kind."""
    place(folder, "good.bag", "good.mcap", "good.db3", "rosbag2", "split/a.bag")
    (folder / "split" / "a.bag").unlink()
    for number, part in enumerate(CONTENT.halves()):
        write_rosbag1(folder / "split" / f"drive_2020-11-04-18-39-5{number}_{number}.bag", part)
    bag, mcap = ((folder / f"good.{suffix}").read_bytes() for suffix in ("bag", "mcap"))
    written = {
        "packed.mcap.zst": zstandard.compress(mcap),
        "nameless": mcap,
        "cut.bag": bag[: int(len(bag) * 0.8)],
        "cut.mcap": mcap[: int(len(mcap) * 0.8)],
        "empty.bag": b"",
        "text.mcap": b"no recording",
        "README.txt": b"about this dataset",
    }
    for name, data in written.items():
        (folder / name).write_bytes(data)
    write_mcap(folder / "without.mcap", WITHOUT_CLOUDS)
    with closing(sqlite3.connect(folder / "thumbs.db")) as opened:
        opened.execute("CREATE TABLE thumbnails (name TEXT)")
        opened.commit()


def make_dataset(folder: Path, count: int) -> dict[str, str]:
    """Fill a folder with files and folders; return the outcome of each recording, by key."""
    templates = folder.parent / "templates"
    make_templates(templates)
    expected: dict[str, str] = {}
    for number in range(count):
        name, outcome = list(OUTCOMES.items())[number % len(OUTCOMES)]
        stem, dot, suffix = name.partition(".")
        key = f"robot{number % 3}/day{number % 5}/{stem}{number}{dot}{suffix}"
        (folder / key).parent.mkdir(parents=True, exist_ok=True)
        template = templates / name
        (shutil.copytree if template.is_dir() else shutil.copyfile)(template, folder / key)
        if outcome != "-":
            expected[f"{key}/drive_2020-11-04-18-39-50_0.bag" if name == "split" else key] = outcome
    return expected

"""A made-up dataset: 200 tiny recordings in every container, good, damaged, and not recordings at all."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING

import zstandard

from support.builders import CHATTER, CONTENT, Recording, write_db3, write_mcap, write_rosbag1, write_rosbag2

if TYPE_CHECKING:
    from pathlib import Path

#: Heights that leave points of the content in its scans.
HEIGHTS = ("--min-height", "-2", "--max-height", "2")

WITHOUT_CLOUDS = Recording((CHATTER,), tuple(CONTENT.of(CHATTER.topic)))


def make_templates(folder: Path) -> dict[str, tuple[Path, str]]:
    """One recording of each kind, and the outcome of its conversion; ``-`` for files that are ignored."""
    folder.mkdir()
    first, second = CONTENT.halves()
    parts = folder / "split"
    parts.mkdir()
    write_rosbag1(parts / "drive_2020-11-04-18-39-50_0.bag", first)
    write_rosbag1(parts / "drive_2020-11-04-18-39-51_1.bag", second)
    bag = write_rosbag1(folder / "good.bag", CONTENT)
    mcap = write_mcap(folder / "good.mcap", CONTENT)
    packed = folder / "packed.mcap.zst"
    packed.write_bytes(zstandard.compress(mcap.read_bytes()))
    nameless = folder / "nameless"
    nameless.write_bytes(mcap.read_bytes())
    cut = folder / "cut.bag"
    cut.write_bytes(bag.read_bytes()[: int(bag.stat().st_size * 0.8)])
    cut_mcap = folder / "cut.mcap"
    cut_mcap.write_bytes(mcap.read_bytes()[: int(mcap.stat().st_size * 0.8)])
    empty, text, database, words = (folder / name for name in ("empty.bag", "text.mcap", "thumbs.db", "README.txt"))
    empty.touch()
    text.write_text("no recording")
    words.write_text("about this dataset")
    with closing(sqlite3.connect(database)) as opened:
        opened.execute("CREATE TABLE thumbnails (name TEXT)")
        opened.commit()
    return {
        "bag": (bag, "converted"),
        "mcap": (mcap, "converted"),
        "db3": (write_db3(folder / "good.db3", CONTENT), "converted"),
        "rosbag2": (write_rosbag2(folder / "rosbag2", CONTENT), "converted"),
        "split": (parts, "converted"),
        "packed": (packed, "converted"),
        "nameless": (nameless, "converted"),
        "cut": (cut, "incomplete"),
        "cut_mcap": (cut_mcap, "incomplete"),
        "without": (write_mcap(folder / "without.mcap", WITHOUT_CLOUDS), "failed"),
        "empty": (empty, "failed"),
        "text": (text, "failed"),
        "database": (database, "-"),
        "words": (words, "-"),
    }


def make_dataset(folder: Path, count: int = 200) -> dict[str, str]:
    """Fill a folder with files and folders; return the outcome of each recording, by key."""
    templates = make_templates(folder.parent / "templates")
    expected: dict[str, str] = {}
    kinds = list(templates.items())
    for number in range(count):
        kind, (template, outcome) = kinds[number % len(kinds)]
        place = folder / f"robot{number % 3}" / f"day{number % 5}"
        place.mkdir(parents=True, exist_ok=True)
        target = place / f"{kind}{number}{''.join(template.suffixes)}"
        if template.is_dir():
            shutil.copytree(template, target)
        else:
            shutil.copyfile(template, target)
        key = target.relative_to(folder).as_posix()
        if kind == "split":
            key += "/drive_2020-11-04-18-39-50_0.bag"
        if outcome != "-":
            expected[key] = outcome
    return expected


def contents(folder: Path) -> dict[str, bytes]:
    """The content of every file in a folder and below, but for the manifest."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "manifest.jsonl"
    }

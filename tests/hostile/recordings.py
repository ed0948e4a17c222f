"""Every kind of hostile recording in a folder: those of ``files/``, and those that are made."""

from __future__ import annotations

import random
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from fuzz.mutants import damaged
from fuzz.seeds import make_seeds, place
from hostile.test_side_files import journal
from support.builders import CONTENT, write_db3, write_rosbag2

if TYPE_CHECKING:
    from collections.abc import Callable

FILES = Path(__file__).with_name("files")

#: Seeds of which there is a mutant.
_DAMAGED = ("bag-lz4", "mcap-zstd", "mcap-unchunked", "rosbag2-split", "rosbag2-zstd", "db3", "db3-wal")


def make_hostile(folder: Path) -> dict[str, Path]:
    """Make all of them, each in a folder of its own; returns their paths by name.

    Whatever they lead to is the file ``victim``, in ``folder``.
    """
    victim = folder / "victim"
    victim.write_text("years of work")
    found = {}
    for file in sorted(FILES.iterdir()):
        if file.suffix != ".md":
            (folder / file.name).mkdir()
            found[file.name] = Path(shutil.copy(file, folder / file.name))
    for name, make in _MADE.items():
        (folder / name).mkdir()
        found[name] = make(folder / name, victim)
    seeds = {seed.name: seed for seed in make_seeds()}
    for number, name in enumerate(_DAMAGED):
        made = damaged(seeds[name], random.Random(number))
        found[f"mutant of {name}"] = place(made.files, made.seed.opened, folder / f"mutant of {name}")
    return found


def _journal_in_a_folder(folder: Path, victim: Path) -> Path:
    recording = write_rosbag2(folder / "drive", CONTENT)
    source = recording / "drive_0.db3"
    source.with_name("drive_0.db3-journal").write_bytes(journal(source, names=victim))
    return recording


def _links_beside(folder: Path, victim: Path) -> Path:
    source = write_db3(folder / "drive.db3", CONTENT)
    for suffix in ("-wal", "-journal", "-shm"):
        source.with_name(f"drive.db3{suffix}").symlink_to(victim)
    return source


def _metadata_that_leads_out(folder: Path, victim: Path) -> Path:
    recording = write_rosbag2(folder / "drive", CONTENT)
    metadata = recording / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("drive_0.db3", str(victim)))
    (recording / "link.db3").symlink_to(victim)
    return recording


_MADE: dict[str, Callable[[Path, Path], Path]] = {
    "journal in a folder": _journal_in_a_folder,
    "links beside": _links_beside,
    "metadata that leads out": _metadata_that_leads_out,
}

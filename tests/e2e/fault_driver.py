"""Conversions in children of this process, in each of which another call to the file system fails or kills.

Runs with ``faults.c`` loaded. Usage: ``fault_driver.py LIBRARY SOURCE FOLDER CASE``; a line of JSON for each child, the
first one without a fault. A child's folder is emptied after it, and what was in it is told.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import pc2scan
from pc2scan.errors import Pc2ScanError

CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "bag": ("out.bag", {}),
    "mcap": ("out.mcap", {}),
    "rosbag2": ("out", {"storage": "mcap"}),
    "sqlite3": ("out", {"storage": "sqlite3"}),
}
_FAULTS = {"ENOSPC": errno.ENOSPC, "EIO": errno.EIO, "EROFS": errno.EROFS, "SIGKILL": -1}


def digest(path: Path) -> str:
    """What is there, byte for byte."""
    found = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            found.update(file.name.encode() + b"\0" + file.read_bytes())
    return found.hexdigest()


def convert(source: Path, destination: Path, options: dict[str, Any]) -> int:
    """Convert as the command does; returns its exit status."""
    try:
        report = pc2scan.convert(
            source, destination, params=pc2scan.ProjectionParams(min_height=-9.0), jobs=1, keep_clouds=True, **options
        )
    except Pc2ScanError as err:
        return err.exit_status
    return report.exit_status


def child(work: Any, log: int | None = None) -> int:
    """Run in a child; returns its exit status, negative for the signal that ended it."""
    process = os.fork()
    if process == 0:
        status = 70
        try:
            status = work()
        finally:
            os._exit(status)
    if log is not None:
        os.close(log)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


class Runs:
    """One case: a destination that may be there before, and what becomes of it."""

    def __init__(self, library: ctypes.CDLL, source: Path, folder: Path, case: str) -> None:
        name, _, before = case.partition("+")
        self.library, self.source, self.folder = library, source, folder
        self.name, self.options = CASES[name]
        self.number = 0
        # Here, and not in a child: what a conversion imports is then there for every child.
        self.before = folder / "before" / self.name if before else None
        (folder / "before").mkdir()
        convert(source, folder / "before" / self.name, {**self.options, "start": "0.1"})

    def prepare(self) -> Path:
        """Make the folder, and with ``+over`` what is to be replaced in it."""
        self.number += 1
        folder = self.folder / str(self.number)
        folder.mkdir()
        if self.before is not None:
            (shutil.copytree if self.before.is_dir() else shutil.copy)(self.before, folder / self.name)
        return folder

    def run(self, at: int = 0, fault: int = 0) -> dict[str, Any]:
        """One conversion, and another into the same place."""
        folder = self.prepare()
        destination = folder / self.name
        old = digest(destination) if self.before else ""
        reading, log = os.pipe()

        def work() -> int:
            os.close(reading)
            self.library.fault_arm(os.fsencode(folder), at, fault, log)
            return convert(self.source, destination, {**self.options, "overwrite": self.before is not None})

        status = child(work, log)
        with os.fdopen(reading) as stream:
            calls = [line.rstrip("\n").replace(str(folder), ".").split(" ", 1) for line in stream]
        left = sorted(path.name for path in folder.iterdir())
        found = digest(destination) if destination.exists() else ""
        # A run that failed and left nothing is followed by one like any other.
        clean = status >= 0 and left == sorted({self.name} & set(left))
        again = 0 if clean else child(lambda: convert(self.source, destination, {**self.options, "overwrite": True}))
        outcome = {
            "at": at,
            "status": status,
            "calls": calls,
            "left": left,
            "destination": "old" if old and found == old else found,
            "old": old,
            "again": again,
            "left_again": sorted(path.name for path in folder.iterdir()),
            "destination_again": digest(destination) if destination.exists() else "",
        }
        shutil.rmtree(folder)
        return outcome


def chosen(calls: list[list[str]], fault: str, case: str) -> list[int]:
    """Which calls a fault is tried on: all that tell something new.

    A disk that fails at a write is like one that is full; of writes one after the other, the first and the last tell
    it; and what is there before is not touched until the new one takes its place.
    """
    first = next(n for n, (call, _) in enumerate(calls) if call in ("link", "rename")) if "+" in case else 0
    alike = {n + 1 for n in range(1, len(calls) - 1) if calls[n - 1] == calls[n] == calls[n + 1]}
    tried = sorted({*range(max(first, 1), len(calls) + 1)} - alike)
    return [n for n in tried if fault != "EIO" or calls[n - 1][0] != "write"]


def tell(fault: str, outcome: dict[str, Any]) -> None:
    """Print an outcome on a line."""
    sys.stdout.write(json.dumps({"fault": fault, **outcome}) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Print an outcome a line."""
    library, source, folder, case, *faults = sys.argv[1:]
    runs = Runs(ctypes.CDLL(library), Path(source), Path(folder), case)
    sound = runs.run()
    tell("", sound)
    for name in faults:
        for at in chosen(sound["calls"], name, case):
            tell(name, runs.run(at, _FAULTS[name]))


if __name__ == "__main__":
    main()

"""Random trees of sources, outputs, links, URLs, earlier runs and files of the user: only what may change does.

The oracle knows nothing of records. It knows what each run writes (from the same run into an empty folder) and what
each earlier run left, and says which paths a run may replace or remove.
"""

from __future__ import annotations

import os
import random
import shutil
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import pytest

import pc2scan
from pc2scan.errors import Pc2ScanError
from support import ROOT, sampled
from support.batches import batch

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"
HEIGHTS: dict[str, Any] = {"min_height": -0.3}

#: Of a file its bytes and its time, of a link where it leads.
State = tuple[bytes, int] | str

#: Names that users have, among them those that runs write.
NAMES = (
    *("drive.bag", "drive_0.bag", "drive_1.bag", "drive_3.bag", "drive_9.bag", "drive_02.bag", "drive_x.bag"),
    *("a_scan.bag", "a_scan_0.bag", "a_scan_4.bag", "a_scan_8.bag", "sub/b_scan.bag", "notes.txt"),
    *("logs/scan.npz", "logs/labels.npz", "logs/deep/mine.csv", "a/labels.npz", "a/scan.csv", "sub/b/mine.txt"),
    *("folder/metadata.yaml", "folder/mine.mcap", "folder/folder_7.mcap", "a_scan/notes.txt"),
)


def seen(folder: Path) -> dict[str, State]:
    found: dict[str, State] = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            found[name] = str(path.readlink())
        elif path.is_file():
            found[name] = path.read_bytes(), path.stat().st_mtime_ns
    return found


@dataclass(frozen=True)
class Run:
    """A command: what it is called with, and where it writes."""

    name: str
    #: The name of the destination, in the folder of the outputs.
    to: str
    words: Mapping[str, Any]
    #: Whether it keeps a record, by which a later run may replace without being asked, and remove.
    recorded: bool = False
    #: The folder that it replaces as a whole.
    folder: str = ""

    def do(self, sources: Path, destination: str, *, overwrite: bool) -> bool:
        """Run it; return whether all went well."""
        if self.name == "batch":
            return batch(sources, destination, overwrite=overwrite, **self.words).exit_status == 0
        call: Callable[..., object] = pc2scan.convert if self.name == "convert" else pc2scan.export
        try:
            call(sources / "a.bag", destination, overwrite=overwrite, **HEIGHTS, **self.words)
        except Pc2ScanError:
            return False
        return True


RUNS = (
    Run("convert", "drive.bag", {"only_scans": True}),
    Run("convert", "drive.bag", {"only_scans": True, "beams": 90}),
    Run("convert", "folder", {"only_scans": True}, folder="folder"),
    *(Run("export", "logs/", {"format": form}, recorded=True, folder="logs") for form in ("npz", "csv")),
    *(Run("batch", "", {"only_scans": True, **more}, recorded=True) for more in ({}, {"beams": 90}, {"to": "rosbag2"})),
    *(Run("batch", "", {"format": form}, recorded=True) for form in ("npz", "csv")),
)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[int, frozenset[str]]:
    """What each run writes, found out in an empty folder."""
    found = {}
    for number, run in enumerate(RUNS):
        folder = tmp_path_factory.mktemp("alone")
        make_sources(folder)
        (folder / "out").mkdir()
        assert run.do(folder / "in", f"{folder}/out/{run.to}", overwrite=False)
        found[number] = frozenset(seen(folder / "out"))
    return found


def make_sources(folder: Path) -> None:
    (folder / "in" / "sub").mkdir(parents=True)
    for name in ("a.bag", "sub/b.bag"):
        shutil.copy(HALL, folder / "in" / name)


@dataclass
class World:
    """A folder with sources, outputs and a folder elsewhere, and what the runs in it have left."""

    root: Path
    random: random.Random
    #: What a run that keeps a record left at a path, and which folder it belongs to as a whole.
    left: dict[str, State] = field(default_factory=dict)
    #: Whether the user has neither changed nor removed anything that a run wrote.
    is_whole: bool = True

    @property
    def out(self) -> Path:
        return self.root / "out"

    def user_acts(self) -> None:
        """Add, change, remove or link something."""
        choose = self.random.choice
        records = ("manifest.jsonl", ".pc2scan-files.json")
        files = [
            path
            for path in self.out.rglob("*")
            if path.is_file() and not path.is_symlink() and path.name not in records
        ]
        act = choose(("add", "add", "add", "change", "remove", "link", "hard link", "linked folder"))
        path = self.out / choose(NAMES)
        if act == "change" and files:
            changed = choose(files)
            # As long as before: only its bytes and its time differ. The file of a hard link keeps its content.
            data = changed.read_bytes()[::-1]
            changed.unlink()
            changed.write_bytes(data)
            self.is_whole = False
        elif act == "remove" and files:
            choose(files).unlink()
            self.is_whole = False
        elif act == "linked folder":
            folder = self.out / choose(("sub", "a", "logs", "folder", "a_scan"))
            if not os.path.lexists(folder):
                folder.symlink_to(self.root / "elsewhere")
        elif not os.path.lexists(path) and all(not above.is_symlink() for above in path.parents):
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
            except OSError:
                return
            if act == "link":
                path.symlink_to(choose((self.root / "in" / "a.bag", self.root / "elsewhere" / "mine", path)))
            elif act == "hard link":
                os.link(self.root / "in" / choose(("a.bag", "sub/b.bag")), path)
            else:
                path.write_text(f"mine {self.random.random()}")

    def spelled(self, to: str) -> str:
        """One of the names of a destination."""
        plain = f"{self.out}/{to}"
        return self.random.choice(
            (
                plain,
                f"{self.root}/in/../out/{to}",
                f"{self.root}/linked/{to}",
                f"file://{plain}",
                f"file:{plain}",
                f"file://localhost{quote(plain)}",
                "file://" + "".join(f"%{ord(sign):02x}" if sign != "/" else sign for sign in plain),
            )
        )


def check(world: World, run: Run, writes: frozenset[str], *, overwrite: bool) -> None:
    """Do a run, and compare what it changed with what it may change."""
    root, out = world.root, world.out
    before = seen(root)
    # A folder of the user's that is empty stays, too.
    has_empty = any(path.is_dir() and not path.is_symlink() and not any(path.iterdir()) for path in out.rglob("*"))
    was = {name: before.get(f"out/{name}") for name in {*writes, *(name.removeprefix("out/") for name in before)}}
    ended = run.do(root / "in", world.spelled(run.to), overwrite=overwrite)
    after = seen(root)
    assert not [name for name in after if "pc2scan-partial" in name or name.endswith(("pc2scan-old", "begun.json"))]

    def as_left(name: str) -> bool:
        return name in world.left and world.left[name] == was.get(name)

    def may_change(path: str) -> bool:
        """The oracle."""
        if not path.startswith("out/"):
            return False
        name = path.removeprefix("out/")
        if name == "manifest.jsonl":
            return run.name == "batch"
        if name in writes and (was.get(name) is None or overwrite or (run.name == "batch" and name in world.left)):
            return True
        # A link in place of a folder that is written is replaced, not followed.
        if isinstance(was.get(name), str) and any(other.startswith(f"{name}/") for other in writes):
            return overwrite or (run.name == "batch" and any(n.startswith(f"{name}/") for n in world.left))
        # A rosbag2 directory that a run replaces is one recording.
        if run.folder == "folder" and name.startswith("folder/"):
            return overwrite and was[name] is not None and name in world.left
        return as_left(name) and after.get(path) is None and (run.recorded or bool(run.folder))

    wrong = [path for path in sorted({*before, *after}) if before.get(path) != after.get(path) and not may_change(path)]
    assert not wrong, (run, overwrite, wrong)
    if not ended and run.name != "batch":
        assert before == after, (run, overwrite)
    # It is not too careful either.
    foreign = {name for name, state in was.items() if state is not None and name not in world.left}
    is_free = not any(name in writes or any(w.startswith(f"{name}/") for w in writes) for name in foreign)
    in_folders = {run.folder} if run.folder else {n.partition("/")[0] for n in writes if "/" in n} | {"sub/b", "a"}
    is_empty = not any(name.startswith(f"{folder}/") for name in foreign for folder in in_folders if folder)
    numbered = any(name.endswith("_0.bag") for name in writes)
    is_plain = not (numbered or has_empty or any(map(os.path.islink, out.iterdir())))
    if overwrite and is_free and is_empty and is_plain:
        assert ended or not world.is_whole, (run, sorted(foreign))
    for name in writes:
        state = after.get(f"out/{name}")
        assert state is not None or not ended, (run, name)
        # Of a batch, some results may have been written and others not.
        if state is not None and (ended or state != was[name]):
            if run.recorded or run.folder == "folder":
                world.left[name] = state
            else:
                world.left.pop(name, None)
    for name in [name for name in world.left if f"out/{name}" not in after]:
        del world.left[name]


@pytest.mark.parametrize("seed", sampled(range(40), 10))
def test_only_what_may_change_changes(seed: int, written: dict[int, frozenset[str]], tmp_path: Path) -> None:
    make_sources(tmp_path)
    for name in ("out", "elsewhere"):
        (tmp_path / name).mkdir()
    (tmp_path / "linked").symlink_to("out")
    (tmp_path / "elsewhere" / "mine").write_text("mine")
    (tmp_path / "elsewhere" / "scan.npz").write_text("mine")
    world = World(tmp_path, random.Random(seed))
    for _ in range(7):
        for _ in range(world.random.choice((0, 0, 1, 1, 3))):
            world.user_acts()
        number = world.random.randrange(len(RUNS))
        check(world, RUNS[number], written[number], overwrite=world.random.random() < 0.6)

"""A command writes over nothing of the user's; what is typed and said is in ``tests/transcripts/outputs.txt``."""

from __future__ import annotations

import resource
import shutil
import tempfile
from itertools import product
from pathlib import Path

import pytest

from support import HALL, ROOT, sampled
from support.builders import POINTS, T0, Recording, cloud, item, points_of, write_rosbag1
from support.command import run

#: What each path below a folder is: of a file its numbers and content, of a link where it leads to.
State = dict[str, tuple[object, ...]]


def state_of(folder: Path) -> State:
    """All that a call could change in a folder, but for the times of reading."""
    found: State = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        content = str(path.readlink()) if path.is_symlink() else path.read_bytes() if path.is_file() else ""
        found[path.relative_to(folder).as_posix()] = (*status[:4], status.st_ctime_ns, content)
    return found


def changed(before: State, folder: Path) -> set[str]:
    after = state_of(folder)
    return {path for path in {*after, *before} if before.get(path) != after.get(path)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What a user has."""
    shutil.copy(HALL, tmp_path / "drive.bag")
    (tmp_path / "thesis.tex").write_text("three years of work")
    return tmp_path


#: What is typed, with SRC for a recording; all that is written begins with DST.
EVERYWHERE = (
    "info SRC",
    "repair SRC -o DST.mcap --report DST.json --quiet",
    "convert SRC -o DST --storage sqlite3 --tf-from SRC --min-height -0.5 --quiet",
    "convert SRC -o DST --overwrite --strict --min-height -0.5 --quiet",
)
OTHERS = (
    "tf SRC --json",
    "check SRC --tf-from SRC",
    "diff SRC SRC --all-topics --quiet",
    "convert SRC -o DST.bag --min-height -0.5",
    "view SRC -o DST.html --clouds 1",
    "export SRC -o DST.npz --pose-frame odom --min-height -0.5",
    "map SRC -o DST.yaml --min-height -0.5",
    "plot SRC -o DST.svg --min-height -0.5",
)


@pytest.mark.parametrize("hostile", [pytest.param(True, marks=pytest.mark.slow), False])
def test_no_command_touches_what_is_not_its_own(hostile: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither sources and what lies beside them, nor the home; and nothing stays among the temporary files."""
    watched, out = tmp_path / "watched", tmp_path / "out"
    (watched / "tmp").mkdir(parents=True)
    monkeypatch.setenv("HOME", str(watched))
    monkeypatch.setattr(tempfile, "tempdir", str(watched / "tmp"))
    if hostile:
        files = ROOT / "tests" / "hostile" / "files"
        sources = [Path(shutil.copy(file, watched)) for file in sorted(files.iterdir()) if file.suffix != ".md"]
    else:
        sources = [Path(shutil.copy(HALL, watched)), Path(shutil.copytree(HALL.with_suffix(""), watched / "hall"))]
    done = []
    for source in sources:
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        for typed in (*EVERYWHERE, *OTHERS) if source.name == HALL.name else EVERYWHERE:
            before = state_of(watched)
            words = [word.replace("SRC", str(source)).replace("DST", str(out / "DST")) for word in typed.split()]
            done.append(run(*words, cwd=out))
            assert changed(before, watched) <= {"tmp"}, words
            assert (done[-1].status in (0, 1, 2, 3, 4), "Traceback" in done[-1].stderr) == (True, False), words
            assert {path.name.partition(".")[0] for path in out.iterdir()} <= {"DST"}, words
    assert sum(each.status in (0, 3) for each in done) > len(done) / 2


@pytest.mark.parametrize(
    ("output", "planted", "target"),
    sampled(
        product(
            ("out.bag", "report.json"),
            (".pc2scan-partial", ".pc2scan-partial.lock", ".pc2scan-old"),
            ("thesis.tex", "missing"),
        ),
        4,
    ),
)
def test_links_that_somebody_planted_are_not_followed(output: str, planted: str, target: str, folder: Path) -> None:
    (folder / (output + planted)).symlink_to(target)
    before = state_of(folder)
    done = run("convert", folder / "drive.bag", "-o", folder / "out.bag", "--report", folder / "report.json")
    assert done.status in (0, 2, 3), done.stderr
    assert changed(before, folder) <= {output + planted, "out.bag", "report.json"}
    if planted.endswith(".lock"):
        assert "move it away" in done.stderr


def test_a_report_for_which_there_is_no_room_undoes_nothing(tmp_path: Path) -> None:
    """The recording is there, so the exit status is not 1; the report is not, so it is not 0 either."""
    items = [item(POINTS, T0, lambda g, s: cloud(points_of(s), g, seq=s), 0)]
    # Too many messages to be skipped, each with its reason: a report that is longer than the recording.
    items += [item(POINTS, T0 + n, lambda g, s: cloud(points_of(s), g, seq=s)[:40], n) for n in range(1, 100)]
    source = write_rosbag1(tmp_path / "drive.bag", Recording((POINTS,), tuple(items)))
    output, report = tmp_path / "out.mcap", tmp_path / "report.json"
    call = ("convert", source, "-o", output, "--only-scans", "--report", report)
    limit, before = 12_000, resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    done = run(*call)
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert done.status == 3, done.stderr
    assert f"warning: {report}: the report is not written: cannot be written: File too large" in done.stderr
    assert f"{output} is" in done.stderr
    assert "/scan" in done.stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.bag", "out.mcap"]
    assert run("info", output).status == 0
    # It is for want of room, and of nothing else, that it was not written.
    assert run(*call, "--overwrite").status == 3
    assert report.stat().st_size > limit


@pytest.fixture
def cases(folder: Path) -> Path:
    """Two golden cases, the second with an input elsewhere."""
    for name in ("one", "two"):
        (folder / "golden" / name).mkdir(parents=True)
    shutil.copy(HALL, folder / "golden" / "one" / "input.bag")
    (folder / "golden" / "two" / "case.yaml").write_text("input: ../../drive.bag\n")
    assert run("golden", folder / "golden", "--update").status == 0
    return folder / "golden"


def test_links_in_a_golden_folder_are_not_followed(cases: Path) -> None:
    """A folder of cases may be untrusted: it may come with a pull request."""
    folder = cases.parent
    (cases / "one" / "params.yaml").write_text("pointcloud_to_laserscan:\n  ros__parameters:\n    min_height: -0.3\n")
    (cases / "one" / "expected.txt.pc2scan-partial").symlink_to(folder / "thesis.tex")
    (cases / "two" / "expected.txt").unlink()
    (cases / "two" / "expected.txt").symlink_to(folder / "drive.bag")
    before = state_of(folder)
    done = run("golden", cases, "--update")
    assert done.status == 2
    assert "updated one" in done.stdout
    assert "is a file of a case" in done.stdout
    written = "golden/one/expected.txt"
    assert changed(before, folder) == {"golden/one", written, f"{written}.pc2scan-partial"}

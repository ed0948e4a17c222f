"""No command touches a file that is not its own: its output, the lock beside it, temporary files in a private folder.

Every command runs over every fixture and every hostile recording while the system's calls are traced.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from e2e.system_calls import Job, Traced, no_tracer, trace
from e2e.trace_driver import WAYS
from hostile.recordings import make_hostile
from pc2scan.cli.commands import COMMANDS
from support import ROOT, sampled
from support.command import COMMAND

if TYPE_CHECKING:
    from collections.abc import Iterator

_REASON = no_tracer()
pytestmark = pytest.mark.skipif(_REASON is not None, reason=_REASON or "")

FIXTURES = ROOT / "fixtures"
#: What a run calls the output while it writes it, and its lock.
OWN = ("", ".pc2scan-partial", ".pc2scan-old", ".pc2scan-partial.lock")

HEIGHTS = ("--min-height", "-0.5", "--quiet")


def allowed(job: Job, path: Path) -> bool:
    """Whether a job may touch a path."""
    return any(path.is_relative_to(output.with_name(output.name + own)) for output in job.writes for own in OWN)


def foreign(done: Traced) -> list[str]:
    """What a job touched and must not, as text."""
    return [f"{touch.call} {touch.path}" for touch in done.touched if not allowed(done.job, touch.path)]


State = dict[str, tuple[int, ...] | str]


def state_of(folder: Path) -> State:
    """Everything that a call could change in a folder, but for the times of reading."""
    found: State = {}
    for path in sorted(folder.rglob("*")):
        at = path.lstat()
        numbers = (at.st_ino, at.st_mode, at.st_nlink, at.st_uid, at.st_size, at.st_mtime_ns, at.st_ctime_ns)
        found[str(path.relative_to(folder))] = str(path.readlink()) if path.is_symlink() else numbers
    return found


def jobs_for(source: Path, folder: Path) -> Iterator[Job]:
    """Every command on a recording; their outputs are in a folder of their own."""
    calls: list[tuple[str | Path, ...]] = [
        ("info", source),
        ("tf", source, "--json"),
        ("check", source, "--tf-from", source),
        ("diff", source, source, "--all-topics", "--quiet"),
        ("repair", source, "-o", "DST.mcap", "--report", "DST.json", "--quiet"),
        ("repair", source, "-o", "DST", "--overwrite", "--quiet"),
        ("convert", source, "-o", "DST.bag", "--report", "DST.json", *HEIGHTS),
        ("convert", source, "-o", "DST", "--storage", "sqlite3", "--tf-from", source, *HEIGHTS),
        ("convert", source, "-o", "DST", "--overwrite", "--strict", *HEIGHTS),
        ("view", source, "-o", "DST.html", "--clouds", "1"),
        ("export", source, "-o", "DST.npz", "--pose-frame", "odom", *HEIGHTS),
        ("map", source, "-o", "DST.yaml", *HEIGHTS[:2]),
    ]
    endings = ("", ".mcap", ".bag", ".json", ".html", ".npz", ".yaml", ".pgm", ".png")
    for number, call in enumerate(calls):
        outputs = tuple(folder / f"{number}{ending}" for ending in endings)
        # What is there is replaced.
        if "--overwrite" in call:
            shutil.copytree(FIXTURES / "hall", folder / str(number))
        yield Job(tuple(str(part).replace("DST", str(folder / str(number))) for part in call), folder, outputs)


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which nothing may change."""
    return tmp_path_factory.mktemp("sources")


@pytest.fixture(scope="module")
def recordings(sources: Path) -> dict[str, Path]:
    """Copies of the fixtures, and the hostile recordings."""
    found = make_hostile(sources)
    for name in ("hall.bag", "hall.mcap"):
        found[name] = Path(shutil.copy(FIXTURES / name, sources / name))
    found["hall"] = Path(shutil.copytree(FIXTURES / "hall", sources / "hall"))
    found["hall.db3"] = Path(shutil.copy(FIXTURES / "hall" / "hall_0.db3", sources / "hall.db3"))
    return found


@pytest.mark.slow
def test_no_command_touches_what_is_not_its_own(recordings: dict[str, Path], sources: Path, tmp_path: Path) -> None:
    jobs: list[Job] = []
    for name, source in recordings.items():
        folder = tmp_path / name
        folder.mkdir()
        jobs += jobs_for(source, folder)
    before = state_of(sources)
    done = trace(jobs, tmp_path)
    assert {job.job.arguments[0] for job in done} == {*COMMANDS} - {"batch", "golden", "plot"}
    assert {" ".join(each.job.arguments): foreign(each) for each in done if foreign(each)} == {}
    assert state_of(sources) == before
    for each in done:
        assert each.status in (0, 1, 2, 3), (each.job.arguments, each.said)
        assert "Traceback" not in each.said, each.said
    # What they write themselves is in the trace.
    for each in done:
        if each.job.arguments[0] in ("convert", "repair") and each.status in (0, 3):
            assert {touch.path for touch in each.touched} & set(each.job.writes), each.job.arguments
    assert sum(each.status in (0, 3) for each in done) > len(done) / 2


@pytest.mark.slow
def test_golden_touches_only_expected_outputs(recordings: dict[str, Path], sources: Path, tmp_path: Path) -> None:
    cases = tmp_path / "golden"
    shutil.copytree(FIXTURES / "golden" / "defaults", cases / "defaults")
    for name in ("hall.bag", "hall.mcap", "hall", "journal", "metadata that leads out"):
        (cases / name).mkdir()
        (cases / name / "case.yaml").write_text(f"input: {recordings[name]}\n")
    expected = tuple(case / "expected.txt" for case in cases.iterdir() if case.name != "defaults")
    before = state_of(cases), state_of(sources)
    check, update, again = trace(
        [
            Job(("golden", str(cases)), tmp_path, ()),
            Job(("golden", str(cases), "--update"), tmp_path, expected),
            Job(("golden", str(cases)), tmp_path, ()),
        ],
        tmp_path,
    )
    assert [foreign(each) for each in (check, update, again)] == [[], [], []]
    after = state_of(cases), state_of(sources)
    assert after[1] == before[1]
    assert {path for path in after[0] if before[0].get(path) != after[0][path] and path.endswith(".txt")}
    assert "passed  hall" in again.said


@pytest.mark.slow
def test_plot_touches_only_its_figure(
    recordings: dict[str, Path], sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)
    before = state_of(sources)
    figures = [tmp_path / f"{number}.svg" for number in range(2)]
    jobs = [
        Job(("plot", str(recordings[name]), "-o", str(figure)), tmp_path, (figure,))
        for name, figure in zip(("hall.bag", "metadata that leads out"), figures, strict=True)
    ]
    done = trace(jobs, tmp_path)
    assert [foreign(each) for each in done] == [[], []]
    assert (done[0].status, figures[0].is_file()) == (0, True), done[0].said
    assert state_of(sources) == before


@pytest.mark.parametrize("name", sampled(["hall.bag", "hall", "journal"], 1))
def test_the_command_in_a_process_of_its_own(
    name: str, recordings: dict[str, Path], sources: Path, tmp_path: Path
) -> None:
    """From its start to its end, with the modules loading."""
    source = recordings[name]
    (tmp_path / "out").mkdir()
    destination = tmp_path / "out" / "DST.mcap"
    call = (*COMMAND, "convert", str(source), "-o", str(destination), *HEIGHTS)
    before = state_of(sources)
    (done,) = trace([Job(("execute", *call), tmp_path, (destination,))], tmp_path)
    # A journal that names a super-journal is refused.
    assert (done.status, foreign(done)) == (1 if name == "journal" else 0, []), done.said
    assert (destination in [touch.path for touch in done.touched]) == (name != "journal")
    assert state_of(sources) == before


@pytest.mark.slow
def test_a_destination_that_nobody_named(recordings: dict[str, Path], tmp_path: Path) -> None:
    source = tmp_path / "drive.bag"
    shutil.copy(recordings["hall.bag"], source)
    jobs = [
        Job(("convert", "drive.bag", *HEIGHTS), tmp_path, (tmp_path / "drive_scan.bag",)),
        Job(("repair", "drive.bag", "--quiet"), tmp_path, (tmp_path / "drive_repaired.bag",)),
    ]
    before = source.read_bytes()
    for done in trace(jobs, tmp_path):
        assert (done.status, foreign(done)) == (0, []), done.said
        assert done.job.writes[0].exists()
    assert source.read_bytes() == before


def test_a_command_that_touches_other_files_is_seen(tmp_path: Path) -> None:
    """The test above can fail: in each of these ways."""
    jobs = []
    for way in WAYS:
        place = tmp_path / way
        (place / "out").mkdir(parents=True)
        (place / "target").write_text("O_WRONLY")
        (place / "new").write_text("here")
        (place / "out" / "link").symlink_to(place / "target")
        jobs.append(Job(("misbehave", way, str(place / "target")), tmp_path, (place / "out",)))
    for done in trace(jobs, tmp_path):
        _, name = WAYS[done.job.arguments[1]]
        if name:
            assert any(line.endswith(f"{os.sep}{name}") for line in foreign(done)), done
        else:
            assert (done.status, done.touched) == (0, ())

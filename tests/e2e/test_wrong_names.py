"""Names that nearly match, exit statuses, errors as JSON, and standard output that is closed."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from support import ROOT
from support.command import COMMAND, Finished, environment, run

HALL = ROOT / "fixtures" / "hall.bag"

COMMANDS: dict[str, list[str | Path]] = {
    "convert": [],
    "check": [],
    "info": [],
    "tf": [],
    "map": ["--png", "map.png"],
    "repair": [],
    "diff": [HALL],
    "golden": [],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_missing_file_is_the_same_in_all_commands(command: str, tmp_path: Path) -> None:
    (tmp_path / "drive.bag").touch()
    done = run(command, tmp_path / "drvie.bag", *COMMANDS[command])
    assert (done.status, done.stdout) == (2, "")
    error, hint = done.stderr.splitlines()
    assert error == f"error: {tmp_path / 'drvie.bag'}: does not exist"
    assert hint == f"hint: did you mean {tmp_path / 'drive.bag'}?"


@pytest.mark.parametrize("option", ["--params-file", "--static-tf-file"])
def test_a_missing_file_of_an_option_too(option: str, tmp_path: Path) -> None:
    (tmp_path / "params.yaml").touch()
    done = run("convert", HALL, "-o", tmp_path / "o.bag", option, tmp_path / "parms.yaml")
    assert done.status == 2
    assert f"did you mean {tmp_path / 'params.yaml'}?" in done.stderr


def test_a_lookup_at_the_latest_time_names_no_stamp() -> None:
    done = run("tf", HALL, "--lookup", "base_link", "lidra")
    assert done.stderr.startswith("error: no transform has the source frame 'lidra'")


def test_a_lookup_at_a_time_from_the_beginning() -> None:
    done = run("tf", HALL, "--lookup", "odom", "lidar", "--at", "0.1")
    hint = "--at counts from 1970; 0.1 s after the first transform is --at 1700000000.100000000"
    assert (done.status, done.stderr.splitlines()[1]) == (1, f"hint: {hint}")
    assert run("tf", HALL, "--lookup", "odom", "lidar", "--at", hint.rsplit(maxsplit=1)[-1]).status == 0


def test_a_wrong_target_frame_of_info() -> None:
    done = run("info", HALL, "--target-frame", "base_lnk")
    assert (done.status, "(did you mean base_link? " in done.stdout) == (1, True)
    assert run("info", HALL, "--target-frame", "base_link").status == 0


def test_what_cannot_be_judged_is_no_verdict(tmp_path: Path) -> None:
    broken = tmp_path / "broken.bag"
    broken.write_bytes(b"nothing that is a recording")
    assert {command: run(command, broken, *COMMANDS[command]).status for command in ("check", "diff", "golden")} == {
        "check": 2,
        "diff": 2,
        "golden": 2,
    }
    assert {command: run(command, broken).status for command in ("convert", "info", "tf", "repair")} == {
        "convert": 1,
        "info": 1,
        "tf": 1,
        "repair": 1,
    }


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (("convert", HALL, "--topic", "/lidar/point"), "/points"),
        (("convert", HALL, "--topic", "Points"), "/points"),
        (("convert", HALL, "--keep", "/tf_statik"), "/tf_static"),
        (("convert", HALL, "--preset", "slam-tolbox"), "slam_toolbox"),
        (("convert", HALL, "--geometry", "centred"), "centered"),
        (("convert", HALL, "-p", "min_hight:=0"), "'min_height'"),
        (("convert", HALL, "--storage", "sqlite"), "sqlite3"),
        (("convert", HALL, "--on-error", "Skipp"), "skip"),
        (("convert", HALL, "--target-frame", "baselink"), "base_link"),
        (("tf", HALL, "--lookup", "base_link", "Lidar"), "lidar"),
        (("tf", HALL, "--tf-topic", "/tfstatic"), "/tf_static"),
        (("check", HALL, "--for", "slamtoolbox"), "slam_toolbox"),
        (("diff", HALL, HALL, "--topic", "/lidar/pionts"), "/points"),
        (("diff", HALL, HALL, "--ignore", "frameid"), "frame_id"),
        (("golden", ROOT / "fixtures" / "golden", "-k", "tf_sttaic"), "tf_static"),
    ],
    ids=lambda value: "-".join(map(str, value[-2:])) if isinstance(value, tuple) else None,
)
def test_did_you_mean(arguments: tuple[str | Path, ...], meant: str, tmp_path: Path) -> None:
    command, source, *options = arguments
    if source == HALL:
        source = shutil.copy(HALL, tmp_path)
    done = run(command, source, *options)
    assert f"did you mean {meant}?" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "kind", "status"),
    [
        (("info", "nothing.bag"), "MissingError", 2),
        (("check", HALL), "TopicError", 2),
        (("tf", HALL, "--lookup", "base_link", "nothing"), "UnconnectedError", 1),
        (("diff", HALL, "nothing.bag"), "MissingError", 2),
        (("repair", "nothing.bag"), "MissingError", 2),
        (("golden", "nothing"), "UsageError", 2),
        (("info", HALL, "--samples", "x"), "UsageError", 2),
    ],
    ids=str,
)
def test_errors_as_json(arguments: tuple[str | Path, ...], kind: str, status: int, tmp_path: Path) -> None:
    done = run(*arguments, "--json", cwd=tmp_path)
    document = json.loads(done.stdout)
    assert done.status == document["exit_status"] == status
    assert document["error"]["class"] == kind
    assert document["error"]["message"] in done.stderr
    assert done.stderr.startswith("error: ")


def into_full(*arguments: str | Path) -> Finished:
    """Run a command whose standard output has no room."""
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*COMMAND, *map(str, arguments)],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(),
            check=False,
        )
    return Finished(done.returncode, "", done.stderr)


needs_full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")


@needs_full
@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (("info", HALL), 1),
        (("info", HALL, "--json"), 1),
        (("tf", HALL), 1),
        (("diff", HALL, HALL), 2),
        (("golden", ROOT / "fixtures" / "golden", "-k", "defaults"), 2),
        (("convert", "--help"), 1),
        (("--help",), 1),
    ],
    ids=str,
)
def test_output_without_room(arguments: tuple[str | Path, ...], status: int) -> None:
    done = into_full(*arguments)
    assert done.status == status
    assert done.stderr.startswith("error: standard output cannot be written: No space left on device")
    assert len(done.stderr.splitlines()) == 1


@needs_full
@pytest.mark.parametrize(
    ("command", "output"), [("convert", "scan.bag"), ("map", "map.yaml"), ("view", "page.html")], ids=str
)
def test_a_command_without_room_for_its_summary(command: str, output: str, tmp_path: Path) -> None:
    done = into_full(command, HALL, "-o", tmp_path / output, "--min-height=-0.3")
    assert done.status == 3
    assert done.stderr.splitlines()[-1].endswith("No space left on device; the output is written")
    assert (tmp_path / output).stat().st_size > 0
    if command == "convert":
        assert run("diff", tmp_path / output, tmp_path / output).status == 0


@pytest.mark.parametrize(
    "arguments", [("info", HALL), ("tf", HALL), ("diff", HALL, HALL), ("convert", "--help")], ids=str
)
def test_a_reader_that_has_read_enough(arguments: tuple[str | Path, ...]) -> None:
    process = subprocess.Popen(
        [*COMMAND, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment()
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    said = process.stderr.read()
    process.stderr.close()
    assert (process.wait(60), said) == (141, b"")

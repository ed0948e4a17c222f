"""The functions of the library take what Python users have, in the words of the command line."""

from __future__ import annotations

import copy
import inspect
import pickle
import re
import subprocess
import sys
import traceback
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pc2scan
from pc2scan.errors import ParameterError, Pc2ScanError, TransformError, UsageError
from pc2scan.model import own_data
from support import HALL, ROOT
from support.command import run

CASES = ROOT / "fixtures" / "golden"

#: What each function takes besides a recording.
CALLS: dict[str, Any] = {
    "check": {},
    "clouds": {},
    "convert": {"destination": "out.mcap", "min_height": -0.3},
    "diff": {"b": HALL},
    "info": {},
    "repair": {"destination": "out.bag"},
    "scans": {"min_height": -0.3},
    "tf": {},
}

# --- paths ---


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("kind", [str, Path])
def test_a_path_is_text_or_an_object(name: str, kind: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    function, source = getattr(pc2scan, name), HALL
    if name == "check":
        source = tmp_path / "scans.mcap"
        pc2scan.convert(HALL, source, preset="slam_toolbox", min_height=-0.3)
    keywords = {key: kind(value) if key in {"destination", "b"} else value for key, value in CALLS[name].items()}
    assert function(kind(source), **keywords)
    # "~" is the home folder, as in a shell.
    monkeypatch.setenv("HOME", str(HALL.parent))
    assert pc2scan.info([kind("~/hall.bag")]).messages == 11
    # A folder of this name comes first.
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "~").symlink_to(HALL.parent)
    assert pc2scan.info([kind("~/hall.bag")]).messages == 11


# --- arguments ---


def test_the_words_are_those_of_the_command_line(tmp_path: Path) -> None:
    options = "--preset slam_toolbox --min-height -0.3 --topic /points --start 0.1 --end 0.35 --keep /tf*"
    transform = "--static-tf", "map odom 1 2 0 0 0 0.5", "--write-static-tf", "--target-frame", "map"
    assert run("convert", HALL, "-o", "typed.mcap", *options.split(), *transform, cwd=tmp_path).status == 0
    report = pc2scan.convert(
        str(HALL),
        str(tmp_path / "called.mcap"),
        preset="slam_toolbox",
        min_height=-0.3,
        topics="/points",
        start=0.1,
        end="0.35",
        keep="/tf*",
        static_tf="map odom 1 2 0 0 0 0.5",
        write_static_tf=True,
        target_frame="map",
    )
    assert (tmp_path / "called.mcap").read_bytes() == (tmp_path / "typed.mcap").read_bytes()
    assert (report.exit_status, report.scans[0].origins["min_height"]) == (0, "the call")


def test_a_file_of_parameters_is_beaten_by_keywords(tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("min_height: -0.5\nrange_max: 20.0\n", "utf-8")
    report = pc2scan.convert(HALL, tmp_path / "a.bag", params_file=str(file), preset="nav2", range_max=np.float32(15))
    params = report.scans[0].params
    assert (params.min_height, params.range_max, params.range_min) == (-0.5, 15.0, 0.1)
    params = pc2scan.ProjectionParams.from_file(file, min_height=-0.25)
    assert (params.min_height, params.range_max) == (-0.25, 20.0)
    with pytest.raises(UsageError, match="`preset` has no effect with `params`, which has all parameters"):
        pc2scan.convert(HALL, tmp_path / "b.bag", params=params, preset="nav2")
    report = pc2scan.convert(HALL, tmp_path / "b.bag", params=params, max_height=3)
    assert (report.scans[0].params.min_height, report.scans[0].params.max_height) == (-0.25, 3.0)
    with pytest.raises(Pc2ScanError, match="does not exist"):
        pc2scan.ProjectionParams.from_file(tmp_path / "none.yaml")


def test_a_hint_is_in_the_traceback() -> None:
    with pytest.raises(UsageError) as raised:
        pc2scan.clouds(HALL, end=datetime(2020, 1, 1))  # noqa: DTZ001
    shown = traceback.format_exception_only(raised.value)
    assert shown[0].startswith("pc2scan.errors.UsageError: `end`")
    assert shown[1] == f"hint: {raised.value.hint}\n"
    error = pickle.loads(pickle.dumps(ParameterError("wrong", name="beams", hint="right")))
    assert (str(error), error.name, error.hint, error.__notes__) == ("wrong", "beams", "right", ["hint: right"])


# --- counts ---


def test_a_message_is_copied_if_it_would_keep_much_more_in_memory() -> None:
    chunk = b"some data"
    for data in (chunk, memoryview(chunk), memoryview(bytearray(chunk))[2:8]):
        assert own_data(data) is data
    copied = own_data(memoryview(chunk)[2:5])
    assert (type(copied), copied) == (bytes, chunk[2:5])


# --- names and documentation ---


def test_functions_are_called_whatever_was_imported() -> None:
    # Whatever was imported before.
    code = f"import pc2scan; pc2scan.info({str(HALL)!r}); pc2scan.tf({str(HALL)!r}); pc2scan.transforms.placing"
    subprocess.run([sys.executable, "-c", code], timeout=60, check=True)
    tree = pc2scan.tf(HALL, static_tf=["map odom 1 0 0 0 0 0"])
    assert tree.lookup("map", "odom").translation.tolist() == [1, 0, 0]
    with pytest.raises(TransformError):
        tree.lookup("map", "none")
    assert {case.outcome for case in pc2scan.golden(CASES, "default").cases} == {"passed"}
    names = {"folder", "pattern", "update", "init", "start", "end", "topics", "params_file"}
    assert inspect.signature(pc2scan.golden).parameters.keys() == names
    assert "Read the frames" in (pc2scan.tf.__doc__ or "")


PUBLIC = {name: getattr(pc2scan, name) for name in pc2scan.__all__}


def test_public_names_are_those_of_the_package() -> None:
    assert set(pc2scan.__all__) <= set(dir(pc2scan))
    for name, value in PUBLIC.items():
        if inspect.isclass(value) or inspect.isfunction(value):
            expected = "pc2scan.errors" if name in {"Pc2ScanError", "RecordingWarning"} else "pc2scan"
            assert value.__module__ in {"pc2scan", expected}, name
    params = pc2scan.ProjectionParams(beams=90)
    assert pickle.loads(pickle.dumps(params)) == copy.copy(params) == params
    assert repr(type(params)) == "<class 'pc2scan.ProjectionParams'>"


def test_docstrings_name_what_users_can_import() -> None:
    documented: dict[str, str] = {}
    for name, value in PUBLIC.items():
        documented[name] = inspect.getdoc(value) or ""
        if inspect.isclass(value):
            for member, each in vars(value).items():
                if not member.startswith("_") and (callable(each) or isinstance(each, property | classmethod)):
                    documented[f"{name}.{member}"] = inspect.getdoc(getattr(value, member)) or ""
    assert [name for name, text in documented.items() if not text] == []
    internal = r"pc2scan\.(?!errors\.)[a-z_]+\.\w+[\w.]*"
    assert {name for name, text in documented.items() if re.search(internal, text)} == set()

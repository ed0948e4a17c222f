"""The functions of the library take what Python users have, in the words of the command line."""

from __future__ import annotations

import copy
import inspect
import pickle
import pydoc
import re
import subprocess
import sys
import traceback
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pc2scan
from pc2scan.errors import ParameterError, Pc2ScanError, RecordingError, TransformError, UsageError
from pc2scan.options.moment import TimeBound
from support import ROOT
from support.command import run

HALL = ROOT / "fixtures" / "hall.bag"
CASES = ROOT / "fixtures" / "golden"

#: What each function takes first, and what else it needs.
CALLS: dict[str, Any] = {
    "check": {},
    "clouds": {},
    "convert": {"destination": "out.mcap", "min_height": -0.3},
    "diff": {},
    "info": {},
    "repair": {"destination": "out.bag"},
    "scans": {"min_height": -0.3},
    "tf": {},
}


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    path = tmp_path / "scans.mcap"
    pc2scan.convert(HALL, path, preset="slam_toolbox", min_height=-0.3)
    return path


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("kind", [str, Path])
def test_a_path_is_text_or_an_object(
    name: str, kind: type, scans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    function, source = getattr(pc2scan, name), scans if name == "check" else HALL
    keywords = {key: kind(value) if key == "destination" else value for key, value in CALLS[name].items()}
    if name == "diff":
        keywords["b"] = kind(HALL)
    assert function(kind(source), **keywords)
    # "~" is the home folder, as in a shell.
    monkeypatch.setenv("HOME", str(source.parent))
    if name in {"info", "tf", "clouds"}:
        assert function(kind(f"~/{source.name}"), **keywords)
        if name != "diff":
            assert function([kind(source)], **keywords)
    for wrong in (5, None, b"x.bag", object()):
        with pytest.raises(TypeError, match=r"it must be a path: str or pathlib\.Path"):
            function(wrong, **keywords)


def test_a_path_that_begins_with_a_tilde_may_be_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("~").mkdir()
    (tmp_path / "~" / "a.bag").write_bytes(HALL.read_bytes())
    monkeypatch.setenv("HOME", "/none")
    assert pc2scan.info("~/a.bag").messages == 11
    with pytest.raises(RecordingError, match=r"/none/b\.bag"):
        pc2scan.info("~/b.bag")


def test_no_recording_is_wrong_usage() -> None:
    for function in (pc2scan.info, pc2scan.check, pc2scan.convert, pc2scan.scans, pc2scan.tf):
        with pytest.raises(UsageError, match="no recording was given"):
            function([])
        with pytest.raises(UsageError, match="is an empty path"):
            function("")


def test_the_words_are_those_of_the_command_line(tmp_path: Path) -> None:
    typed = tmp_path / "typed.mcap"
    options = "--preset slam_toolbox --min-height -0.3 --topic /points --start 0.1 --end 0.35 --keep /tf*"
    transform = "--static-tf", "map odom 1 2 0 0 0 0.5", "--write-static-tf", "--target-frame", "map"
    assert run("convert", str(HALL), "-o", str(typed), *options.split(), *transform).status == 0
    called = tmp_path / "called.mcap"
    report = pc2scan.convert(
        str(HALL),
        str(called),
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
    assert report.exit_status == 0
    assert called.read_bytes() == typed.read_bytes()
    assert report.origins["min_height"] == "the call"


def test_a_file_of_parameters_is_beaten_by_keywords(tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("min_height: -0.5\nrange_max: 20.0\n", "utf-8")
    report = pc2scan.convert(HALL, tmp_path / "a.bag", params_file=str(file), preset="nav2", range_max=np.float32(15))
    assert (report.params.min_height, report.params.range_max, report.params.range_min) == (-0.5, 15.0, 0.1)
    params = pc2scan.ProjectionParams.from_file(file, min_height=-0.25)
    assert (params.min_height, params.range_max) == (-0.25, 20.0)
    with pytest.raises(UsageError, match="params has all parameters"):
        pc2scan.convert(HALL, tmp_path / "b.bag", params=params, preset="nav2")
    report = pc2scan.convert(HALL, tmp_path / "b.bag", params=params, max_height=3)
    assert (report.params.min_height, report.params.max_height) == (-0.25, 3.0)
    with pytest.raises(Pc2ScanError, match="does not exist"):
        pc2scan.ProjectionParams.from_file(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("call", "args", "keyword", "told"),
    [
        (pc2scan.convert, [HALL], "min_heigth", "convert() has no argument 'min_heigth'; did you mean 'min_height'?"),
        (pc2scan.convert, [HALL], "topic", "did you mean 'topics'?"),
        (pc2scan.convert, [HALL], "output", "did you mean 'destination'?"),
        (pc2scan.convert, [HALL], "static", "did you mean 'static_tf'?"),
        (pc2scan.scans, [HALL], "topic", "did you mean 'topics'?"),
        (pc2scan.scans, [HALL], "presett", "did you mean 'preset'?"),
        (pc2scan.info, [HALL], "sample", "did you mean 'samples'?"),
        (pc2scan.check, [HALL], "consumer", "did you mean 'consumers'?"),
        (pc2scan.golden, [CASES], "updat", "did you mean 'update'?"),
        (pc2scan.tf, [HALL], "zzzz", "tf() has no argument 'zzzz'"),
        (
            pc2scan.ProjectionParams,
            [],
            "min_hight",
            "ProjectionParams() has no argument 'min_hight'; did you mean 'min_h",
        ),
        (pc2scan.ProjectionParams.preset, ["nav2"], "rangemax", "did you mean 'range_max'?"),
        (pc2scan.ProjectionParams.from_file, ["x"], "rangemax", "did you mean 'range_max'?"),
    ],
)
def test_a_misspelt_keyword_is_told_what_is_meant(call: Any, args: list[Any], keyword: str, told: str) -> None:
    with pytest.raises(TypeError, match=re.escape(told)):
        call(*args, **{keyword: 1})


@pytest.mark.parametrize(
    ("keyword", "value", "expected"),
    [
        ("overwrite", "no", "True or False"),
        ("jobs", "2", "a whole number"),
        ("jobs", True, "a whole number"),
        ("progress", True, "a function, or None"),
        ("params", {"min_height": 1}, "ProjectionParams"),
        ("preset", ["nav2"], "a str"),
        ("filters", "ring < 8", "a filter, such as .*; a condition as text is the argument `where`"),
        ("filters", [pc2scan.Where], "a filter"),
        ("frames", "base_link", "FrameOptions"),
        ("topics", 5, "a str or several"),
        ("keep", b"/tf", "a str or several"),
        ("static_tf", ("base_link", "lidar", 0, 0, 1, 0, 0, 0), "parent child x y z roll pitch yaw"),
        ("params_file", 5, "a path"),
        ("report", ["a.json"], "a path"),
    ],
)
def test_a_wrong_type_is_told_before_anything_is_done(keyword: str, value: Any, expected: str, tmp_path: Path) -> None:
    wanted = tmp_path / "out.mcap"
    wanted.write_bytes(b"kept")
    with pytest.raises(TypeError, match=rf"^{keyword} .*{expected}"):
        pc2scan.convert(HALL, wanted, **{keyword: value})
    assert wanted.read_bytes() == b"kept"


def test_wrong_types_of_parameters() -> None:
    wrong: Any = {"min_height": -1}
    with pytest.raises(TypeError, match="params is dict, it must be ProjectionParams"):
        pc2scan.project([[1.0, 0.0, 0.0]], wrong)
    several: Any = ["nav2"]
    with pytest.raises(TypeError, match=r"preset is .'nav2'. .list., it must be a str"):
        pc2scan.ProjectionParams.preset(several)


@pytest.mark.parametrize("wrong", ["1e-5", {"ranges": "1e-5"}, True])
def test_tolerances_are_numbers(wrong: Any) -> None:
    for name in ("atol", "rtol"):
        with pytest.raises(TypeError, match=f"^{name} is .* it must be a number, or a dict of numbers"):
            pc2scan.diff(HALL, HALL, **{name: wrong})
    assert pc2scan.diff(HALL, HALL, rtol=np.float64(1e-5), atol={"ranges": 1}).same


def test_degrees_are_asked_about_wherever_parameters_come_from(tmp_path: Path) -> None:
    params = pc2scan.ProjectionParams(angle_min=-90, angle_max=90)
    for given in ({"params": params}, {"angle_min": -90, "angle_max": 90}):
        with pytest.raises(ParameterError, match="more than a full turn") as raised:
            pc2scan.convert(HALL, tmp_path / "out.mcap", **given)
        assert 'angle_min="-90deg", angle_max="90deg"' in str(raised.value.hint)
    report = pc2scan.convert(HALL, tmp_path / "out.mcap", angle_min="-90deg", angle_max="90deg", min_height=-0.3)
    assert (report.params.angle_min, report.params.angle_max) == (-np.pi / 2, np.pi / 2)


@pytest.mark.parametrize(
    ("value", "nanoseconds", "absolute"),
    [
        (0.1, 100_000_000, False),
        (12, 12_000_000_000, False),
        (np.float32(0.5), 500_000_000, False),
        (np.int64(3), 3_000_000_000, False),
        (1e-7, 100, False),
        (timedelta(minutes=1, microseconds=5), 60_000_005_000, False),
        (np.timedelta64(1500, "ms"), 1_500_000_000, False),
        (1604515190.25, 1604515190250000000, True),
        (1604515190231374463, 1604515190231374463, True),
        (np.uint64(1604515190231374463), 1604515190231374463, True),
        (datetime(2020, 11, 4, 18, 39, 50, 231374, timezone.utc), 1604515190231374000, True),
        (datetime(2020, 11, 4, 19, 39, 50, tzinfo=timezone(timedelta(hours=1))), 1604515190000000000, True),
        (np.datetime64("2020-11-04T18:39:50.231374463"), 1604515190231374463, True),
        (np.datetime64("2020-11-04"), 1604448000000000000, True),
        ("12.5", 12_500_000_000, False),
    ],
)
def test_times(value: Any, nanoseconds: int, absolute: bool) -> None:
    assert TimeBound.of(value) == TimeBound(nanoseconds, absolute)


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (datetime(2020, 11, 4), "has no time zone"),  # noqa: DTZ001
        (1.604515190231374e18, "looks like nanoseconds since 1970, which a float cannot hold"),
        (-1, "negative"),
        (-0.5, "negative"),
        (timedelta(seconds=-1), "negative"),
        (float("nan"), "not a time"),
        (float("inf"), "not a time"),
        (np.datetime64("NaT"), "not a time"),
        (np.datetime64("30000-01-01"), "does not fit into nanoseconds of 64 bits"),
        (True, "not a time"),
        ([1], "not a time"),
        ("yesterday", "not a time"),
    ],
)
def test_times_that_are_none(value: Any, told: str) -> None:
    with pytest.raises(UsageError, match=f"`end`: .*{told}") as raised:
        pc2scan.clouds(HALL, end=value)
    assert raised.value.__cause__ is None or not isinstance(raised.value.__cause__, Pc2ScanError)


def test_a_hint_is_in_the_traceback() -> None:
    with pytest.raises(UsageError) as raised:
        pc2scan.clouds(HALL, end=datetime(2020, 1, 1))  # noqa: DTZ001
    shown = traceback.format_exception_only(raised.value)
    assert shown[0].startswith("pc2scan.errors.UsageError: `end`")
    assert shown[1] == f"hint: {raised.value.hint}\n"
    raised.value.hint = "another"
    assert traceback.format_exception_only(raised.value)[1:] == ["hint: another\n"]
    raised.value.hint = None
    assert traceback.format_exception_only(raised.value)[1:] == []
    error = pickle.loads(pickle.dumps(ParameterError("wrong", name="beams", hint="right")))
    assert (str(error), error.name, error.hint, error.__notes__) == ("wrong", "beams", "right", ["hint: right"])


def test_packages_of_public_names_are_called() -> None:
    # Whatever was imported before.
    for code in (
        "import pc2scan; pc2scan.tf(HALL)",
        "import pc2scan.tf.buffer; pc2scan.tf(HALL)",
        "import pc2scan; pc2scan.convert(HALL, DST, min_height=0.1); pc2scan.tf(HALL); pc2scan.tf.options",
        "from pc2scan import tf; tf(HALL)",
    ):
        ready = code.replace("HALL", repr(str(HALL))).replace("DST", "'/dev/null/x'")
        done = subprocess.run([sys.executable, "-c", ready], capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0 or "/dev/null" in done.stderr, done.stderr
    tree = pc2scan.tf(HALL, static_tf=["map odom 1 0 0 0 0 0"])
    assert tree.lookup("map", "odom").translation.tolist() == [1, 0, 0]
    with pytest.raises(TransformError):
        tree.lookup("map", "none")
    report = pc2scan.golden(CASES, "default")
    assert {case.outcome for case in report.cases} == {"passed"}
    assert inspect.signature(pc2scan.golden).parameters.keys() == {
        "folder",
        "pattern",
        "update",
        "init",
        "start",
        "end",
        "topics",
        "params_file",
    }
    assert "Read the frames" in (pc2scan.tf.__doc__ or "")


def public() -> dict[str, Any]:
    return {name: getattr(pc2scan, name) for name in pc2scan.__all__}


def test_public_names_are_those_of_the_package() -> None:
    assert set(pc2scan.__all__) <= set(dir(pc2scan))
    for name, value in public().items():
        if inspect.isclass(value) or inspect.isfunction(value):
            expected = {"pc2scan", "pc2scan.errors"} if name in {"Pc2ScanError", "RecordingWarning"} else {"pc2scan"}
            assert value.__module__ in expected, name
    params = pc2scan.ProjectionParams(beams=90)
    assert pickle.loads(pickle.dumps(params)) == copy.copy(params) == params
    assert repr(type(params)) == "<class 'pc2scan.ProjectionParams'>"


def test_docstrings_name_what_users_can_import() -> None:
    documented: dict[str, str] = {}
    for name, value in public().items():
        documented[name] = inspect.getdoc(value) or ""
        if inspect.isclass(value):
            for member, each in vars(value).items():
                if not member.startswith("_") and (callable(each) or isinstance(each, property | classmethod)):
                    documented[f"{name}.{member}"] = inspect.getdoc(getattr(value, member)) or ""
    missing = [name for name, text in documented.items() if not text]
    assert missing == []
    named = {name: re.findall(r"pc2scan\.[a-z_]+\.\w+[\w.]*", text) for name, text in documented.items()}
    internal = {name: [n for n in found if not n.startswith("pc2scan.errors.")] for name, found in named.items()}
    assert {name: found for name, found in internal.items() if found} == {}


def test_help_begins_with_what_there_is() -> None:
    text = pydoc.plain(pydoc.render_doc(pc2scan))
    beginning = text[:2500]
    for name in ("convert", "repair", "info", "tf", "check", "diff", "golden", "scans", "clouds", "project"):
        assert f"`{name}`" in beginning, name


def test_the_help_of_a_function_has_all_of_its_arguments() -> None:
    for name, value in public().items():
        if inspect.isfunction(value):
            text = inspect.getdoc(value) or ""
            described = text[text.index("Parameters\n") :].split("\nReturns\n")[0]
            for parameter in inspect.signature(value).parameters:
                assert re.search(rf"\b{parameter}\b", described), (name, parameter)

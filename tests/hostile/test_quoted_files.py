"""What a launch, scans or dataset file names, files and environment variables, is not quoted in errors."""

from __future__ import annotations

import traceback
from typing import TYPE_CHECKING

import pytest

import pc2scan
from pc2scan.errors import UsageError
from support import ROOT, sampled
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"
SECRET = "hunter2secret"

#: Files of somebody else, with a secret in each place that an error could quote.
FILES = {
    "a text": f"root:{SECRET}:0:0:root:/root:/bin/bash\nbin:x:1:1\n",
    "a list": f"- {SECRET}\n- 2\n",
    "no YAML": f"a: *{SECRET}\n",
    "a wrong escape": f'a: "\\q{SECRET}"\n',
    "an unknown key": f"{SECRET}: 1\nmin_height: 1\n",
    "a key twice": f"{SECRET}: 1\n{SECRET}: 2\n",
    "a text for a number": f"pointcloud_to_laserscan:\n  ros__parameters:\n    min_height: {SECRET}\n",
    "no such word": f"pointcloud_to_laserscan:\n  ros__parameters:\n    reduce: {SECRET}\n",
    "a tag": f"min_height: !{SECRET} 1\n",
    "sections": f"a{SECRET}:\n  ros__parameters: {{a: 1}}\nb{SECRET}:\n  ros__parameters: {{a: 1}}\n",
    "several nodes": "\n".join(f"{n}{SECRET}: {{ros__parameters: {{min_height: 1.0, range_max: 5.0}}}}" for n in "ab"),
    "a number too large": "pointcloud_to_laserscan: {ros__parameters: {angle_max: 271828.0}}\n",
    "bytes": "",
}

#: The place in the file that errors name, where there is one.
LINES = {
    "a text for a number": "line 3",
    "a wrong escape": "line 1",
    "an unknown key": "line 1",
    "a key twice": "line 2",
}

NODE = '<launch><node pkg="pointcloud_to_laserscan" name="{name}">{inner}</node></launch>'


def refused(folder: Path, *words: str | Path) -> str:
    """What a conversion that is refused prints."""
    done = run("convert", HALL, "-o", folder / "out.mcap", *words)
    assert (done.status, "Traceback" in done.stderr) == (2, False), done.stderr
    return done.stdout + done.stderr


def write_secret(folder: Path, kind: str) -> Path:
    path = folder / "other.yaml"
    path.write_bytes(FILES[kind].encode() if FILES[kind] else SECRET.encode() + b"\xff\xfe")
    return path


def assert_not_quoted(text: str) -> None:
    assert SECRET not in text
    assert "271828" not in text
    # A similar name would quote it as well.
    assert SECRET[:8] not in text


#: Files that name the other: their names and texts, how they are given, and the line that names it.
NAMING = {
    "rosparam": ("me.launch", NODE.format(name="a", inner='<rosparam file="{}"/>'), "--params-file", "line 1"),
    "param": ("me.launch", NODE.format(name="a", inner='<param from="{}"/>'), "--params-file", "line 1"),
    "scans": ("scans.yaml", "scans:\n  /scan:\n    params_file: other.yaml\n", "--scans", "line 2, /scan"),
    **{
        f"dataset: {option}": ("dataset.yaml", f"defaults:\n  {option}: other.yaml\n", "--dataset", "line 2")
        for option in ("params_file", "static_tf_file", "scans")
    },
}
#: All places of one file, and then those of the next; a dataset file's options are read by other rules.
PLACES = [
    (kind, name)
    for kind in FILES
    for name in NAMING
    if not (name.startswith("dataset") and kind in ("several nodes", "a number too large"))
]


@pytest.mark.parametrize(("kind", "name"), sampled(PLACES, 20))
def test_a_file_that_another_names_is_not_quoted(kind: str, name: str, tmp_path: Path) -> None:
    other = write_secret(tmp_path, kind)
    file, text, option, line = NAMING[name]
    naming = tmp_path / file
    naming.write_text(text.format(other))
    if option == "--dataset":
        done = run("batch", HALL, "-o", tmp_path / "out", "--dataset", naming, "--jobs", "1")
        assert done.status == 2
        # Long lines are broken between words.
        told = (done.stdout + done.stderr).replace("\n  ", " ")
    else:
        told = refused(tmp_path, option, naming)
        assert LINES.get(kind, "") in told
    assert_not_quoted(told)
    assert f"{other}" in told
    assert f"named in {naming}, {line}" in told
    if option == "--params-file":
        assert f"hint: --params-file {other} shows what is wrong" in told
        with pytest.raises(UsageError) as caught:
            pc2scan.convert(HALL, tmp_path / "out.mcap", params_file=naming)
        assert_not_quoted("".join(traceback.format_exception(caught.value)))


@pytest.mark.parametrize("kind", ["a text", "a list"])
def test_a_file_without_parameters_is_not_quoted_at_all(kind: str, tmp_path: Path) -> None:
    other = write_secret(tmp_path, kind)
    assert_not_quoted(refused(tmp_path, "--params-file", other))


def param(value: str, name: str = "min_height") -> str:
    return f'<param name="{name}" value="{value}"/>'


def block(text: str) -> str:
    return f'<rosparam subst_value="true">{text}</rosparam>'


#: Launch files with a variable in each place that an error could quote, and what the error says instead.
VARIABLES = {
    "a number": (param("$(env SECRET)"), "min_height: expected a number, got '$(env SECRET)'"),
    "a part": (param("1$(optenv SECRET 0)"), "got '1$(optenv SECRET 0)'"),
    "a name": (param("1", "$(env SECRET)"), "unknown parameter '$(env SECRET)'"),
    "no value": ('<param name="$(env SECRET)"/>', "$(env SECRET): <param> has no value here"),
    "a condition": ('<param if="$(env SECRET)" name="a"/>', "if='$(env SECRET)' is neither true nor false"),
    "a file": ('<rosparam file="$(env SECRET)/a.yaml"/>', "$(env SECRET)/a.yaml: does not exist"),
    "a file that is there": ('<rosparam file="$(env FOLDER)/a text"/>', "$(env FOLDER)/a text: not valid"),
    "a block": (block("min_height: $(env SECRET)"), "min_height: expected a number"),
    "a key": (block("$(env SECRET): 1"), "unknown parameter '<rosparam>'"),
    "no block": (block("*$(env SECRET)"), "the values of environment variables"),
    "an argument": (param("$(arg $(env SECRET))"), "its argument '$(arg $(env SECRET))'"),
    "a package": (param("$(find $(env SECRET))"), "the package '$(find $(env SECRET))'"),
    "a variable": (param("$(env $(env SECRET))"), "the environment variable $(env $(env SECRET))"),
    "an expression": (param("$(eval $(env SECRET))"), "'$(eval $(env SECRET))' cannot be computed"),
    "not closed": (param("$(env SECRET) $(eval"), "'$(env SECRET) $(eval' cannot be computed"),
    "too large": (param("$(env DEGREES)", "angle_max"), "angle_max: expected another value, got '$(env DEGREES)'"),
    "the wrong order": (param("$(env DEGREES)", "range_min") + param("1", "range_max"), "'$(env DEGREES)'"),
    "through an argument": (param("$(arg low)"), "min_height: expected a number, got '$(arg low)'"),
    "no variable": (param("$(env NOTHING x)"), "got 'x'"),
}


@pytest.mark.parametrize("name", VARIABLES)
def test_a_variable_in_a_launch_file_is_not_quoted(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET", SECRET)
    monkeypatch.setenv("DEGREES", "271828")
    monkeypatch.setenv("FOLDER", str(tmp_path / SECRET))
    (tmp_path / SECRET).mkdir()
    (tmp_path / SECRET / "a text").write_text(FILES["a text"])
    inner, said = VARIABLES[name]
    launch = tmp_path / "me.launch"
    text = NODE.format(name="scanner", inner=inner)
    launch.write_text(text.replace("<launch>", '<launch>\n<arg name="low" default="$(env SECRET)"/>'))
    told = refused(tmp_path, "--params-file", launch)
    assert_not_quoted(told)
    assert said in told
    if name != "a file":
        assert f"{launch}, line 2" in told


def test_nodes_and_arguments_named_by_variables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET", SECRET)
    launch = tmp_path / "me.launch"
    node = '<node pkg="pointcloud_to_laserscan" name="$(env SECRET)_{}" ns="$(env SECRET)"/>'
    launch.write_text(f'<launch><arg name="$(env SECRET)" default="1"/>{node.format(1)}{node.format(2)}</launch>')
    none = refused(tmp_path, "--params-file", launch, "--node", "nothing")
    assert_not_quoted(none)
    assert "found /$(env SECRET)/$(env SECRET)_1" in none
    argument = refused(tmp_path, "--params-file", launch, "--node", f"{SECRET}_1", "--arg", "no:=1")
    assert_not_quoted(argument.replace(f"{SECRET}_1", ""))
    assert "its arguments are $(env SECRET)" in argument


def test_variables_still_set_values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOW", "-0.3")
    monkeypatch.setenv("ROBOT", "r2")
    launch = tmp_path / "me.launch"
    inner = '<param name="min_height" value="$(env LOW)"/><remap from="scan" to="$(env ROBOT)/flat"/>'
    launch.write_text(NODE.format(name="$(env ROBOT)_scanner", inner=inner))
    report = pc2scan.convert(HALL, tmp_path / "a.mcap", params_file=launch)
    assert report.scans[0].params.min_height == -0.3
    assert [topic.target for topic in report.topics if topic.action == "converted"] == ["/r2/flat"]


def test_included_files_and_commands_are_not_read(tmp_path: Path) -> None:
    other = write_secret(tmp_path, "a text")
    launch = tmp_path / "me.launch"
    for inner in (f'<include file="{other}"/>', f'<param name="min_height" command="cat {other}"/>'):
        launch.write_text(f"<launch>{inner}{NODE.format(name='a', inner=inner)[8:]}")
        assert_not_quoted(refused(tmp_path, "--params-file", launch, "-p", "min_points:=x"))

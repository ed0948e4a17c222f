"""Files that a launch, scans or dataset file names are not quoted in errors; environment variables are not read."""

from __future__ import annotations

import traceback
from typing import TYPE_CHECKING

import pytest

import pc2scan
from pc2scan.errors import UsageError
from support import HALL, sampled
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

SECRET = "hunter2secret"

#: Files of somebody else, with a secret in each place that an error could quote.
FILES = {
    "a text": f"root:{SECRET}:0:0:root:/root:/bin/bash\nbin:x:1:1\n",
    "no YAML": f"a: *{SECRET}\n",
    "an unknown key": f"{SECRET}: 1\nmin_height: 1\n",
    "a text for a number": f"pointcloud_to_laserscan:\n  ros__parameters:\n    min_height: {SECRET}\n",
    "no such word": f"pointcloud_to_laserscan:\n  ros__parameters:\n    reduce: {SECRET}\n",
    "a tag": f"min_height: !{SECRET} 1\n",
    "bytes": "",
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
    # A similar name would quote it as well.
    assert SECRET[:8] not in text


#: Files that name the other: their names and texts, how they are given, and the line that names it.
NAMING = {
    "rosparam": ("me.launch", NODE.format(name="a", inner='<rosparam file="{}"/>'), "--params-file", "line 1"),
    "param": ("me.launch", NODE.format(name="a", inner='<param from="{}"/>'), "--params-file", "line 1"),
    "scans": ("scans.yaml", "scans:\n  /scan:\n    params_file: other.yaml\n", "--scans", "line 2, /scan"),
    **{
        f"dataset: {option}": ("dataset.yaml", f"defaults:\n  {option}: other.yaml\n", "--dataset", "line 2")
        for option in ("params_file", "static_tf", "scans")
    },
}
#: All places of one file, and then those of the next.
PLACES = [(kind, name) for kind in FILES for name in NAMING]


@pytest.mark.parametrize(("kind", "name"), sampled(PLACES, 5))
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
    assert_not_quoted(told)
    assert f"{other}" in told
    assert f"named in {naming}, {line}" in told
    if option == "--params-file":
        assert f"hint: --params-file {other} shows what is wrong" in told
        with pytest.raises(UsageError) as caught:
            pc2scan.convert(HALL, tmp_path / "out.mcap", params_file=naming)
        assert_not_quoted("".join(traceback.format_exception(caught.value)))


@pytest.mark.parametrize(
    "inner",
    [
        '<param name="min_height" value="1$(env SECRET)"/>',
        '<param name="$(optenv SECRET 0)" value="1"/>',
        '<param if="$(env SECRET)" name="min_height" value="1"/>',
        '<rosparam file="$(env SECRET)/a.yaml"/>',
        '<rosparam subst_value="true">min_height: $(env SECRET)</rosparam>',
        '<param name="min_height" value="$(arg low)"/>',
    ],
)
def test_a_variable_in_a_launch_file_is_not_read(inner: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET", SECRET)
    launch = tmp_path / "me.launch"
    text = NODE.format(name="scanner", inner=inner)
    launch.write_text(text.replace("<launch>", '<launch>\n<arg name="low" default="$(env SECRET)"/>'))
    told = refused(tmp_path, "--params-file", launch)
    assert_not_quoted(told)
    assert "env SECRET" in told
    assert "is not read" in told
    assert f"{launch}, line 2" in told

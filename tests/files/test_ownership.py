"""No output of a run is one of its inputs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pc2scan.errors import DestinationError
from pc2scan.files.ownership import InputPath, OutputPath, refuse_overlap


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A recording in a folder, a database, and links to both."""
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("here")
    (tmp_path / "bag" / "x_0.db3").write_text("here")
    (tmp_path / "a.db3").write_text("here")
    (tmp_path / "link").symlink_to("bag")
    (tmp_path / "further").symlink_to("link")
    (tmp_path / "loop").symlink_to("loop")
    os.link(tmp_path / "bag" / "x_0.db3", tmp_path / "hard.db3")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "into.db3").symlink_to(tmp_path / "a.db3")
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "x_0.db3").symlink_to(tmp_path / "a.db3")
    return tmp_path


REFUSED = [
    ("bag", "bag", "is a source"),
    ("link", "bag", "is a source"),
    ("bag", "link", "is a source"),
    ("link", "further", "is a source"),
    ("further", "link", "is a source"),
    ("hard.db3", "bag/x_0.db3", "is a source"),
    ("bag/new", "bag", "is inside the source"),
    ("link/new", "bag", "is inside the source"),
    ("bag/new/newer", "further", "is inside the source"),
    ("bag", "bag/x_0.db3", "contains the source"),
    ("link", "bag/x_0.db3", "contains the source"),
    ("bag/../bag", "bag", "is a source"),
    # What a recording's folder holds is read too, wherever it is in truth.
    ("hard.db3", "bag", "is a source"),
    ("a.db3", "linked", "is a source"),
    # A link is removed with the folder that it is in.
    ("out", "out/into.db3", "contains the source"),
    # SQLite reads what is beside a database, or appears there.
    ("a.db3-wal", "a.db3", "is a source"),
    ("a.db3-journal", "out/into.db3", "is a source"),
]


@pytest.mark.parametrize(("output", "source", "told"), REFUSED)
def test_an_output_that_touches_an_input(output: str, source: str, told: str, folder: Path) -> None:
    with pytest.raises(DestinationError, match=told) as caught:
        refuse_overlap([InputPath(folder / source)], [OutputPath(folder / output)])
    assert caught.value.hint


@pytest.mark.parametrize("ending", [".pc2scan-partial", ".pc2scan-old", ".pc2scan-partial.lock"])
@pytest.mark.parametrize("kind", ["itself", "in it", "link to it", "hard link"])
def test_an_input_with_a_name_that_staging_uses(ending: str, kind: str, tmp_path: Path) -> None:
    left = tmp_path / f"x.mcap{ending}"
    if kind == "in it":
        left.mkdir()
        source = left / "x_0.mcap"
        source.write_text("here")
    else:
        left.write_text("here")
        source = left if kind == "itself" else tmp_path / "source.mcap"
    if kind == "link to it":
        source.symlink_to(left)
    if kind == "hard link":
        os.link(left, source)
    with pytest.raises(DestinationError, match=rf"needs the name x.mcap{ending} while it is written") as caught:
        refuse_overlap([InputPath(source)], [OutputPath(tmp_path / "x.mcap")])
    assert "interrupted_x.mcap" in (caught.value.hint or "")
    (tmp_path / "interrupted_x.mcap").touch()
    with pytest.raises(DestinationError) as caught:
        refuse_overlap([InputPath(source)], [OutputPath(tmp_path / "x.mcap")])
    # The hint does not suggest overwriting the file.
    assert "interrupted_x.mcap" not in (caught.value.hint or "")
    refuse_overlap([InputPath(source)], [OutputPath(tmp_path / "y.mcap")])


def test_options_are_named(folder: Path) -> None:
    with pytest.raises(DestinationError, match="the file of --report is a file of --params-file"):
        refuse_overlap(
            [InputPath(folder / "a.db3", "file of --params-file")], [OutputPath(folder / "a.db3", "--report")]
        )


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        ("x", "x", "is the destination"),
        ("x.mcap", "X.mcap", "is the destination"),
        ("link/x", "bag/x", "is the destination"),
        ("x", "x.pc2scan-partial", "is the destination"),
        ("x.pc2scan-partial.lock", "x", "is the destination"),
        ("out", "out/report", "is inside the destination"),
        ("x", "x.pc2scan-partial/report", "is inside the destination"),
        ("out/x", "out", "contains the destination"),
        # Two spellings of one letter.
        ("caf\N{LATIN SMALL LETTER E WITH ACUTE}", "cafe\N{COMBINING ACUTE ACCENT}", "is the destination"),
    ],
)
def test_outputs_that_touch_each_other(first: str, second: str, told: str, folder: Path) -> None:
    with pytest.raises(DestinationError, match=told):
        refuse_overlap([], [OutputPath(folder / first), OutputPath(folder / second, "--report")])


def test_what_has_nothing_to_do_with_each_other(folder: Path) -> None:
    inputs = [InputPath(folder / name) for name in ("bag", "further", "a.db3", "loop", "missing", "missing/deeper")]
    outputs = [OutputPath(folder / name) for name in ("new", "bag2", "a.db", "no/where", "loop2", "bag.pc2scan-old")]
    refuse_overlap(inputs, outputs)
    refuse_overlap([InputPath(Path())], [OutputPath(Path("../new"))])


def test_names_that_differ_in_case_may_be_two_files(tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").touch()
    if (tmp_path / "DRIVE.mcap").exists():
        pytest.skip("this file system ignores case")
    refuse_overlap([InputPath(tmp_path / "drive.mcap")], [OutputPath(tmp_path / "DRIVE.mcap")])

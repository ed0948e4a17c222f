"""Untrusted metadata.yaml: paths out of the directory, tags, aliases, depth and length."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from support import sampled
from support.bounded import run_bounded
from support.builders import CONTENT, write_rosbag2
from support.tables import rows

TABLES = Path(__file__).with_name("metadata_yaml.txt")


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_rosbag2(tmp_path / "drive", CONTENT)


def with_text(drive: Path, old: str, new: str) -> None:
    path = drive / "metadata.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize("name", ["../secret.db3", "/{outside}/secret.db3", "..\\secret.db3", "a/../../secret.db3"])
def test_a_path_that_leads_out_of_the_directory(name: str, drive: Path, tmp_path: Path) -> None:
    shutil.copy(drive / "drive_0.db3", tmp_path / "secret.db3")
    with_text(drive, "- drive_0.db3", f"- {name.format(outside=tmp_path)}")
    # The file in the directory is read in its place.
    done = run_bounded("convert", drive)
    assert done.status == 0
    assert "names secret.db3, which is not in the directory" in done.stderr
    (drive / "drive_0.db3").unlink()
    assert run_bounded("convert", drive).status == 1


@pytest.mark.parametrize("target", ["/dev/zero", "folder", "fifo", "missing"])
def test_a_link_to_what_is_no_file_is_not_followed(target: str, drive: Path, tmp_path: Path) -> None:
    """A link to a file is that file: data sets are kept so. Anything else would have no end, or none to wait for."""
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "fifo")
    (drive / "drive_0.db3").unlink()
    (drive / "drive_0.db3").symlink_to(tmp_path / target)
    done = run_bounded("info", drive)
    assert done.status == 1
    assert "drive_0.db3" in done.stderr


@pytest.mark.parametrize("tag", [tag for (tag,) in rows(TABLES, "tags")])
def test_tags_construct_nothing(tag: str, drive: Path, tmp_path: Path) -> None:
    place = tmp_path / "touched-by-a-tag"
    with_text(drive, "custom_data: null", f"custom_data: {tag.format(place=place)}")
    for strict, status in (("--strict",), 1), ((), 3):
        done = run_bounded("convert", drive, "--overwrite", *strict)
        assert done.status == status
        assert "is not valid YAML" in done.stderr
        assert not place.exists()


LAUGHS = "a0: &a0 [ha, ha, ha, ha, ha, ha, ha, ha, ha]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 40)
)
MERGES = "m0: &m0 {ha: 1}\n" + "".join(f"m{n}: &m{n} {{<<: [{', '.join([f'*m{n - 1}'] * 9)}]}}\n" for n in range(1, 40))
BOMBS = {
    "laughs": LAUGHS,
    "merges": MERGES,
    "itself": "a: &a [*a]\n",
    "brackets": "a: " + "[" * 100_000 + "\n",
    "braces": "a: " + "{" * 100_000 + "\n",
    "dashes": "a:\n " + "- " * 100_000 + "\n",
    "digits": "a: " + "9" * 100_000 + "\n",
    "length": "# a comment\n" * 100_000,
    "values": "".join(f"a{n}: v\n" for n in range(5_000)),
    "nul": "a: \x00\n",
}


@pytest.mark.parametrize("bomb", sampled(BOMBS, 3))
def test_yaml_that_unfolds(bomb: str, drive: Path) -> None:
    path = drive / "metadata.yaml"
    path.write_text(path.read_text() + BOMBS[bomb])
    done = run_bounded("info", drive)
    assert done.status in (0, 1, 3), done.stderr


def test_aliases_that_unfold_in_what_is_made_text(drive: Path) -> None:
    """``custom_data`` and QoS profiles are written out again, with every alias in its full length."""
    aliases = LAUGHS.replace("\n", "\n    ")
    with_text(drive, "  custom_data: null", f"  custom_data:\n    {aliases}".rstrip())
    done = run_bounded("convert", drive, "--strict")
    assert done.status == 1
    assert "its aliases multiply" in done.stderr


@pytest.mark.parametrize(("old", "new"), rows(TABLES, "values of other kinds"))
def test_values_of_other_kinds(old: str, new: str, drive: Path) -> None:
    with_text(drive, old, new)
    assert run_bounded("convert", drive, "--strict").status == 1

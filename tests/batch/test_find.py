"""Finding recordings: by content, split ones as one, none twice, and nothing of the batch's own."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from pc2scan.batch.find import Found, find
from pc2scan.errors import MissingError, UsageError
from support.builders import CONTENT, SECOND, Item, Recording, write_db3, write_mcap, write_rosbag1, write_rosbag2

if TYPE_CHECKING:
    from pathlib import Path


def keys(found: list[Found]) -> list[str]:
    return [each.key for each in found]


def later(recording: Recording, seconds: int) -> Recording:
    items = tuple(Item(each.stream, each.log_time_ns + seconds * SECOND, each.data) for each in recording.items)
    return Recording(recording.streams, items)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "data"
    (made / "robot1").mkdir(parents=True)
    return made


def test_a_folder_is_searched_by_content(folder: Path, tmp_path: Path) -> None:
    write_rosbag1(folder / "b10.bag", CONTENT)
    write_rosbag1(folder / "b9.bag", CONTENT)
    write_mcap(folder / "robot1" / "no_suffix", CONTENT)
    write_db3(folder / "robot1" / "a.db3", CONTENT)
    write_rosbag2(folder / "robot1" / "bag", CONTENT)
    (folder / "robot1" / "empty.mcap").touch()
    for name in ("notes.txt", ".hidden.bag", "x.bag.pc2scan-partial", "x.bag.pc2scan-old"):
        (folder / name).write_text("text")
    (folder / "metadata.yaml").write_text("of: another program")
    with closing(sqlite3.connect(folder / "thumbs.db")) as database:
        database.execute("CREATE TABLE x (y)")
        database.commit()
    (folder / "gone.bag").symlink_to(folder / "nowhere")
    found = find([str(folder)], tmp_path / "out")
    assert keys(found) == [
        "b9.bag",
        "b10.bag",
        "gone.bag",
        "robot1/a.db3",
        "robot1/bag",
        "robot1/empty.mcap",
        "robot1/no_suffix",
    ]
    by_key = {each.key: each for each in found}
    assert {key: each.container for key, each in by_key.items()} == {
        "b9.bag": "rosbag1",
        "b10.bag": "rosbag1",
        "gone.bag": "",
        "robot1/a.db3": "sqlite3",
        "robot1/bag": "rosbag2",
        "robot1/empty.mcap": "",
        "robot1/no_suffix": "mcap",
    }
    assert "is empty" in str(by_key["robot1/empty.mcap"].error)
    assert isinstance(by_key["gone.bag"].error, MissingError)
    assert by_key["b9.bag"].identity.size_bytes == (folder / "b9.bag").stat().st_size


def test_parts_are_one_recording_and_drives_are_not(folder: Path, tmp_path: Path) -> None:
    first, second = CONTENT.halves()
    for number, part in enumerate((first, second)):
        write_rosbag1(folder / f"drive_2020-11-04-18-39-5{number}_{number}.bag", part)
        write_mcap(folder / f"part_{number}.mcap", part)
        # Two drives of another day, and of the same time.
        write_mcap(folder / f"run_{number}.mcap", later(CONTENT, 1000 * number))
        write_mcap(folder / f"twin_{number}.mcap", CONTENT)
    # One part is missing in between, so it is unknown what follows.
    write_mcap(folder / "hole_0.mcap", first)
    write_mcap(folder / "hole_2.mcap", later(second, 100))
    found = {each.key: [path.name for path in each.paths] for each in find([str(folder)], tmp_path / "out")}
    assert found == {
        "drive_2020-11-04-18-39-50_0.bag": ["drive_2020-11-04-18-39-50_0.bag", "drive_2020-11-04-18-39-51_1.bag"],
        "part_0.mcap": ["part_0.mcap", "part_1.mcap"],
        "run_0.mcap": ["run_0.mcap"],
        "run_1.mcap": ["run_1.mcap"],
        "twin_0.mcap": ["twin_0.mcap"],
        "twin_1.mcap": ["twin_1.mcap"],
        "hole_0.mcap": ["hole_0.mcap"],
        "hole_2.mcap": ["hole_2.mcap"],
    }


def test_parts_that_are_named_are_one_recording(folder: Path, tmp_path: Path) -> None:
    names = []
    for number, part in enumerate(CONTENT.halves()):
        names.append(str(write_mcap(folder / f"part_{number}.mcap", part)))
        write_mcap(folder / "robot1" / f"part_{number}.mcap", part)
    assert [len(each.paths) for each in find(names, tmp_path / "out")] == [2]
    assert [len(each.paths) for each in find([f"{folder}/**/*.mcap"], tmp_path / "out")] == [2, 2]
    assert [len(each.paths) for each in find(names[1:], tmp_path / "out")] == [1]


def test_nothing_is_found_twice(folder: Path, tmp_path: Path) -> None:
    bag = write_rosbag1(folder / "a.bag", CONTENT)
    (folder / "robot1" / "link.bag").symlink_to(bag)
    (folder / "robot1" / "around").symlink_to(folder)
    found = find([str(folder), str(bag), f"{folder}/*.bag"], tmp_path / "out")
    assert keys(found) == ["a.bag"]


def test_globs_lists_and_names(folder: Path, tmp_path: Path) -> None:
    for name in ("a.bag", "robot1/b.bag", "robot1/c.bag"):
        write_rosbag1(folder / name, CONTENT)
    out = tmp_path / "out"
    assert keys(find([f"{folder}/*/b.bag"], out)) == ["robot1/b.bag"]
    assert keys(find([f"{folder}/**/*.bag"], out)) == ["a.bag", "robot1/b.bag", "robot1/c.bag"]
    assert keys(find([str(folder / "a.bag"), str(folder / "robot1" / "b.bag")], out)) == ["a.bag", "robot1/b.bag"]
    assert keys(find([str(folder / "robot1" / "b.bag")], out)) == ["b.bag"]
    (tmp_path / "list.txt").write_text(f"# drives\ndata/a.bag\n\n{folder / 'robot1'}\ndata/missing.bag\n")
    found = find([str(tmp_path / "list.txt")], out)
    assert keys(found) == ["a.bag", "missing.bag", "robot1/b.bag", "robot1/c.bag"]
    assert isinstance(found[1].error, MissingError)
    with pytest.raises(MissingError):
        find([str(folder / "x.bag")], out)
    with pytest.raises(UsageError, match="matches nothing"):
        find([f"{folder}/*.mcap"], out)
    (tmp_path / "prose.txt").write_text("no list of paths\n")
    (found_one,) = find([str(tmp_path / "prose.txt")], out)
    assert "is not a recording" in str(found_one.error)


def test_two_of_one_name_get_the_names_of_their_folders(tmp_path: Path) -> None:
    for place in ("x/day1", "x/day2", "y/day1"):
        (tmp_path / place).mkdir(parents=True)
        write_rosbag1(tmp_path / place / "a.bag", CONTENT)
        write_rosbag1(tmp_path / place / f"{place.replace('/', '_')}.bag", CONTENT)
    found = find([str(tmp_path / place) for place in ("x/day1", "x/day2", "y/day1")], tmp_path / "out")
    assert keys(found) == ["x/day1/a.bag", "x/day2/a.bag", "x_day1.bag", "x_day2.bag", "y/day1/a.bag", "y_day1.bag"]


def test_what_is_written_is_not_found(folder: Path, tmp_path: Path) -> None:
    write_rosbag1(folder / "a.bag", CONTENT)
    out = folder / "scans"
    out.mkdir()
    write_rosbag1(out / "b.bag", CONTENT)
    write_rosbag1(folder / "robot1" / "a_scan.bag", CONTENT)
    assert keys(find([str(folder)], out, outputs=[folder / "robot1" / "a_scan.bag"])) == ["a.bag"]
    for where in (folder, tmp_path):
        with pytest.raises(UsageError, match="they would be found as sources"):
            find([str(folder)], where)

"""A destination's name and the options decide its format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pc2scan.bags.destinations import Destination, default_destination, default_storage, plan_destination
from pc2scan.errors import DestinationError
from pc2scan.model import Summary
from support.builders import CONTENT, T0, write_db3
from support.command import run
from support.outputs import opened
from support.tables import rows

TABLES = Path(__file__).with_name("destinations.txt")


def plan(name: str, ros_version: int | None = 2, **options: Any) -> Destination:
    return plan_destination(Path(name), source_ros_version=ros_version, **options)


@pytest.mark.parametrize(("name", "options", "expected"), rows(TABLES, "name and options, and the format"))
def test_name_and_options_decide_the_format(
    name: str, options: dict[str, Any], expected: tuple[str, str, str, str, int]
) -> None:
    found = plan(name, **options)
    storage = found.file_format.name if found.format.storages else ""
    assert (found.format.name, storage, found.compression, found.profile, found.ros_version) == expected
    assert found.path == Path(name)


@pytest.mark.parametrize(("name", "options", "message"), rows(TABLES, "what is impossible"))
def test_impossible_destinations_are_refused(name: str, options: dict[str, Any], message: str) -> None:
    """The command refuses more of them: see ``tests/transcripts/destinations.txt``."""
    with pytest.raises(DestinationError, match=message) as caught:
        plan(name, **options)
    assert caught.value.path == Path(name)


def summary(container: str, storage: str = "") -> Summary:
    return Summary(container, storage, (), 0, None, None, None)


@pytest.mark.parametrize(
    ("source", "form", "expected", "storage"), rows(TABLES, "source and its format, and the default beside it")
)
def test_the_default_is_beside_the_source(
    source: str, form: tuple[str, ...], expected: str, storage: str | None
) -> None:
    of = summary(*form)
    found = default_destination(Path(source), of.container)
    assert found == Path(expected)
    assert default_storage(found, [of]) == storage
    container = plan_destination(found, storage=storage, source_ros_version=2).format.name
    assert container == {"sqlite3": "rosbag2"}.get(of.container, of.container)


def test_destinations_in_a_folder_or_another_format() -> None:
    found = default_destination(Path("a/x.bag"), "rosbag1", folder=Path("b"), to="mcap")
    assert found == Path("b/x_scan.mcap")
    db3 = [summary("sqlite3")]
    folder = default_destination(Path("a/x.db3"), "sqlite3", to="rosbag2")
    assert (folder, default_storage(folder, db3)) == (Path("a/x_scan"), "sqlite3")
    assert default_storage(default_destination(Path("a/x.db3"), "sqlite3", to="bag"), db3) is None


@pytest.mark.parametrize(("name", "storage", "earliest_ns"), [("a", "mcap", 0), ("b", "sqlite3", -150_000_000)])
def test_transforms_of_a_recording_that_begins_before_1970_have_a_time_that_can_be_stored(
    name: str, storage: str, earliest_ns: int, tmp_path: Path
) -> None:
    """MCAP's times have no sign, and those of rosbag2's database have one."""
    items = [replace(each, log_time_ns=each.log_time_ns - T0 - 150_000_000) for each in CONTENT.items]
    source = write_db3(tmp_path / "a.db3", replace(CONTENT, items=tuple(items)))
    first_ns = min(each.log_time_ns for each in items)
    words = ("--static-tf", "base_link extra 0 0 1 0 0 0", "--write-static-tf", "--min-height", "-5")
    done = run("convert", source, "-o", tmp_path / name, "--storage", storage, *words)
    assert done.status == (0 if storage == "sqlite3" else 3), done.stderr
    kept = [message.log_time_ns for message in opened(tmp_path / name).messages]
    assert min(kept) == max(first_ns, earliest_ns)

"""A destination's name and the options decide its format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pc2scan.bags.destinations import Destination, default_destination, default_storage, plan_destination
from pc2scan.errors import DestinationError
from pc2scan.model import Summary


def plan(name: str, ros_version: int | None = 2, **options: Any) -> Destination:
    return plan_destination(Path(name), source_ros_version=ros_version, **options)


@pytest.mark.parametrize(
    ("name", "options", "expected"),
    [
        ("x.bag", {}, ("rosbag1", "", "lz4", "", 1)),
        ("x.BAG", {"compression": "bz2"}, ("rosbag1", "", "bz2", "", 1)),
        ("x.bag", {"compression": "none"}, ("rosbag1", "", "none", "", 1)),
        ("x.mcap", {}, ("mcap", "", "zstd", "ros2", 2)),
        ("x.mcap", {"ros_version": 1}, ("mcap", "", "zstd", "ros1", 1)),
        ("x.mcap", {"ros_version": None}, ("mcap", "", "zstd", "ros2", 2)),
        ("x.mcap", {"ros_version": 1, "profile": "ros2"}, ("mcap", "", "zstd", "ros2", 2)),
        ("x.mcap", {"profile": "ros1", "compression": "lz4"}, ("mcap", "", "lz4", "ros1", 1)),
        ("x", {}, ("rosbag2", "mcap", "zstd", "", 2)),
        ("2024-01-01-12.30", {"ros_version": 1}, ("rosbag2", "mcap", "zstd", "", 2)),
        ("x", {"storage": "sqlite3"}, ("rosbag2", "sqlite3", "none", "", 2)),
        ("x", {"storage": "sqlite3", "compression": "zstd"}, ("rosbag2", "sqlite3", "zstd", "", 2)),
    ],
)
def test_name_and_options_decide_the_format(
    name: str, options: dict[str, Any], expected: tuple[str, str, str, str, int]
) -> None:
    found = plan(name, **options)
    assert (found.container, found.storage, found.compression, found.profile, found.ros_version) == expected
    assert found.path == Path(name)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("x", {"storage": "leveldb"}, "`storage=leveldb` is not possible here; allowed: mcap, sqlite3"),
        ("x.mcap", {"profile": "ros3"}, "allowed: ros1, ros2"),
        ("x", {"metadata_version": 7}, "metadata version 7 cannot be written, only 8 and 9"),
        ("k.mp4", {}, r"\.mp4 is not a destination"),
    ],
)
def test_impossible_destinations_are_refused(name: str, options: dict[str, Any], message: str) -> None:
    """The command refuses more of them: see ``tests/transcripts/destinations.txt``."""
    with pytest.raises(DestinationError, match=message) as caught:
        plan(name, **options)
    assert caught.value.path == Path(name)


def test_a_directory_may_have_the_name_of_a_file() -> None:
    assert plan("k.mp4", is_directory=True).container == "rosbag2"


def summary(container: str, storage: str = "") -> Summary:
    return Summary(container, storage, (), 0, None, None, None)


@pytest.mark.parametrize(
    ("source", "of", "expected", "storage"),
    [
        ("a/x.bag", summary("rosbag1"), "a/x_scan.bag", None),
        ("a/x.bag.active", summary("rosbag1"), "a/x_scan.bag", None),
        ("a/x", summary("rosbag1"), "a/x_scan.bag", None),
        ("a/x.mcap", summary("mcap"), "a/x_scan.mcap", None),
        ("a/x.mcap.zst", summary("mcap"), "a/x_scan.mcap", None),
        ("a/2024.01", summary("mcap"), "a/2024.01_scan.mcap", None),
        ("a/x", summary("rosbag2", "mcap"), "a/x_scan", "mcap"),
        ("a/x/", summary("rosbag2", "sqlite3"), "a/x_scan", "sqlite3"),
        ("a/2024-01-01-12.30.15", summary("rosbag2", "sqlite3"), "a/2024-01-01-12.30.15_scan", "sqlite3"),
        ("a/x_0.db3", summary("sqlite3"), "a/x_0_scan", "sqlite3"),
        (".mcap", summary("mcap"), ".mcap_scan.mcap", None),
    ],
)
def test_the_default_is_beside_the_source(source: str, of: Summary, expected: str, storage: str | None) -> None:
    found = default_destination([Path(source), Path("elsewhere/y.bag")], [of, summary("rosbag1")])
    assert found == Path(expected)
    assert default_storage(found, [of]) == storage
    container = plan_destination(found, storage=storage, source_ros_version=2).container
    assert container == {"sqlite3": "rosbag2"}.get(of.container, of.container)


def test_destinations_in_a_folder_or_another_format() -> None:
    found = default_destination([Path("a/x.bag")], [summary("rosbag1")], folder=Path("b"), to="mcap")
    assert found == Path("b/x_scan.mcap")
    db3 = [summary("sqlite3")]
    folder = default_destination([Path("a/x.db3")], db3, to="rosbag2")
    assert (folder, default_storage(folder, db3)) == (Path("a/x_scan"), "sqlite3")
    assert default_storage(default_destination([Path("a/x.db3")], db3, to="bag"), db3) is None
    with pytest.raises(DestinationError, match="is not a format; allowed: bag, mcap, rosbag2"):
        default_destination([Path("a/x.bag")], [summary("rosbag1")], to="csv")


def test_the_default_destination_of_the_current_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bag").mkdir()
    monkeypatch.chdir(tmp_path / "bag")
    found = default_destination([Path()], [summary("rosbag2", "mcap")])
    assert found == tmp_path.resolve() / "bag_scan"

"""The manifest: complete lines count, the last one of each recording, and nothing else is taken for one."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from pc2scan.batch.identity import Identity
from pc2scan.batch.manifest import (
    BEGUN,
    Begun,
    Manifest,
    Record,
    forget_begun,
    read_begun,
    read_manifest,
    write_begun,
)
from pc2scan.errors import DestinationError, UsageError

if TYPE_CHECKING:
    from pathlib import Path


def record(key: str = "a.bag", outcome: str = "converted") -> Record:
    return Record(
        key=key,
        sources=(f"/data/{key}",),
        identity=Identity(((key, 5, 7),)),
        container="rosbag1",
        options="0" * 32,
        outcome=outcome,
        exit_status=0,
        output="a_scan.bag",
        output_identity=Identity((("a_scan.bag", 3, 9),)),
        started="2026-11-22T00:00:00.000+00:00",
        seconds=1.5,
        report={"topics": []},
    )


def test_a_line_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "manifest.jsonl"
    with Manifest(path) as manifest:
        manifest.append(record())
        manifest.append(record("ü\n.bag", "incomplete"))
        manifest.append(record(outcome="empty"))
    assert read_manifest(path) == {"a.bag": record(outcome="empty"), "ü\n.bag": record("ü\n.bag", "incomplete")}
    assert len(path.read_bytes().splitlines()) == 3


@pytest.mark.parametrize("cut", [1, 40, 200])
def test_a_torn_last_line_is_ignored_and_then_removed(cut: int, tmp_path: Path) -> None:
    path = tmp_path / "manifest.jsonl"
    with Manifest(path) as manifest:
        manifest.append(record())
        manifest.append(record("b.bag"))
    path.write_bytes(path.read_bytes()[:-cut])
    assert read_manifest(path).keys() == {"a.bag"}
    with Manifest(path) as manifest:
        manifest.append(record("c.bag"))
    assert read_manifest(path).keys() == {"a.bag", "c.bag"}
    assert [json.loads(line)["key"] for line in path.read_text().splitlines()] == ["a.bag", "c.bag"]


@pytest.mark.parametrize("size", [0, 3, 11])
def test_a_torn_first_line_is_no_line(size: int, tmp_path: Path) -> None:
    path = tmp_path / "manifest.jsonl"
    path.write_bytes(b'{"pc2scan": "0.1'[:size])
    assert read_manifest(path) == {}


@pytest.mark.parametrize("text", ['{"image": 1}\n', "x", "[]\n"])
def test_another_programs_manifest_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "manifest.jsonl"
    path.write_text(text)
    with pytest.raises(DestinationError, match="is not a manifest of pc2scan batch"):
        read_manifest(path)


@pytest.mark.parametrize(
    "change",
    [
        lambda line: line.replace("exit_status", "status", 1),
        lambda line: line[:50],
        lambda line: line.replace('"path": "a_scan.bag"', '"path": "../../precious"'),
        lambda line: line.replace('"path": "a_scan.bag"', '"path": "/precious"'),
    ],
)
def test_a_line_that_was_edited_is_named(change: object, tmp_path: Path) -> None:
    path = tmp_path / "manifest.jsonl"
    with Manifest(path) as manifest:
        for key in ("a.bag", "b.bag"):
            manifest.append(record(key))
    first, second = path.read_text().splitlines()
    path.write_text(f"{first}\n{change(second)}\n{first}\n")  # type: ignore[operator]
    with pytest.raises(UsageError, match="line 2 is not a line of a manifest"):
        read_manifest(path)


def test_what_is_begun_is_noted(tmp_path: Path) -> None:
    assert read_begun(tmp_path) == Begun()
    write_begun(tmp_path, Begun(frozenset({"b", "a"})))
    written = Begun(frozenset({"r/c"}), frozenset({"r"}))
    write_begun(tmp_path, written)
    assert read_begun(tmp_path) == written
    # As version 1.0 wrote it.
    (tmp_path / ".pc2scan-begun.json").write_text('{"pc2scan begun": "1.0", "outputs": ["c"]}\n')
    assert read_begun(tmp_path) == Begun(frozenset({"c"}))
    forget_begun(tmp_path)
    forget_begun(tmp_path)
    assert list(tmp_path.iterdir()) == []
    for text in ("precious", '{"pc2scan begun": "1", "outputs": ["../x"]}'):
        (tmp_path / BEGUN).write_text(text)
        with pytest.raises(DestinationError, match="was not written by pc2scan batch"):
            read_begun(tmp_path)

"""What is in the folder of a batch beside the results: the manifest, and the note of a run that was killed.

That later runs follow the manifest is in `test_done_again`.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

import pc2scan
from pc2scan.errors import DestinationError, UsageError
from support.batches import batch, contents, manifest_of, place

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A recording, files that are not recordings, and a folder for results."""
    place(tmp_path / "in", "a.bag")
    for name in ("b.bag", "ü\n.bag"):
        (tmp_path / "in" / name).touch()
    (tmp_path / "out").mkdir()
    return tmp_path


def test_each_recording_has_a_line_of_json(tree: Path) -> None:
    batch(tree / "in", tree / "out")
    lines = (tree / "out" / "manifest.jsonl").read_bytes().splitlines()
    assert [json.loads(line)["key"] for line in lines] == ["b.bag", "ü\n.bag", "a.bag"]
    line, source = manifest_of(tree / "out")["a.bag"], tree / "in" / "a.bag"
    assert line["source"]["paths"] == [str(source)]
    assert line["source"]["files"] == [["a.bag", source.stat().st_size, source.stat().st_mtime_ns]]
    assert (line["outcome"], line["exit_status"], line["attempts"]) == ("converted", 0, 1)
    assert line["pc2scan"] == pc2scan.__version__
    assert manifest_of(tree / "out")["b.bag"]["error"]["message"] == "is empty"


@pytest.mark.parametrize("text", ['{"image": 1}\n', "x", "[]\n", "{}\n"])
def test_another_programs_manifest_is_refused(text: str, tree: Path) -> None:
    (tree / "out" / "manifest.jsonl").write_text(text)
    with pytest.raises(DestinationError, match="is not a manifest of pc2scan batch"):
        batch(tree / "in", tree / "out")
    assert (tree / "out" / "manifest.jsonl").read_text() == text


@pytest.mark.parametrize("size", [0, 3, 11])
def test_a_torn_first_line_is_no_line(size: int, tree: Path) -> None:
    (tree / "out" / "manifest.jsonl").write_bytes(b'{"pc2scan": "0.1'[:size])
    assert [each.why for each in batch(tree / "in" / "a.bag", tree / "out").outcomes] == ["new"]
    assert manifest_of(tree / "out").keys() == {"a.bag"}


@pytest.mark.parametrize(
    "change",
    [
        lambda line: line.replace("exit_status", "status", 1),
        lambda line: line[:50],
        lambda line: line.replace('"path": "a_scan.bag"', '"path": "../../precious"'),
        lambda line: line.replace('"path": "a_scan.bag"', '"path": "/precious"'),
    ],
)
def test_a_line_that_was_edited_is_named(change: Callable[[str], str], tree: Path) -> None:
    path = tree / "out" / "manifest.jsonl"
    batch(tree / "in" / "b.bag", tree / "out")
    batch(tree / "in" / "a.bag", tree / "out")
    first, second = path.read_text().splitlines()
    path.write_text(f"{first}\n{change(second)}\n{first}\n")
    with pytest.raises(UsageError, match="line 2 is not a line of a manifest"):
        batch(tree / "in", tree / "out")


# --- The note of a run that was killed ---


NOTE = ".pc2scan-begun.json"


@pytest.mark.parametrize("folders", ["", ', "folders": ["made"]'])
def test_what_a_killed_run_began_is_converted_again(folders: str, tree: Path) -> None:
    out = tree / "out"
    batch(tree / "in", out)
    expected = contents(out)
    (out / "manifest.jsonl").unlink()
    (out / "made").mkdir()
    outputs = '["a_scan.bag", "made/x.bag"]'
    (out / NOTE).write_text(f'{{"pc2scan begun": "1.0", "outputs": {outputs}{folders}}}\n')
    (out / "a_scan.bag").write_text("half")
    report = batch(tree / "in" / "a.bag", out)
    assert [(each.outcome, each.why) for each in report.outcomes] == [("converted", "interrupted before")]
    assert contents(out) == expected
    # Empty folders of the user's stay, those that the run made go.
    assert (out / "made").exists() == (not folders)


def test_a_note_that_is_in_the_manifest_goes(tree: Path) -> None:
    batch(tree / "in" / "a.bag", tree / "out")
    (tree / "out" / NOTE).write_text('{"pc2scan begun": "1.0", "outputs": ["a_scan.bag"]}\n')
    assert batch(tree / "in" / "a.bag", tree / "out").unchanged == 1
    assert not (tree / "out" / NOTE).exists()


@pytest.mark.parametrize("text", ["precious", '{"pc2scan begun": "1", "outputs": ["../x"]}'])
def test_a_note_of_others_is_refused(text: str, tree: Path) -> None:
    (tree / "out" / NOTE).write_text(text)
    with pytest.raises(DestinationError, match="was not written by pc2scan batch"):
        batch(tree / "in", tree / "out")
    assert contents(tree / "out") == {NOTE: text.encode()}

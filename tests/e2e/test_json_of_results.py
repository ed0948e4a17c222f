"""The JSON of results, as docs/report.md shows it: each example is compared with what its command prints."""

from __future__ import annotations

import json
import re
import shutil
from typing import TYPE_CHECKING, Any

import pytest

from support import ROOT
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

EXAMPLES = re.findall(
    r"```console\n\$ pc2scan (.+)\n(\{(?s:.+?)\n)```", (ROOT / "docs" / "report.md").read_text("utf-8")
)
FIRST = {"pc2scan", "kind", "exit_status", "errors"}
COMMON = FIRST | {"warnings", "notes", "damage", "skipped_count"}


def lacking(example: Any, real: Any, place: str = "$") -> list[str]:
    """Return the places of an example that a result does not have, or has with another type."""
    if isinstance(example, dict) and isinstance(real, dict):
        pairs = [(value, real.get(name, ...), f"{place}.{name}") for name, value in example.items()]
    elif isinstance(example, list) and isinstance(real, list):
        pairs = [(value, (real or [...])[0], f"{place}[0]") for value in example[:1]]
    else:
        return [] if type(example) is type(real) or (None in (example, real) and real is not ...) else [place]
    return [text for pair in pairs for text in lacking(*pair)]


@pytest.mark.parametrize(("words", "example"), EXAMPLES, ids=[words.split()[0] for words, _ in EXAMPLES])
def test_the_json_is_as_the_documentation_shows_it(tmp_path: Path, words: str, example: str) -> None:
    shutil.copy(ROOT / "fixtures" / "hall.bag", tmp_path)
    (tmp_path / "fixtures").symlink_to(ROOT / "fixtures")
    for name, height in (("scan.bag", "-0.3"), ("lower.bag", "-0.4")):
        run("convert", "hall.bag", "-o", name, "--min-height", height, cwd=tmp_path)
    done = run(*words.split(), cwd=tmp_path)
    report = tmp_path / "batch.json"
    found = json.loads(report.read_text("utf-8") if report.exists() else done.stdout)
    shown = json.loads(example)
    assert found.keys() >= (FIRST if found["kind"] == "failure" else COMMON)
    assert found.keys() - COMMON == shown.keys() - COMMON
    assert lacking(shown, found) == []


def test_all_kinds_of_results_are_shown() -> None:
    commands = ["info", "check", "tf", "tf", "diff", "golden", "export", "map", "batch", "info"]
    assert [words.split()[0] for words, _ in EXAMPLES] == commands

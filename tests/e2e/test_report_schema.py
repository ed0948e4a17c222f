"""The JSON schemas of results and the manifest: real ones have exactly what they say."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import pc2scan
from pc2scan.result_schema import results_schema
from support import ROOT, sampled
from support.command import run
from support.schemas import SCHEMAS, violations
from support.tables import rows

TABLES = Path(__file__).with_name("report_schema.txt")
HALL = ROOT / "fixtures" / "hall.bag"
SCANS = "scans:\n  /low: {max_height: 0.3, min_height: -0.3}\n  /high: {min_height: 0.3}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sound recording, one that is cut off, and one of scans."""
    folder = tmp_path_factory.mktemp("reports")
    shutil.copy(HALL, folder)
    (folder / "cut.bag").write_bytes(HALL.read_bytes()[:300_000])
    (folder / "scans.yaml").write_text(SCANS)
    pc2scan.convert(HALL, folder / "scans.bag", min_height=-0.3)
    pc2scan.convert(HALL, folder / "lower.bag", min_height=-0.4)
    return folder


@pytest.mark.parametrize("words", [words for (words,) in rows(TABLES, "reports")])
def test_a_report_is_as_its_schema_says(folder: Path, tmp_path: Path, words: str) -> None:
    run(*words.split(), "-o", tmp_path / "out.bag", "--report", tmp_path / "report.json", cwd=folder)
    report = json.loads((tmp_path / "report.json").read_text("utf-8"))
    schema = SCHEMAS["results.schema.json"]
    assert violations(report, schema, schema) == []
    assert bool(report["damage"]) == ("cut.bag" in words)
    del report["topics"]
    wrong = violations(report | {"more": 1}, schema["$defs"]["report"], schema)
    assert wrong == ["$: topics is missing", "$: more is too much"]


@pytest.mark.parametrize(("kind", "words"), rows(TABLES, "results"))
def test_json_is_as_the_schema_of_results_says(folder: Path, kind: str, words: str) -> None:
    found = json.loads(
        run(*words.replace("GOLDEN", str(ROOT / "fixtures" / "golden")).split(), "--json", cwd=folder).stdout
    )
    schema = SCHEMAS["results.schema.json"]
    assert found["kind"] == kind
    assert violations(found, schema["$defs"][kind], schema) == []


def test_the_schema_of_a_batch_is_that_of_its_report(folder: Path, tmp_path: Path) -> None:
    run("batch", folder / "hall.bag", "-o", tmp_path / "out", "--report", tmp_path / "batch.json")
    found = json.loads((tmp_path / "batch.json").read_text("utf-8"))
    schema = SCHEMAS["results.schema.json"]
    assert violations(found, schema["$defs"]["batch"], schema) == []


def test_the_shipped_schema_is_that_of_the_classes() -> None:
    assert SCHEMAS["results.schema.json"] == results_schema(), "python -m pc2scan.result_schema"


@pytest.mark.parametrize("words", sampled(["", "--export npz"], 1))
def test_a_manifest_is_as_its_schema_says(tmp_path: Path, words: str) -> None:
    broken = tmp_path / "broken.bag"
    broken.write_bytes(HALL.read_bytes()[:100])
    done = run("batch", HALL, broken, "-o", tmp_path / "out", "--min-height", "-0.3", *words.split())
    assert done.status == 1
    assert "2 recordings: 1 failed, 1 converted" in done.stdout
    assert "1 converted now" in done.stdout
    lines = (tmp_path / "out" / "manifest.jsonl").read_text("utf-8").splitlines()
    schema = SCHEMAS["manifest.schema.json"]
    records = [json.loads(line) for line in lines]
    assert {record["outcome"] for record in records} == {"converted", "failed"}
    for record in records:
        assert violations(record, schema, schema) == []

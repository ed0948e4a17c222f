"""The notebook shows what its cells return."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from support import ROOT
from support.notebooks import code_cells, outputs_of, run

NOTEBOOK = ROOT / "docs" / "python.ipynb"


def shown(outputs: list[list[dict[str, Any]]]) -> list[list[dict[str, Any]]]:
    """Outputs without durations, and without sizes, which depend on the version of the compressor."""
    return json.loads(re.sub(r"\d+(\.\d)? (kB|ms|s\b)", "(number)", json.dumps(outputs)))  # type: ignore[no-any-return]


@pytest.mark.slow
def test_the_notebook_shows_what_its_cells_return() -> None:
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    cells = code_cells(json.loads(NOTEBOOK.read_text("utf-8")))
    assert len(cells) > 10
    # python tests/support/notebooks.py docs/python.ipynb
    assert shown([cell["outputs"] for cell in cells]) == shown(run(NOTEBOOK))


def test_the_notebook_is_small_and_well_formed() -> None:
    text = NOTEBOOK.read_text("utf-8")
    assert len(text) < 40_000
    notebook = json.loads(text)
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    identities = [cell["id"] for cell in notebook["cells"]]
    assert len(set(identities)) == len(identities)
    assert "<script" not in text
    assert "/tmp" not in text


def test_cells_are_run_as_jupyter_runs_them() -> None:
    cells: list[dict[str, Any]] = [{"source": ["x = 1\n", "print(x)\n", "x + 1"]}, {"source": "None"}, {"source": "x"}]
    first, second, third = outputs_of(cells)
    assert [output["output_type"] for output in first] == ["stream", "execute_result"]
    assert first[0]["text"] == ["1\n"]
    assert first[1]["data"] == {"text/plain": ["2"]}
    assert second == []
    assert third[0]["data"] == {"text/plain": ["1"]}

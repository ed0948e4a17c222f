"""Runs the code cells of a notebook in this process, as Jupyter would, without a kernel.

``python tests/support/notebooks.py docs/python.ipynb`` runs a notebook in a copy of its surroundings and writes its
outputs into it; without differences the file stays the same, byte for byte.
"""

from __future__ import annotations

import ast
import io
import json
import os
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


def outputs_of(cells: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Run code cells, one after the other in one namespace; return what each shows, in the notebook format."""
    names: dict[str, Any] = {"__name__": "__main__"}
    return [_outputs(cell, names, number) for number, cell in enumerate(cells, 1)]


def _outputs(cell: dict[str, Any], names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    body = ast.parse("".join(cell["source"]))
    last = body.body.pop() if body.body and isinstance(body.body[-1], ast.Expr) else None
    printed, value = io.StringIO(), None
    with redirect_stdout(printed):
        exec(compile(body, f"<cell {number}>", "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), f"<cell {number}>", "eval"), names)
    found: list[dict[str, Any]] = []
    if printed.getvalue():
        found.append({"name": "stdout", "output_type": "stream", "text": _lines(printed.getvalue())})
    if value is not None:
        data = {"text/plain": _lines(repr(value))}
        if (html := getattr(value, "_repr_html_", None)) is not None:
            data = {"text/html": _lines(html())} | data
        found.append({"data": data, "execution_count": number, "metadata": {}, "output_type": "execute_result"})
    return found


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def code_cells(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    """The cells with code."""
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run(path: Path) -> list[list[dict[str, Any]]]:
    """Run a notebook of ``docs/`` in a new process, in a folder beside the fixtures that is removed afterwards."""
    with TemporaryDirectory() as folder:
        shutil.copytree(ROOT / "fixtures", Path(folder) / "fixtures")
        docs = Path(folder) / "docs"
        docs.mkdir()
        done = subprocess.run(
            [sys.executable, "-W", "error", str(Path(__file__).resolve()), "--cells"],
            input=path.read_text("utf-8"),
            capture_output=True,
            text=True,
            cwd=docs,
            env={**os.environ, "COLUMNS": "80", "PYTHONUTF8": "1"},
            timeout=120,
            check=False,
        )
    if done.returncode:
        raise RuntimeError(done.stderr)
    found: list[list[dict[str, Any]]] = json.loads(done.stdout)
    return found


def update(path: Path) -> None:
    """Write the outputs of a notebook into it."""
    notebook = json.loads(path.read_text("utf-8"))
    for number, (cell, outputs) in enumerate(zip(code_cells(notebook), run(path), strict=True), 1):
        cell["outputs"], cell["execution_count"] = outputs, number
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True) + "\n", "utf-8")


if __name__ == "__main__":
    if sys.argv[1:] == ["--cells"]:
        json.dump(outputs_of(code_cells(json.load(sys.stdin))), sys.stdout)
    else:
        for name in sys.argv[1:]:
            update(Path(name))

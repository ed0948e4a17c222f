"""Imports point one way, and the command starts quickly."""

from __future__ import annotations

import ast
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import pc2scan
from support import ROOT

if TYPE_CHECKING:
    from pathlib import Path

PACKAGE = ROOT / "src" / "pc2scan"

#: What each layer may import of pc2scan; its own modules always.
ALLOWED = {
    "errors": set[str](),
    "core": {"errors"},
    "tf": {"core", "errors"},
    "bags": {"errors"},
    "messages": {"bags.model", "core", "errors"},
    "pipeline": {"core", "tf", "messages", "bags", "errors"},
    "inspect": {"pipeline", "core", "tf", "messages", "bags", "errors"},
    "compare": {"messages", "bags", "core", "errors"},
    "golden": {"compare", "bags", "errors"},
    "api": {"pipeline", "compare", "core", "errors"},
    "cli": {"pipeline", "inspect", "compare", "golden", "core", "errors"},
    "pytest_plugin": {"api", "cli", "golden", "errors"},
}

#: What layers may import from elsewhere, beside the standard library.
THIRD_PARTY = {
    "errors": set[str](),
    "core": {"numpy"},
    "tf": {"numpy"},
    "messages": {"numpy", "rosbags"},
    "bags": {"rosbags", "mcap", "lz4", "zstandard", "ruamel"},
    "pipeline": {"numpy", "ruamel"},
    "inspect": {"numpy"},
    "compare": {"numpy"},
    "golden": set(),
    "api": set[str](),
    "cli": {"typer", "rich"},
    "pytest_plugin": {"pytest"},
}

MODULES = sorted(PACKAGE.rglob("*.py"))


def layer_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports_of(path: Path) -> set[str]:
    """Everything a module imports when it runs, by absolute name; imports for type checkers do not count."""
    found: set[str] = set()
    package = ("pc2scan", *path.relative_to(PACKAGE).parent.parts)

    def visit(node: ast.AST) -> None:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for other in node.orelse:
                visit(other)
            return
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(filter(None, (start, node.module)))
            # ``from . import x`` imports a module, ``from .x import y`` a name of it.
            found.update(f"{module}.{alias.name}" if node.module is None else module for alias in node.names)
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(path.read_text("utf-8")))
    return found


def test_imports_are_found() -> None:
    # The test could not fail if it did not see relative imports, or those inside functions.
    found = imports_of(PACKAGE / "bags" / "registry.py")
    assert any(name.startswith("pc2scan.bags.") for name in found)
    assert "pc2scan.errors" in found
    assert {layer_of(path) for path in MODULES} == {*ALLOWED, "__init__", "__main__"}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_one_way(path: Path) -> None:
    layer = layer_of(path)
    if layer in ("__init__", "__main__"):
        return
    allowed = {f"pc2scan.{name}" for name in (layer, *ALLOWED[layer])}
    wrong = [
        name
        for name in imports_of(path)
        if name.startswith("pc2scan.") and not any(name == a or name.startswith(f"{a}.") for a in allowed)
    ]
    assert wrong == []


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_libraries_stay_in_their_layers(path: Path) -> None:
    allowed = THIRD_PARTY.get(layer_of(path), set())
    outside = {name.split(".")[0] for name in imports_of(path)} - {"pc2scan", *sys.stdlib_module_names}
    assert outside <= allowed


HEAVY = ("numpy", "rosbags", "mcap", "rich.progress", "sqlite3", "ruamel", "lz4", "zstandard")


@pytest.mark.parametrize(
    "code",
    ["import pc2scan", "from pc2scan.cli import main\nimport sys\nsys.argv = ['pc2scan', '--help']\nmain()"],
    ids=["import", "help"],
)
def test_starting_is_cheap(code: str) -> None:
    show = (
        f"import atexit, sys\natexit.register(lambda: print('loaded:', *(n for n in {HEAVY!r} if n in sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", show + code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "loaded:"


def test_public_names_exist() -> None:
    assert pc2scan.__all__ == sorted(pc2scan.__all__)
    assert all(getattr(pc2scan, name).__doc__ for name in pc2scan.__all__)
    assert (PACKAGE / "py.typed").exists()

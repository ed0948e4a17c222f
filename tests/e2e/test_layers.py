"""Imports point one way, and stand at the top."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pc2scan
from support import ROOT
from support.tables import rows

PACKAGE = ROOT / "src" / "pc2scan"

TABLES = Path(__file__).with_name("layers.txt")

GROUND = {name for (name,) in rows(TABLES, "ground")}
ALLOWED = {name: set[str]() for name in GROUND}
THIRD_PARTY = dict(ALLOWED)
for layer, own, foreign in rows(TABLES, "layers"):
    ALLOWED[layer], THIRD_PARTY[layer] = set(own.split()), set(foreign.split())


MODULES = sorted(PACKAGE.rglob("*.py"))


def layer_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def name_of(path: Path) -> str:
    parts = ("pc2scan", *path.relative_to(PACKAGE).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {name_of(path): path for path in MODULES}


class Imports(NamedTuple):
    """What a module imports, by absolute name: always, what only type checkers see, and the lines inside functions."""

    always: set[str]
    types: set[str]
    late: list[str]

    @property
    def all(self) -> set[str]:
        return self.always | self.types


def imports_in(text: str, package: str) -> Imports:
    """Everything that a module of ``package`` imports."""
    found = Imports(set(), set(), [])
    parents = package.split(".")

    def imported(module: str, name: str) -> str:
        full = f"{module}.{name}"
        if full in NAMES:
            return full
        # The package's own names are those of other modules.
        home = pc2scan._HOMES.get(name) if module == "pc2scan" else None
        return f"pc2scan.{home}" if home else module

    def visit(node: ast.AST, into: set[str], *, inside: bool = False) -> None:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for other in node.body:
                visit(other, found.types)
            for other in node.orelse:
                visit(other, into)
            return
        if inside and isinstance(node, ast.Import | ast.ImportFrom):
            found.late.append(ast.unparse(node))
        if isinstance(node, ast.Import):
            into.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = ".".join(parents[: len(parents) - node.level + 1]) if node.level else ""
            module = ".".join(filter(None, (start, node.module)))
            into.update(imported(module, alias.name) for alias in node.names)
        # By name. Where that is a variable, it is a module of a table.
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "import_module":
            names = [name.value for name in node.args[:1] if isinstance(name, ast.Constant)]
            into.update(importlib.util.resolve_name(str(name), package) for name in names)
        for child in ast.iter_child_nodes(node):
            visit(child, into, inside=inside or isinstance(node, ast.FunctionDef))

    visit(ast.parse(text), found.always)
    return found


@cache
def graph() -> dict[Path, Imports]:
    """What every module imports."""
    return {
        path: imports_in(path.read_text("utf-8"), name if path.name == "__init__.py" else name.rpartition(".")[0])
        for name, path in NAMES.items()
    }


def test_imports_are_found() -> None:
    # The other tests could not fail if one of these were not seen.
    text = """
from __future__ import annotations
from typing import TYPE_CHECKING
from pc2scan import errors, convert
from . import recording
from .plan import Plan
if TYPE_CHECKING:
    from pc2scan import model
    from pc2scan.bags import open_recordings
def late():
    from pc2scan.transforms.buffer import TransformBuffer
    import numpy as np
    read = import_module("pc2scan.parsing").params_from_file
    read = import_module(".params_file", __package__)
"""
    always = {"pc2scan.errors", "pc2scan.api", "pc2scan.conversion.recording", "pc2scan.conversion.plan"}
    always |= {"pc2scan.transforms.buffer"}
    always |= {"pc2scan.parsing", "pc2scan.conversion.params_file", "__future__", "typing", "numpy"}
    late = ["from pc2scan.transforms.buffer import TransformBuffer", "import numpy as np"]
    assert imports_in(text, "pc2scan.conversion") == (always, {"pc2scan.model", "pc2scan.bags"}, late)
    assert {layer_of(path) for path in MODULES} == {*ALLOWED, "__init__", "__main__"}


def test_layers_import_only_what_they_may() -> None:
    wrong = []
    for path, imports in graph().items():
        layer = layer_of(path)
        allowed = {f"pc2scan.{name}" for name in {layer, *ALLOWED.get(layer, ALLOWED), *GROUND}}
        own = {name for name in imports.all if name.split(".")[0] == "pc2scan"} - {name_of(path)}
        wrong += [
            f"{name_of(path)} imports {name}"
            for name in own
            if not any(name == other or name.startswith(f"{other}.") for other in allowed)
        ]
        libraries = {name.split(".")[0] for name in imports.always}
        libraries -= {"pc2scan", *sys.stdlib_module_names, *THIRD_PARTY.get(layer, ())}
        wrong += [f"{name_of(path)} imports {library}" for library in libraries]
    assert wrong == []


def circles(left: dict[str, set[str]]) -> dict[str, set[str]]:
    """What is left of a graph when everything is gone that needs nothing of the rest."""
    while free := [name for name, needed in left.items() if not needed & left.keys()]:
        for name in free:
            del left[name]
    return left


def test_neither_modules_nor_packages_import_each_other() -> None:
    # Also where it would work, because one of the imports is late or for types only: such modules are one.
    modules = {name_of(path): (imports.all & NAMES.keys()) - {name_of(path)} for path, imports in graph().items()}
    packages: dict[str, set[str]] = {}
    for path, imports in graph().items():
        others = {name.split(".")[1] for name in imports.all & NAMES.keys() if "." in name}
        packages.setdefault(layer_of(path), set()).update(others - {layer_of(path)})
    assert (circles(modules), circles(packages)) == ({}, {})


#: Imports inside functions: of extras, of modules chosen by name, and of two libraries that few conversions need.
MOST_LATE_IMPORTS = 34


def test_imports_stand_at_the_top() -> None:
    late = [f"{name_of(path)}: {line}" for path, imports in graph().items() for line in imports.late]
    assert len(late) <= MOST_LATE_IMPORTS, late


def test_importing_the_library_loads_none_of_its_libraries() -> None:
    heavy = ("fsspec", "numpy", "rosbags", "mcap", "rich", "apsw", "ruamel", "lz4", "zstandard", "typer")
    code = f"import sys, pc2scan\nassert not sys.modules.keys() & set({heavy!r})"
    subprocess.run([sys.executable, "-c", code], timeout=60, check=True)

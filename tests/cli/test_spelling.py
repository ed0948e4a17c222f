from __future__ import annotations

import ast
import re

import pytest

from pc2scan.cli.spelling import as_typed
from pc2scan.options.table import spelling_of
from support import ROOT

PACKAGE = ROOT / "src" / "pc2scan"


@pytest.mark.parametrize(
    ("text", "typed"),
    [
        ("`overwrite=True` replaces it", "--overwrite replaces it"),
        ("`topics=/points:=/scan_2`", "--topic /points:=/scan_2"),
        ("without `strict`, `angle_min=-3.14` and `scan_time`", "without --strict, --angle-min -3.14 and --scan-time"),
        # Text in backticks that is no option is unchanged.
        ("`ls` and `pc2scan tf` and `min height` and `", "`ls` and `pc2scan tf` and `min height` and `"),
        ("range_max 5 m", "range_max 5 m"),
    ],
)
def test_options_are_spelled_as_they_are_typed(text: str, typed: str) -> None:
    assert as_typed(text) == typed


def texts_of(source: str) -> list[str]:
    """All text of a module that is no docstring."""
    tree = ast.parse(source)
    prose = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in prose]
    return [node.value for node in nodes if isinstance(node.value, str)]


def test_the_library_names_options_that_there_are() -> None:
    # An f-string's parts are looked at one by one, so the closing backtick may be in another.
    named: dict[str, str] = {}
    for path in PACKAGE.rglob("*.py"):
        if path.parent.name != "cli":
            for text in texts_of(path.read_text("utf-8")):
                named |= dict.fromkeys(re.findall(r"`([a-z_]+)(?:=|`)", text), str(path))
    assert {"overwrite", "topics", "angle_min", "target_frame"} <= named.keys()
    assert {name: path for name, path in named.items() if spelling_of(name) is None} == {}


#: Modules below the command line whose texts have options, and why.
OPTIONS_BELOW = {
    "options/commands.py": "how options are typed",
    "options/conversion.py": "likewise",
    "options/option.py": "likewise",
    "options/projection.py": "likewise",
    "options/running.py": "likewise",
    "pipeline/parameters.py": "where a parameter comes from, as it was typed",
    "pipeline/param_assignment.py": "likewise",
    "pipeline/launch_file.py": "ROS's own options, which launch files have",
    "bags/formats.py": "the options of ROS's own players",
    "golden/case.py": "the arguments of a command, which cases have",
    "golden/check.py": "the arguments of the command that golden cases run",
    "compare/scan_text.py": "the first line of files that are kept: they stay as they are, to the byte",
}


def test_only_the_command_line_speaks_of_its_options() -> None:
    found = {
        str(path.relative_to(PACKAGE)): text
        for path in PACKAGE.rglob("*.py")
        if path.relative_to(PACKAGE).parts[0] not in {"cli", "pytest_plugin"}
        for text in texts_of(path.read_text("utf-8"))
        if re.search(r"--([a-z]|$)", text)
    }
    assert {path: text for path, text in found.items() if path not in OPTIONS_BELOW} == {}
    assert found.keys() == OPTIONS_BELOW.keys()

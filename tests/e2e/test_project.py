"""What is around the code: workflows, the action, the version."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from ruamel.yaml import YAML

import pc2scan
from pc2scan.version import __version__
from support import ROOT, sampled
from support.command import environment

FILES = sorted(
    path.relative_to(ROOT).as_posix()
    for pattern in (".github/**/*.yml", "action.yml", ".pre-commit-hooks.yaml", "CITATION.cff", ".ci/conda/*.yaml")
    for path in ROOT.glob(pattern)
)


@pytest.mark.parametrize("name", FILES)
def test_it_is_yaml_and_pins_actions_of_others(name: str) -> None:
    text = (ROOT / name).read_text("utf-8")
    assert YAML(typ="safe").load(text)
    # A tag can be moved to other code; a commit cannot.
    assert all(re.fullmatch(r"\S+@[0-9a-f]{40}", action) for action in re.findall(r"uses: (\S+/\S+)", text))


def test_there_is_one_version() -> None:
    assert pc2scan.__version__ == __version__
    assert "version =" not in (ROOT / "pyproject.toml").read_text("utf-8").partition("[project]")[2].partition("\n[")[0]
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text("utf-8")
    assert f'\n  version: "{__version__}"\n' in (ROOT / ".ci" / "conda" / "recipe.yaml").read_text("utf-8")


def test_the_version_is_released_or_not_everywhere() -> None:
    headings = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    version, _, date = headings[0].partition(" ")
    assert version == __version__
    released = re.findall(r"^date-released: (\S+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE)
    assert date == (f"({released[0]})" if released else "(unreleased)")
    named = re.findall(r"(?:pc2scan@|rev: )(\S+)", (ROOT / "docs" / "golden.md").read_text("utf-8"))
    assert set(named) == {f"v{__version__}" if released else "main"}
    assert ("Until the first release" in (ROOT / "README.md").read_text("utf-8")) == (not released)


@pytest.mark.parametrize("name", [".ci/run", ".ci/packages"])
def test_scripts_are_shell(name: str) -> None:
    subprocess.run(["bash", "-n", str(ROOT / name)], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("broken", sampled([True, False], 1))
def test_the_step_of_the_action_shows_the_cases(tmp_path: Path, broken: bool) -> None:
    """Its script, as the runner runs it."""
    shutil.copytree(ROOT / "fixtures" / "golden" / "tf_static", tmp_path / "cases" / "tf_static")
    if broken:
        params = tmp_path / "cases" / "tf_static" / "params.yaml"
        params.write_text(params.read_text("utf-8") + "    range_max: 1.0\n")
    steps = YAML(typ="safe").load((ROOT / "action.yml").read_text("utf-8"))["runs"]["steps"]
    (script,) = [step["run"] for step in steps if "golden.txt" in step.get("run", "")]
    variables = environment() | {
        "CASES": "cases",
        "JUNIT": "golden.xml",
        "RUNNER_TEMP": str(tmp_path),
        "GITHUB_STEP_SUMMARY": str(tmp_path / "summary.md"),
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
    }
    command = ["bash", "-eo", "pipefail", "-c", script]
    done = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == int(broken), done.stderr
    assert "tf_static" in (tmp_path / "summary.md").read_text("utf-8")
    assert (tmp_path / "golden.xml").is_file()


def test_the_conda_recipe_asks_for_what_the_package_asks_for() -> None:
    recipe = YAML(typ="safe").load((ROOT / ".ci" / "conda" / "recipe.yaml").read_text("utf-8"))
    conda = {line.replace("python-isal", "isal") for line in recipe["requirements"]["run"]} - {"python"}
    asked = [line for line in metadata.requires("pc2scan") or () if "extra ==" not in line]
    assert {parts(line) for line in conda} == {parts(line.partition(";")[0]) for line in asked}


def parts(requirement: str) -> tuple[str, frozenset[str]]:
    """The name of a requirement, and its bounds."""
    name, bounds = re.fullmatch(r"([\w.]+) ?(.*)", requirement.strip()).groups()  # type: ignore[union-attr]
    return name, frozenset(bounds.split(","))

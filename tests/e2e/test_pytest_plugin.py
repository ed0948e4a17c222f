"""The pytest plugin, in a pytest of its own that has no other plugins."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from importlib.metadata import entry_points
from typing import TYPE_CHECKING

import pytest

from support import ROOT
from support.command import environment

if TYPE_CHECKING:
    from pathlib import Path

CASES = ("tf_static", "scan_plain", "same_target_frame")


def pytest_run(folder: Path, *arguments: str) -> tuple[int, str]:
    # Loaded by name, as the entry point would load it; where pc2scan is installed, that must not load it twice.
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "pytest", "-p", "pc2scan.pytest_plugin", "--color=no", *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**environment(), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": "-p no:cacheprovider"},
        timeout=100,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A user's project: tests, and a folder of golden cases."""
    for name in CASES:
        shutil.copytree(ROOT / "fixtures" / "golden" / name, tmp_path / "golden" / name)
    (tmp_path / "tests").mkdir()
    (tmp_path / "pyproject.toml").write_text('[tool.pytest.ini_options]\ntestpaths = ["tests"]\n')
    return tmp_path


def write_test(project: Path, text: str) -> None:
    (project / "tests" / "test_own.py").write_text(text)


def outcomes(text: str) -> dict[str, str]:
    return dict(re.findall(r"^(\S+) (PASSED|FAILED|SKIPPED|ERROR) ", text, re.MULTILINE))


def test_the_entry_point_is_declared() -> None:
    (declared,) = entry_points(group="pytest11", name="pc2scan")
    assert declared.value == "pc2scan.pytest_plugin"


def test_without_being_asked_it_does_nothing_and_loads_nothing(project: Path) -> None:
    write_test(
        project,
        "import sys\n"
        "def test_own():\n"
        "    assert 'pc2scan.pytest_plugin' in sys.modules\n"
        "    heavy = {'numpy', 'rosbags', 'mcap', 'typer', 'ruamel', 'pc2scan.cli', 'pc2scan.golden'}\n"
        "    assert not heavy & sys.modules.keys()\n",
    )
    status, text = pytest_run(project, "-v", ".")
    assert status == 0, text
    assert outcomes(text) == {"tests/test_own.py::test_own": "PASSED"}


def test_cases_of_a_folder_on_request(project: Path) -> None:
    write_test(project, "def test_own(): pass\n")
    params = project / "golden" / "same_target_frame" / "params.yaml"
    params.write_text(params.read_text().replace("range_max: 30.0", "range_max: 31.0"))
    status, text = pytest_run(project, "-v", "--pc2scan-golden", "golden")
    assert status == 1
    assert outcomes(text) == {
        "tests/test_own.py::test_own": "PASSED",
        "golden/same_target_frame": "FAILED",
        "golden/scan_plain": "PASSED",
        "golden/tf_static": "PASSED",
    }
    assert "range_max" in text
    assert "30.0 in expected, 31.0 in actual" in text
    assert "Traceback" not in text
    # What pytest prints is chosen by -k; updated, it passes from then on.
    status, text = pytest_run(project, "-v", "--pc2scan-golden", "golden", "--pc2scan-update", "-k", "same", "-rP")
    assert status == 0, text
    assert outcomes(text) == {"golden/same_target_frame": "PASSED"}
    assert "updated" in text
    assert pytest_run(project, "--pc2scan-golden", "golden")[0] == 0


def test_the_ini_option_takes_the_folder_where_pytest_comes_by(project: Path) -> None:
    write_test(project, "def test_own(): pass\n")
    (project / "pyproject.toml").write_text(
        '[tool.pytest.ini_options]\ntestpaths = ["tests", "golden"]\npc2scan_golden = ["golden"]\n'
    )
    status, text = pytest_run(project, "-v")
    assert status == 0, text
    assert len(outcomes(text)) == 4
    status, text = pytest_run(project, "-v", "tests")
    assert set(outcomes(text)) == {"tests/test_own.py::test_own"}
    # What pytest prints can be given to it again.
    status, text = pytest_run(project, "-v", "golden/tf_static")
    assert set(outcomes(text)) == {"golden/tf_static"}


def test_a_case_that_cannot_be_checked_fails(project: Path) -> None:
    (project / "golden" / "tf_static" / "case.yaml").write_text("tolerance: 1\n")
    status, text = pytest_run(project, "-v", "golden", "--pc2scan-golden", "golden", "-k", "tf_static")
    assert status == 1
    assert "unknown key 'tolerance'" in text


def test_a_folder_that_is_not_there(project: Path) -> None:
    status, text = pytest_run(project, "--pc2scan-golden", "goldfish")
    assert status == 4
    assert "goldfish" in text


def test_the_fixtures(project: Path) -> None:
    write_test(
        project,
        "import pytest\n"
        "CASE = 'golden/tf_static'\n"
        "def test_same(assert_same_scans):\n"
        "    assert_same_scans(f'{CASE}/expected.bag', f'{CASE}/expected.bag', rtol=1e-5, ignore=['seq'])\n"
        "def test_different(assert_same_scans):\n"
        "    assert_same_scans('golden/same_target_frame/expected.bag', f'{CASE}/expected.bag', atol={'ranges': 0.1})\n"
        "def test_case(pc2scan_golden):\n"
        "    pc2scan_golden(CASE)\n"
        "def test_no_case(pc2scan_golden):\n"
        "    pc2scan_golden('tests')\n",
    )
    status, text = pytest_run(project, "-v", "tests")
    assert status == 1
    own = "tests/test_own.py::test_"
    assert outcomes(text) == {
        f"{own}same": "PASSED",
        f"{own}different": "FAILED",
        f"{own}case": "PASSED",
        f"{own}no_case": "FAILED",
    }
    assert "'lidar' in expected, 'base_link' in actual" in text
    assert "has no input" in text
    assert "pytest_plugin" not in text.partition("FAILURES")[2]

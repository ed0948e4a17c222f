"""The pytest plugin, in a pytest of its own that has no other plugins."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from support import ROOT, sampled
from support.command import environment

if TYPE_CHECKING:
    from pathlib import Path

UNASKED = """\
import sys
def test_nothing_is_loaded():
    assert 'pc2scan.pytest_plugin' in sys.modules
    heavy = {'numpy', 'rosbags', 'mcap', 'typer', 'ruamel', 'pc2scan.cli', 'pc2scan.compare'}
    assert not heavy & sys.modules.keys()
"""
TESTS = """\
CASE = 'golden/tf_static'
def test_same(assert_same_scans):
    assert_same_scans(f'{CASE}/expected.bag', f'{CASE}/expected.bag', rtol=1e-5, ignore=['seq'])
def test_different(assert_same_scans):
    assert_same_scans('golden/changed/expected.bag', f'{CASE}/expected.bag', atol={'ranges': 0.1})
def test_case(pc2scan_golden):
    pc2scan_golden(CASE)
def test_no_case(pc2scan_golden):
    pc2scan_golden('tests')
"""
OWN = {
    f"tests/test_own.py::test_{name}": outcome
    for name, outcome in {"same": "PASSED", "different": "FAILED", "case": "PASSED", "no_case": "FAILED"}.items()
}
CASES = {"golden/broken": "FAILED", "golden/changed": "FAILED", "golden/tf_static": "PASSED"}


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A user's project: tests, and a folder of golden cases, one with other parameters, one with wrong settings."""
    for name, case in {"broken": "scan_plain", "changed": "same_target_frame", "tf_static": "tf_static"}.items():
        shutil.copytree(ROOT / "fixtures" / "golden" / case, tmp_path / "golden" / name)
    params = tmp_path / "golden" / "changed" / "params.yaml"
    params.write_text(params.read_text().replace("range_max: 30.0", "range_max: 31.0"))
    (tmp_path / "golden" / "broken" / "case.yaml").write_text("tolerance: 1\n")
    for name, text in {"tests": TESTS, "unasked": UNASKED}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "test_own.py").write_text(text)
    (tmp_path / "pytest.ini").write_text("[pytest]\ntestpaths = tests\n")
    (tmp_path / "asked.ini").write_text("[pytest]\ntestpaths = tests golden\npc2scan_golden = golden\n")
    return tmp_path


def pytest_run(folder: Path, *arguments: str) -> tuple[int, dict[str, str], str]:
    """The status, the outcomes, and the text."""
    # Loaded by name, as the entry point would load it; where pc2scan is installed, that must not load it twice.
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "pytest", "-v", "-p", "pc2scan.pytest_plugin", "--color=no", *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**environment(), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": "-p no:cacheprovider"},
        timeout=100,
        check=False,
    )
    text = done.stdout + done.stderr
    return done.returncode, dict(re.findall(r"^(\S+) (PASSED|FAILED|SKIPPED|ERROR) ", text, re.MULTILINE)), text


@pytest.mark.parametrize(
    ("words", "status", "outcomes", "said"),
    sampled(
        [
            # With both: cases, and the fixtures in tests; what differs is said.
            (
                "--pc2scan-golden golden",
                1,
                {**OWN, **CASES},
                (
                    "30.0 in expected, 31.0 in actual",
                    "unknown key 'tolerance'",
                    "'lidar' in expected, 'base_link' in actual",
                    "has no input",
                ),
            ),
            # The ini option takes the folder where pytest comes by; what pytest prints can be given to it again.
            ("-c asked.ini", 1, {**OWN, **CASES}, ()),
            # What is not asked for is not collected, and nothing is loaded for it.
            ("unasked golden", 0, {"unasked/test_own.py::test_nothing_is_loaded": "PASSED"}, ()),
        ],
        1,
    ),
)
def test_cases_and_fixtures(
    words: str, status: int, outcomes: dict[str, str], said: tuple[str, ...], project: Path
) -> None:
    ended, found, text = pytest_run(project, *words.split())
    assert (ended, found) == (status, outcomes), text
    assert all(each in text for each in said), text
    assert "Traceback" not in text
    assert "pytest_plugin" not in text.partition("FAILURES")[2]

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

import pytest

from pc2scan.cli.junit import JUnitCase, junit_output, junit_xml
from pc2scan.errors import DestinationError
from pc2scan.options.call import Options

if TYPE_CHECKING:
    from pathlib import Path


def test_every_outcome_has_its_element() -> None:
    cases = [
        JUnitCase("a", seconds=0.25),
        JUnitCase("b", "failure", ("/scan: <different> & \x1b[2J", "  more"), seconds=0.5),
        JUnitCase("c", "error", ("has no input",)),
        JUnitCase("d", "passed", ("new: expected.txt",)),
    ]
    (suite,) = ET.fromstring(junit_xml("golden", cases))
    assert suite.attrib == {
        "name": "pc2scan golden", "tests": "4", "failures": "1", "errors": "1", "skipped": "0", "time": "0.750",
    }  # fmt: skip
    passed, failed, error, updated = suite
    assert (passed.get("name"), passed.get("classname"), passed.get("time")) == ("a", "pc2scan.golden", "0.250")
    assert len(passed) == 0
    assert failed[0].tag == "failure"
    # XML cannot have an escape character.
    assert failed[0].get("message") == r"/scan: <different> & \x1b[2J"
    assert (failed[0].text or "").splitlines()[1] == "  more"
    assert error[0].tag == "error"
    assert updated[0].tag == "system-out"


def test_it_replaces_its_own_files_only_and_no_input(tmp_path: Path) -> None:
    file = tmp_path / "result.xml"
    for command in ("golden", "check"):
        with junit_output(Options("check", {"junit": file}), command) as write:
            write([JUnitCase("a")])
        assert f"pc2scan {command}" in file.read_text()
    replacing = Options("check", {"junit": file, "overwrite": True})
    with pytest.raises(DestinationError), junit_output(replacing, "diff", [file]):
        pytest.fail("the body must not run")
    file.write_text("<project/>")
    keeping = Options("check", {"junit": file})
    with pytest.raises(DestinationError, match="exists already"), junit_output(keeping, "diff"):
        pytest.fail("the body must not run")

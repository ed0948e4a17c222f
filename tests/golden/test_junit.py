from __future__ import annotations

import xml.etree.ElementTree as ET

from pc2scan.golden.junit import junit_xml
from pc2scan.golden.result import CaseOutcome, CaseResult, GoldenReport


def test_every_outcome_has_its_element() -> None:
    report = GoldenReport(
        "golden",
        [
            CaseResult("a", CaseOutcome.passed, seconds=0.25),
            CaseResult("b", CaseOutcome.failed, ("/scan: <different> & \x1b[2J", "  more"), seconds=0.5),
            CaseResult("c", CaseOutcome.error, ("has no input",)),
            CaseResult("d", CaseOutcome.updated, ("new: expected.txt",)),
        ],
    )
    (suite,) = ET.fromstring(junit_xml(report))
    assert suite.attrib == {
        "name": "pc2scan golden", "tests": "4", "failures": "1", "errors": "1", "skipped": "0", "time": "0.750",
    }  # fmt: skip
    passed, failed, error, updated = suite
    assert (passed.get("name"), passed.get("classname"), passed.get("time")) == ("a", "pc2scan.golden", "0.250")
    assert len(passed) == 0
    assert failed[0].tag == "failure"
    # XML cannot hold an escape character.
    assert failed[0].get("message") == "/scan: <different> & ?[2J"
    assert (failed[0].text or "").splitlines()[1] == "  more"
    assert error[0].tag == "error"
    assert updated[0].tag == "system-out"
    assert report.exit_status == 2


def test_the_worst_decides() -> None:
    failed, passed = CaseResult("a", CaseOutcome.failed), CaseResult("b", CaseOutcome.updated)
    assert GoldenReport("x", [passed]).exit_status == 0
    assert GoldenReport("x", [passed, failed]).exit_status == 1

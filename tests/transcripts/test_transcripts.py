"""The command as people type it: every case of the texts here; `support.transcripts` says how to write one."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.transcripts import Case, cases_of, check

TEXTS = sorted(Path(__file__).parent.glob("*.txt"))
CASES = [
    pytest.param(case, id=f"{path.stem}: {case.name}") for path in TEXTS for case in cases_of(path.read_text("utf-8"))
]


@pytest.mark.parametrize("case", CASES)
def test_what_is_typed_ends_and_says(case: Case, tmp_path: Path) -> None:
    check(case, tmp_path)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("== a\n$ pc2scan --version\n? 1\n", "status 0, not 1"),
        ("== a\n$ pc2scan --version\nnothing of this\n", "not said: nothing of this"),
        ("== a\n$ pc2scan --version\n! pc2scan\n", "said: pc2scan"),
        ("== a\n$ pc2scan convert hall.bag -o a.bag --min-height -0.3\n$ false\n", "false"),
    ],
)
def test_a_case_can_fail(text: str, wrong: str, tmp_path: Path) -> None:
    (case,) = cases_of(text)
    with pytest.raises(AssertionError, match=wrong):
        check(case, tmp_path)


@pytest.mark.parametrize("text", ["text\n", "== a\n? 2\n", "== a\n$ true\n== a\n$ true\n"])
def test_what_is_no_transcript_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"of no command|one name"):
        cases_of(text)

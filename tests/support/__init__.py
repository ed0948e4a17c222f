"""What several test files need: where the shared material is, and the reasons for skipping."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterable

ROOT = Path(__file__).resolve().parents[2]

#: Half a second of a small robot in a hall.
HALL = ROOT / "fixtures" / "hall.bag"
SHARED = ROOT.parent / "shared"
RECORDINGS = SHARED / "recordings"
# All the cases where they are, and otherwise those that the project carries.
GOLDEN = SHARED / "golden" if (SHARED / "golden").is_dir() else ROOT / "fixtures" / "golden"

needs_shared = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason="the real recordings are not here (../shared/recordings)"
)


def sampled(cases: Iterable[Any], quick: int) -> list[Any]:
    """Return the cases of a parametrized test, of which only some, evenly spread, belong to the quick run.

    All others are marked slow, so that the two runs together run each case once. A tuple is the values of several
    arguments.
    """
    found = list(cases)
    chosen = {number * len(found) // quick for number in range(quick)}
    return [case if number in chosen else _slow(case) for number, case in enumerate(found)]


def stepped(cases: Iterable[Any], step: int) -> list[Any]:
    """Return each case with a step for a loop over bytes: this one in the quick run, and 1 among the slow tests."""
    found = list(cases)
    return [*((case, step) for case in found), *(_slow((case, 1)) for case in found)]


def _slow(case: Any) -> Any:
    if isinstance(case, type(pytest.param())):
        return case._replace(marks=[*case.marks, pytest.mark.slow])
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)

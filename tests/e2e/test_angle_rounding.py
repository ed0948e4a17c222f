"""Which libm the angles are of: what the node returned with a correctly rounding one, and with that of glibc 2.36."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from support import ROOT, sampled
from support.command import run
from support.outputs import opened

if TYPE_CHECKING:
    from pathlib import Path

CASES = sorted(path.parent for path in (ROOT / "fixtures" / "golden_exact").glob("*/expected_old_libm.bag"))


@pytest.mark.parametrize("case", sampled(CASES, 2), ids=lambda case: case.name)
def test_the_older_libm_to_the_byte(case: Path, tmp_path: Path) -> None:
    words = ("--params-file", case / "params.yaml", "--only-scans", "--angle-rounding", "glibc-2.40")
    done = run("convert", case / "input.bag", "-o", tmp_path / "out.bag", *words)
    assert done.status == 0, done.stderr
    expected = opened(case / "expected_old_libm.bag").messages
    assert opened(tmp_path / "out.bag").messages == expected
    assert expected != opened(case / "expected.bag").messages

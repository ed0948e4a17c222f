"""What several test files need: where the shared material is, and the reasons for skipping."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"
RECORDINGS = SHARED / "recordings"
GOLDEN_EXACT = SHARED / "golden_exact" if (SHARED / "golden_exact").is_dir() else ROOT / "fixtures" / "golden_exact"
# All the cases where they are, and otherwise those that the project carries.
GOLDEN = SHARED / "golden" if (SHARED / "golden").is_dir() else ROOT / "fixtures" / "golden"

needs_shared = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason="the real recordings are not here (../shared/recordings)"
)

"""The way of a cloud through the code is short: it has few frames, functions, files, classes and decompressions."""

from __future__ import annotations

from pathlib import Path

import pytest

from support import sampled
from support.loops import needs_compiled
from support.tables import rows
from support.way_of_a_cloud import way_of

BOUNDS = Path(__file__).with_name("way_of_a_cloud.txt")


@needs_compiled
@pytest.mark.parametrize(
    ("arguments", "frames", "functions", "files", "classes", "decompressions"), sampled(rows(BOUNDS, "bounds"), 2)
)
def test_a_conversion_stays_within_its_bounds(
    arguments: str, frames: int, functions: int, files: int, classes: int, decompressions: int
) -> None:
    way = way_of(*arguments.split())
    assert len(way.frames) <= frames, way.frames
    assert way.functions <= functions
    assert way.files <= files
    assert way.classes <= classes
    assert max(way.decompressions.values()) <= decompressions, way.decompressions
    # What is measured is there: the chain is that of the projection, and the chunks are those of the recording.
    assert way.frames[-1] == ("project", "core/_kernel")
    if "--jobs 1" in arguments:
        assert way.frames[0] == ("main", "cli/__init__.py")
    assert min(way.decompressions) > 0

"""What a command takes, the function of its name takes, under the same names; and nothing more, with few exceptions."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.cli.commands import COMMANDS
from pc2scan.errors import UsageError
from pc2scan.options.table import options_of
from support import ROOT
from support.builders import SCAN, Recording, Stream, item, write_mcap
from support.builders import scan as scan_message

if TYPE_CHECKING:
    from pathlib import Path

HALL = ROOT / "fixtures" / "hall.bag"

#: Arguments that a command types as options, and options that only the command has because they are results in Python.
ARGUMENTS = {"sources", "source", "destination", "a", "b", "folder", "pattern"}
ONLY_TYPED = {"tf": {"lookup", "at"}, "view": {"destination"}, "map": {"destination"}}


def taken_by_command(command: str) -> set[str]:
    """The names of what a command takes."""
    own = {argument.name for argument in COMMANDS[command].arguments}
    return own | {name for name, option in options_of(command).items() if option.spelling}


def taken_by_function(function: str) -> set[str]:
    """The names of what a function takes."""
    return set(inspect.signature(getattr(pc2scan, function)).parameters)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_function_takes_what_its_command_takes(command: str) -> None:
    known = options_of(command)
    only_typed = {name for name, option in known.items() if option.command_only} | ONLY_TYPED.get(command, set())
    only_python = {name for name, option in known.items() if option.value.kind == "object"}
    assert taken_by_command(command) - only_typed == taken_by_function(command) - only_python
    assert taken_by_function(command) - ARGUMENTS == {n for n, option in known.items() if not option.command_only}


@pytest.fixture
def spotted(tmp_path: Path) -> Path:
    """Scans with a beam that stands alone: a speckle."""
    ranges = np.full(60, 5.0, np.float32)
    ranges[30] = 1.0
    stream = Stream("/scan", SCAN)
    items = tuple(item(stream, 10**9 + n, lambda g, s: scan_message(ranges, g, seq=s)) for n in range(2))
    return write_mcap(tmp_path / "spotted.mcap", Recording((stream,), items))


def test_beams_are_removed_in_every_function(tmp_path: Path) -> None:
    asked: dict[str, Any] = {"preset": "slam_toolbox", "min_height": -0.3, "remove": "shadows"}
    pc2scan.convert(HALL, tmp_path / "removed.mcap", only_scans=True, **asked)
    pc2scan.convert(HALL, tmp_path / "whole.mcap", only_scans=True, **{**asked, "remove": ()})
    written = [scan.ranges for scan in pc2scan.scans(tmp_path / "removed.mcap")]
    looped = [scan.ranges for scan in pc2scan.scans(HALL, **asked)]
    np.testing.assert_array_equal(written, looped)
    assert not np.array_equal(written, [scan.ranges for scan in pc2scan.scans(tmp_path / "whole.mcap")])
    pc2scan.export(HALL, tmp_path / "a.npz", **asked)
    with np.load(tmp_path / "a.npz") as exported:
        np.testing.assert_array_equal(exported["ranges"], written)
    drawn = [pc2scan.map(HALL, odom_frame="odom", **{**asked, "remove": each}) for each in ("shadows", ())]
    assert not np.array_equal(drawn[0].cells, drawn[1].cells)


def test_beams_of_recorded_scans_are_not_removed_unasked(spotted: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="`remove` have no effect"):
        pc2scan.scans(spotted, remove="speckles")
    with pytest.raises(UsageError, match="no clouds are converted"):
        pc2scan.export(spotted, tmp_path / "a.npz", remove="speckles")
    (first, *_) = pc2scan.scans(spotted, rebin=True, remove="speckles")
    assert np.isinf(first.ranges[30])

"""What a command takes, the function of its name takes, under the same names; and nothing more, with few exceptions."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pc2scan
from pc2scan.cli.commands import COMMANDS
from pc2scan.options.table import options_of
from support import HALL

if TYPE_CHECKING:
    from pathlib import Path


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
    # Of recorded scans, too, which are rebinned.
    counts = [
        sum(np.isfinite(scan.ranges).sum() for scan in pc2scan.scans(tmp_path / "whole.mcap", rebin=True, remove=each))
        for each in ("shadows", ())
    ]
    assert 0 < counts[0] < counts[1]

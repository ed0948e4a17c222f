"""Options that read other things of a cloud, or read it another way, leave the ranges as they are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

import pc2scan
from pc2scan.cli.in_process import run_command
from support import HALL, sampled

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

NEAR = ("--range-max", "4", "--min-height", "-0.3", "-p", "use_inf:=false")
EPSILONS = ["-1", "0", "1", "-inf"]


def ranges_of(folder: Path, *options: str, source: Path = HALL) -> NDArray[np.float32]:
    """The ranges of all scans that a conversion writes."""
    out = folder / "out.bag"
    done = run_command(["convert", str(source), "-o", str(out), "--overwrite", "-q", *options])
    assert done.status in (0, 4), done.messages
    with pc2scan.scans(out) as scans:
        return np.stack([scan.ranges for scan in scans])


@pytest.mark.parametrize("epsilon", sampled(EPSILONS, 1))
@pytest.mark.parametrize(
    "options",
    [
        ("--intensity-field", "intensity"),
        ("-p", "reduce:=kth=1"),
        ("--accumulate", "1clouds"),
        ("--keep-used", "/used"),
    ],
    ids=["intensities", "kth", "accumulate", "keep-used"],
)
def test_ranges_are_those_of_the_node(options: tuple[str, ...], epsilon: str, tmp_path: Path) -> None:
    chosen = (*NEAR, "-p", f"inf_epsilon:={epsilon}")
    np.testing.assert_array_equal(ranges_of(tmp_path, *chosen, *options), ranges_of(tmp_path, *chosen))


@pytest.mark.parametrize("epsilon", sampled(EPSILONS, 1))
def test_rebinned_scans_have_the_ranges_of_their_points(epsilon: str, tmp_path: Path) -> None:
    scans, clouds = tmp_path / "scans.bag", tmp_path / "clouds.bag"
    fine = ("--min-height", "-0.3", "--angle-increment", "0.01", "--intensity-field", "intensity", "--only-scans")
    assert run_command(["convert", str(HALL), "-o", str(scans), *fine]).status == 0
    assert run_command(["convert", str(scans), "-o", str(clouds), "--reverse", "--only-scans"]).status == 0
    chosen = (*NEAR, "-p", f"inf_epsilon:={epsilon}")
    found = ranges_of(tmp_path, *chosen, "--rebin", "--only-scans", source=scans)
    np.testing.assert_array_equal(found, ranges_of(tmp_path, *chosen, "--only-scans", source=clouds))

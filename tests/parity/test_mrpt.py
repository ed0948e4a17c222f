"""Which range each beam takes, against Debian's own MRPT, live: ``mrpt.cpp`` is compiled against its bridge."""

from __future__ import annotations

import random
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from pc2scan.core.consumers import judge
from pc2scan.core.params import ProjectionParams
from pc2scan.core.verdicts import ConsumerScan
from support.compiling import compiled_once, folder_of_the_run

SOURCE = Path(__file__).with_name("mrpt.cpp")
HEADERS = Path("/usr/include/mrpt")
PACKAGES = {
    HEADERS / "ros1bridge/include/mrpt/ros1bridge/laser_scan.h": "libmrpt-ros1bridge-dev",
    HEADERS / "obs/include/mrpt/obs/CObservation2DRangeScan.h": "libmrpt-obs-dev",
    Path("/usr/include/sensor_msgs/LaserScan.h"): "libsensor-msgs-dev",
    Path("/usr/include/eigen3/Eigen/Geometry"): "libeigen3-dev",
}
LIBRARIES = ("mrpt-ros1bridge", "mrpt-obs", "mrpt-poses", "mrpt-core", "mrpt-rtti", "mrpt-serialization", "rostime")

#: angle_min, angle_max and the number of beams.
Sector = tuple[float, float, int]


def why_not() -> str:
    """Why the program cannot be built here; empty if it can."""
    missing = ["g++"] if shutil.which("g++") is None else []
    missing += [package for header, package in PACKAGES.items() if not header.exists()]
    return f"Debian's MRPT is not here: apt-get install {' '.join(missing)}" if missing else ""


@pytest.fixture(scope="session")
def bridge(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if why_not():
        pytest.skip(why_not())
    program = folder_of_the_run(tmp_path_factory) / "bridge"
    headers = [f"-I{folder}" for folder in (*sorted(HEADERS.glob("*/include")), Path("/usr/include/eigen3"))]
    return compiled_once(program, SOURCE, ["-std=c++17", *headers], LIBRARIES)


def taken(program: Path, sectors: list[Sector]) -> list[list[int]]:
    """The index of the range that each of MRPT's beams takes, for each scan."""
    lines = "".join(f"{low.hex()} {high.hex()} {beams}\n" for low, high, beams in sectors)
    done = subprocess.run([program], input=lines, stdout=subprocess.PIPE, text=True, check=True)
    return [[int(index) for index in line.split()] for line in done.stdout.splitlines()]


@pytest.mark.slow
def test_mrpt_2_5_reads_every_beam_of_the_preset(bridge: Path) -> None:
    rng = random.Random(2)
    sectors = []
    for number in range(300):
        half, beams = rng.uniform(0.01, 3.2), rng.randint(3, 4000) if number else 100_000
        layout = ProjectionParams.preset("mrpt", angle_min=-half, angle_max=half, beams=beams).layout
        sectors.append((layout.angle_min, layout.angle_max, layout.count))
    assert taken(bridge, sectors) == [list(range(beams)) for _, _, beams in sectors]


def test_no_accepted_scan_is_misread_by_mrpt_2_5(bridge: Path) -> None:
    rng = random.Random(3)
    accepted = []
    for _ in range(1500):
        beams, increment = rng.randint(3, 800), float(np.float32(rng.uniform(0.001, 0.02)))
        half = (beams - 1) * increment / 2
        low, high = (float(np.float32(side * half + rng.randint(-3, 3) * 1.2e-7)) for side in (-1, 1))
        scan = ConsumerScan(
            angle_min=low,
            angle_max=high,
            angle_increment=increment,
            range_min=0.1,
            range_max=30,
            beams=beams,
            returns=1,
        )
        if judge("mrpt", scan).outcome == "accepted":
            accepted.append((low, high, beams))
    assert len(accepted) > 150
    assert taken(bridge, accepted) == [list(range(beams)) for _, _, beams in accepted]

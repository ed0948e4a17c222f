"""Debian's own tf2, tf2_sensor_msgs and laser_geometry, by ``oracle.cpp``, which is compiled against them."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pc2scan.core.rigid import Rigid
from pc2scan.messages.laserscan import LaserScan
from transforms.trees import EPOCH, SECOND, row

if TYPE_CHECKING:
    import pytest
    from numpy.typing import NDArray

    from transforms.through import Through
    from transforms.trees import Rows

SOURCE = Path(__file__).with_name("oracle.cpp")
PACKAGES = {
    "laser_geometry/laser_geometry.h": "liblaser-geometry-dev",
    "tf2/buffer_core.h": "libtf2-dev",
    "tf2_sensor_msgs/tf2_sensor_msgs.h": "libtf2-sensor-msgs-dev",
    "eigen3/Eigen/Geometry": "libeigen3-dev",
}


def why_not() -> str:
    """Why the program cannot be built here; empty if it can."""
    missing = ["g++"] if shutil.which("g++") is None else []
    missing += [package for header, package in PACKAGES.items() if not Path("/usr/include", header).exists()]
    return f"Debian's ROS is not here: apt-get install {' '.join(missing)}" if missing else ""


def compiled(factory: pytest.TempPathFactory) -> Path:
    """Compile the program once for all workers of a run: one that comes meanwhile waits for it."""
    own = factory.getbasetemp()
    return compiled_in(own.parent if "PYTEST_XDIST_WORKER" in os.environ else own)


def compiled_in(folder: Path) -> Path:
    """Compile the program into a folder, or return what an earlier call compiled there."""
    program = folder / "oracle"
    with program.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not program.exists():
            made = program.with_suffix(".made")
            # As Debian builds its packages: tf2_sensor_msgs is a header, and without -march without fused operations.
            words = ["g++", "-O2", "-I/usr/include/eigen3", "-o", str(made), str(SOURCE)]
            subprocess.run([*words, "-ltf2", "-llaser_geometry", "-lrostime"], check=True)
            made.rename(program)
    return program


def time_of(stamp_ns: int) -> str:
    return "{} {}".format(*divmod(stamp_ns, SECOND))


def hexadecimal(values: NDArray[np.float32]) -> str:
    return " ".join(float(value).hex() for value in values.ravel())


def transforms(rows: Rows) -> list[str]:
    return [
        f"T {parent or '-'} {child or '-'} {time_of(stamp_ns)} {' '.join(map(float.hex, pose))} {static:d}"
        for (parent, child, stamp_ns, *pose), static in rows
    ]


def ask(program: Path, rows: Rows, commands: list[str]) -> list[str]:
    lines = "\n".join(transforms(rows) + commands) + "\n"
    run = subprocess.run([str(program)], input=lines, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr[-1000:]
    answers = run.stdout.splitlines()
    assert len(answers) == len(commands)
    return answers


def through_command(question: Through) -> str:
    target, target_ns, source, source_ns, fixed = question
    return f"F {target} {time_of(target_ns)} {source} {time_of(source_ns)} {fixed}"


def pose_in(answer: str) -> list[float] | None:
    """The pose of an answer; None if tf2 refuses."""
    return None if answer.startswith("!") else [float.fromhex(value) for value in answer.split()[2:]]


def points_of_all_kinds(rng: np.random.Generator) -> NDArray[np.float32]:
    kinds = [
        rng.normal(scale=20, size=(3000, 3)),
        rng.integers(-9, 10, (1000, 3)),
        rng.normal(size=(500, 3)) * 10.0 ** rng.uniform(-45, 38, (500, 3)),
        rng.choice([0.0, -0.0, 1.0, -1.0, 1e-45, 3.4e38, np.inf, -np.inf, np.nan], (500, 3)),
    ]
    with np.errstate(over="ignore"):
        return np.concatenate(kinds).astype(np.float32)


def moved_by(program: Path, pose: tuple[float, ...], points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Points as tf2_sensor_msgs transforms them."""
    rows = [(row("base", "lidar", 0, pose), True)]
    (answer,) = ask(program, rows, [f"C base lidar 0 0 {hexadecimal(points)}"])
    return np.frombuffer(bytes.fromhex(answer), np.float32).reshape(-1, 3)


def random_scan(rng: np.random.Generator) -> LaserScan:
    count = int(rng.integers(2, 400))
    ranges = rng.uniform(0.0, 12.0, count)
    ranges[rng.random(count) < 0.1] = rng.choice([np.nan, np.inf, -1.0, 30.0])
    # Up to 0.2 s, forwards or backwards.
    time_increment = rng.choice([0.2, -0.2, 0.0], p=[0.6, 0.3, 0.1]) * rng.random() / count
    return LaserScan(
        sequence=int(rng.integers(1000)),
        stamp_ns=EPOCH + int(rng.integers(SECOND, 9 * SECOND)),
        frame_id="laser",
        angle_min=float(np.float32(rng.uniform(-3, 0))),
        angle_max=0.0,
        angle_increment=float(np.float32(rng.uniform(-0.02, 0.02))),
        time_increment=float(np.float32(time_increment)),
        scan_time=0.0,
        range_min=float(np.float32(0.1)),
        range_max=float(np.float32(11.5)),
        ranges=ranges.astype(np.float32),
    )


def scan_command(target: str, deskewed: bool, scan: LaserScan) -> str:
    numbers = (scan.angle_min, scan.angle_increment, scan.time_increment, scan.range_min, scan.range_max)
    head = f"S {target} {deskewed:d} {time_of(scan.stamp_ns)} {scan.sequence}"
    return f"{head} {' '.join(value.hex() for value in numbers)} {hexadecimal(scan.ranges)}"


def moving_laser(rng: np.random.Generator) -> Rows:
    """odom to base_link 50 times a second, tilting as it goes; the laser's mount as people type it."""
    rows: Rows = []
    steps = rng.normal(scale=0.05, size=(500, 6)).cumsum(axis=0)
    for number, (x, y, z, roll, pitch, yaw) in enumerate(steps.tolist()):
        pose = Rigid.from_rpy(roll, pitch, yaw, (x, y, z)).pose
        rows.append((row("odom", "base_link", EPOCH + number * SECOND // 50 + int(rng.integers(1000)), pose), False))
    mount = Rigid.from_rpy(0.03, -0.2, 1.0, (0.2, 0.1, 0.4)).pose
    return [*rows, (row("base_link", "laser", 0, tuple(round(value, 4) for value in mount)), True)]

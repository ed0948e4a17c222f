"""The table of docs/exactness.md: pc2scan beside ROS's own libraries, on a machine that has Debian's ROS packages.

    PYTHONPATH=src:tests python tests/parity/table.py --lookups 30000 --points 1000000

Without a difference, the exit status is 0.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import pc2scan
from parity import debian
from pc2scan.conversion.steps import ScanToCloud
from pc2scan.core.params import ProjectionParams
from pc2scan.core.project import Projector
from pc2scan.core.rigid import Rigid
from pc2scan.errors import TransformError
from pc2scan.messages.laserscan import encode_laserscan
from pc2scan.messages.pointcloud2 import decode_pointcloud2
from pc2scan.transforms.placing import Placer
from support import ROOT
from support.conversions import serialized_by
from transforms.through import assert_close, found, random_drive, random_throughs
from transforms.trees import SECOND, built, changing_tree, random_pose, random_questions, random_tree

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from transforms.through import Through
    from transforms.trees import Question, Rows


#: What tf2 says of a refusal, and what our message then says.
REFUSALS = {
    "contains a loop": "contains a loop",
    "does not exist": "no transform has the",
    "not part of the same tree": "no transforms connect",
    "extrapolation": "is not known at",
}


class Row(NamedTuple):
    """A line of the table: what was compared, with what, how many values, and how many of them differ."""

    what: str
    reference: str
    compared: int
    differing: int
    equal_means: str = "to the bit"


def rows(oracle: Path, *, lookups: int, points: int, seed: int) -> Iterator[Row]:
    """Compare everything; ``lookups`` and ``points`` are how many of each."""
    rng = np.random.default_rng(seed)
    yield from against_debian(oracle, rng, lookups=lookups, points=points)
    yield _golden()


def against_debian(oracle: Path, rng: np.random.Generator, *, lookups: int, points: int) -> Iterator[Row]:
    """Compare what the oracle answers, live."""
    yield _lookups(oracle, rng, lookups)
    yield _throughs(oracle, rng, lookups)
    yield _coordinates(oracle, rng, points)
    yield _way_back(oracle, rng, max(10, points // 1000))


def lookups(oracle: Path, rows: Rows, questions: list[Question]) -> tuple[int, int]:
    """Look up transforms; return how many are found, and how many differ, in a bit, in their stamps or in refusals."""
    buffer = built(rows)
    commands = [f"L {target} {source} {debian.time_of(stamp)}" for target, source, stamp in questions]
    known = differing = 0
    for (target, source, stamp_ns), theirs in zip(questions, debian.ask(oracle, rows, commands), strict=True):
        pose = debian.pose_in(theirs)
        try:
            ours = buffer.lookup(target, source, stamp_ns).pose
        except TransformError as err:
            told = next((ours for tf2s, ours in REFUSALS.items() if tf2s in theirs), "unknown")
            differing += pose is not None or told not in err.message
            continue
        known += 1
        stamp = [*divmod(stamp_ns or buffer.latest_common_ns(target, source), SECOND)]
        same_time = target == source or [*map(int, theirs.split()[:2])] == stamp
        differing += pose is None or np.array(ours).tobytes() != np.array(pose).tobytes() or not same_time
    return known, differing


def _lookups(oracle: Path, rng: np.random.Generator, count: int) -> Row:
    compared = differing = 0
    while compared < count:
        rows, frames = (random_tree if rng.random() < 0.5 else changing_tree)(rng)
        questions = random_questions(rng, frames, [entry[2] for entry, _ in rows], min(count, 3000))
        known, different = lookups(oracle, rows, questions)
        assert known > len(questions) // 15
        compared, differing = compared + len(questions), differing + different
    return Row("lookups of transforms, refusals too", "tf2", compared, differing)


def _throughs(oracle: Path, rng: np.random.Generator, count: int) -> Row:
    compared = differing = 0
    while compared < count:
        rows, frames = random_drive(rng)
        questions = random_throughs(rng, frames, min(count, 10_000))
        buffer = built(rows)
        answers = debian.ask(oracle, rows, [*map(debian.through_command, questions)])
        for question, theirs in zip(questions, answers, strict=True):
            pose = debian.pose_in(theirs)
            compared += 1
            try:
                ours = found(buffer, question)
            except TransformError:
                differing += pose is not None
            else:
                differing += pose is None or not _is_close(ours, np.array(pose), question)
    return Row("lookups with two times, through a fixed frame", "tf2", compared, differing, "to 1e-9 (m, quaternion)")


def _is_close(ours: Rigid, theirs: NDArray[np.float64], question: Through) -> bool:
    try:
        assert_close(ours, theirs, question)
    except AssertionError:
        return False
    return True


def columns(points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    return points[:, 0], points[:, 1], points[:, 2]


def _coordinates(oracle: Path, rng: np.random.Generator, count: int) -> Row:
    project = Projector(ProjectionParams(min_height=-50.0, max_height=50.0, angle_increment=1e-3))
    compared = differing = 0
    while compared < count:
        cloud, pose = debian.points_of_all_kinds(rng), random_pose(rng)
        rigid = Rigid(np.array(pose[3:]), np.array(pose[:3]))
        ours, theirs = rigid.apply(cloud), debian.moved_by(oracle, pose, cloud)
        # The loops over points transform what they project.
        here, there = project(*columns(cloud), rigid.as_float32()), project(*columns(theirs))
        differing += here.counts != there.counts or here.ranges.tobytes() != there.ranges.tobytes()
        # NaNs may have any sign and payload.
        same = (ours.view(np.uint32) == theirs.view(np.uint32)) | (np.isnan(ours) & np.isnan(theirs))
        compared += same.size
        differing += int(np.count_nonzero(~same))
    return Row("coordinates of transformed clouds", "tf2_sensor_msgs", compared, differing)


def _way_back(oracle: Path, rng: np.random.Generator, count: int) -> Row:
    rows = debian.moving_laser(rng)
    compared = differing = 0
    for target in ("laser", "base_link", "odom"):
        for deskewed in (False, True):
            conversion = ScanToCloud(None, Placer(target, "", built(rows), 0), deskewed=deskewed)
            convert = serialized_by(conversion, "/scan", "ros1", "ros1")
            scans = [debian.random_scan(rng) for _ in range(count // 6 + 1)]
            commands = [debian.scan_command(target, deskewed, scan) for scan in scans]
            for scan, theirs in zip(scans, debian.ask(oracle, rows, commands), strict=True):
                cloud = decode_pointcloud2(convert(encode_laserscan(scan, "ros1")).message, "ros1")
                compared += 1
                differing += bytes(cloud.data).hex() != "".join(theirs.split()[3:])
    return Row("clouds from scans, deskewed too", "laser_geometry", compared, differing)


def _golden() -> Row:
    reports = [pc2scan.golden(ROOT / "fixtures" / name) for name in ("golden", "golden_exact")]
    cases = [case for report in reports for case in report.cases]
    failed = sum(case.outcome != "passed" for case in cases)
    return Row("golden cases, recorded from the nodes", "pointcloud_to_laserscan, laser_geometry", len(cases), failed)


def text(rows: Iterator[Row]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield "| what | compared with | values | differing | equal means |"
    yield "|---|---|---:|---:|---|"
    for row in rows:
        share = f" ({row.differing / row.compared:.2g})" if row.differing else ""
        yield f"| {row.what} | {row.reference} | {row.compared:,} | {row.differing:,}{share} | {row.equal_means} |"


def main() -> int:
    """Print the table; the exit status is 1 if anything differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lookups", type=int, default=30_000)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    wanted = parser.parse_args()
    if why := debian.why_not():
        sys.stderr.write(f"{why}\n")
        return 2
    with tempfile.TemporaryDirectory() as folder:
        oracle = debian.compiled_in(Path(folder))
        compared = list(rows(oracle, lookups=wanted.lookups, points=wanted.points, seed=wanted.seed))
    print(*text(iter(compared)), sep="\n")  # noqa: T201
    return int(any(row.differing for row in compared))


if __name__ == "__main__":
    sys.exit(main())

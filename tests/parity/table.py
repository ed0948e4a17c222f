"""The table of docs/parity.md: pc2scan compared with ROS's own libraries, on a machine that has Debian's ROS packages.

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
from fuzz import angles
from parity import test_debian as debian
from pc2scan.core import fdlibm
from pc2scan.core.rigid import Rigid
from pc2scan.errors import TransformError
from pc2scan.messages.laserscan import encode_laserscan
from pc2scan.messages.pointcloud2 import decode_pointcloud2
from pc2scan.pipeline.scan_to_cloud import ScanToCloud
from pc2scan.tf.placing import Frames
from support import ROOT
from tf.through import assert_close, found, random_drive, random_throughs
from tf.trees import built, changing_tree, random_pose, random_questions, random_tree

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from tf.through import Through

__all__ = ["Row", "rows", "text"]


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
    yield _lookups(oracle, rng, lookups)
    yield _throughs(oracle, rng, lookups)
    yield _coordinates(oracle, rng, points)
    yield _way_back(oracle, rng, max(10, points // 1000))
    yield _golden()
    if not angles.why_not():
        yield _angles(rng, points)
        yield _libm(rng, points)


def _lookups(oracle: Path, rng: np.random.Generator, count: int) -> Row:
    compared = differing = 0
    while compared < count:
        rows, frames = (random_tree if rng.random() < 0.5 else changing_tree)(rng)
        questions = random_questions(rng, frames, [entry[2] for entry, _ in rows], 3000)
        buffer = built(rows)
        commands = [f"L {target} {source} {debian.time_of(stamp)}" for target, source, stamp in questions]
        for question, theirs in zip(questions, debian.ask(oracle, rows, commands), strict=True):
            try:
                ours: tuple[float, ...] | None = buffer.lookup(*question).pose
            except TransformError:
                ours = None
            pose = debian.pose_in(theirs)
            compared += 1
            if ours is None or pose is None:
                differing += (ours is None) != (pose is None)
            else:
                differing += np.array(ours).tobytes() != np.array(pose).tobytes()
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


def _coordinates(oracle: Path, rng: np.random.Generator, count: int) -> Row:
    compared = differing = 0
    while compared < count:
        cloud, pose = debian.points_of_all_kinds(rng), random_pose(rng)
        ours = Rigid(np.array(pose[3:]), np.array(pose[:3])).apply(cloud)
        theirs = debian.moved_by(oracle, pose, cloud)
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
            conversion = ScanToCloud(None, Frames(target, "", built(rows), 0), deskewed=deskewed)
            convert = conversion.for_topic("/scan", "ros1", "ros1")
            scans = [debian.random_scan(rng) for _ in range(count // 6 + 1)]
            commands = [debian.scan_command(target, deskewed, scan) for scan in scans]
            for scan, theirs in zip(scans, debian.ask(oracle, rows, commands), strict=True):
                cloud = decode_pointcloud2(convert(encode_laserscan(scan, "ros1")).data, "ros1")
                compared += 1
                differing += bytes(cloud.data).hex() != "".join(theirs.split()[3:])
    return Row("clouds from scans, deskewed too", "laser_geometry", compared, differing)


def _golden() -> Row:
    reports = [pc2scan.golden(ROOT / "fixtures" / name) for name in ("golden", "golden_exact")]
    cases = [case for report in reports for case in report.cases]
    failed = sum(case.outcome != "passed" for case in cases)
    return Row("golden cases, recorded from the nodes", "pointcloud_to_laserscan, laser_geometry", len(cases), failed)


def _angles(rng: np.random.Generator, count: int) -> Row:
    y, x = angles.points(rng, count)
    differing = len(angles.differing(y, x, angles.glibc_atan2f(y, x)))
    return Row("angles with `--angle-rounding glibc-2.40`", "this machine's glibc", len(x), differing)


def _libm(rng: np.random.Generator, count: int) -> Row:
    x, y = rng.normal(size=(2, count)).astype(np.float32)
    correct = np.arctan2(y.astype(np.float64), x.astype(np.float64)).astype(np.float32)
    differing = int(np.count_nonzero(correct != fdlibm.atan2f(y, x)))
    return Row("random points: correctly rounded angles", "glibc 2.31 to 2.40", count, differing, "expected: 16 %")


def text(rows: Iterator[Row]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield "| what | compared with | values | differing | equal means |"
    yield "|---|---|---:|---:|---|"
    for row in rows:
        share = f" ({row.differing / row.compared:.2g})" if row.differing else ""
        yield f"| {row.what} | {row.reference} | {row.compared:,} | {row.differing:,}{share} | {row.equal_means} |"


def main() -> int:
    """Print the table; the exit status is 1 if anything differs that should be equal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lookups", type=int, default=30_000)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    wanted = parser.parse_args()
    if why := debian.why_not():
        sys.stderr.write(f"{why}\n")
        return 2
    with tempfile.TemporaryDirectory() as folder:
        oracle = debian.compiled(Path(folder))
        compared = list(rows(oracle, lookups=wanted.lookups, points=wanted.points, seed=wanted.seed))
    print(*text(iter(compared)), sep="\n")  # noqa: T201
    return int(any(row.differing for row in compared if not row.equal_means.startswith("expected")))


if __name__ == "__main__":
    sys.exit(main())

"""Lookups with two times, through a frame that does not move: random ones, and recorded answers of tf2."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pc2scan.core.rigid import Rigid
from transforms.trees import EPOCH, SECOND, random_pose, row

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.transforms.buffer import TransformBuffer
    from transforms.trees import Rows

#: What tf2 answered; numbers as hexadecimal text, so that every bit survives.
RECORDED = Path(__file__).with_name("through.json")


def lookup_through(
    buffer: TransformBuffer, target: str, target_ns: int, source: str, source_ns: int, fixed: str, tolerance_ns: int = 0
) -> Rigid:
    """Return where ``source`` was at one time, as seen from ``target`` at another one, through ``fixed``.

    Source of the rule: ``BufferCore::lookupTransform`` with two times, which multiplies two lookups as matrices: the
    result's quaternion has unit length. Agrees to 1e-9.
    """
    moved = buffer.lookup(fixed, source, source_ns, tolerance_ns)
    seen = buffer.lookup(target, fixed, target_ns, tolerance_ns)
    return seen.product(moved)


class Through(NamedTuple):
    """A question: ``target`` at one time, ``source`` at another one, through ``fixed``."""

    target: str
    target_ns: int
    source: str
    source_ns: int
    fixed: str


def random_drive(rng: np.random.Generator, samples: int = 200) -> tuple[Rows, list[str]]:
    """A robot that drives and tilts in odom, which moves in map; sensors on it, one of them on an arm."""
    rows: Rows = []
    for parent, child, scale in (("map", "odom", 0.01), ("odom", "base_link", 0.3), ("base_link", "arm", 0.1)):
        steps = rng.normal(scale=scale, size=(samples, 6)).cumsum(axis=0)
        stamps = EPOCH + np.sort(rng.integers(0, 10 * SECOND, samples))
        for (x, y, z, roll, pitch, yaw), stamp_ns in zip(steps.tolist(), stamps.tolist(), strict=True):
            rows.append((row(parent, child, stamp_ns, Rigid.from_rpy(roll, pitch, yaw, (x, y, z)).pose), False))
    rows.append((row("base_link", "lidar", 0, random_pose(rng)), True))
    rows.append((row("arm", "camera", 0, random_pose(rng)), True))
    return rows, ["map", "odom", "base_link", "arm", "lidar", "camera"]


def random_throughs(rng: np.random.Generator, frames: list[str], count: int) -> list[Through]:
    """Questions at times within a second of each other, a few of them outside of what is known."""
    questions = []
    for _ in range(count):
        target, source = rng.choice(frames, 2).tolist()
        target_ns = EPOCH + int(rng.integers(-SECOND // 10, 10 * SECOND + SECOND // 10))
        source_ns = target_ns + int(rng.integers(-SECOND, SECOND))
        questions.append(Through(target, target_ns, source, source_ns, str(rng.choice(["odom", "map"]))))
    return questions


def found(buffer: TransformBuffer, question: Through) -> Rigid:
    """The answer of the buffer."""
    return lookup_through(buffer, *question)


def assert_close(ours: Rigid, theirs: NDArray[np.float64], question: Through) -> None:
    """Translation (m) and quaternion agree to 1e-9; a quaternion and its negative are one rotation."""
    quaternion = ours.quaternion * np.copysign(1.0, ours.quaternion @ theirs[3:])
    np.testing.assert_allclose(ours.translation, theirs[:3], rtol=0, atol=1e-9, err_msg=str(question))
    np.testing.assert_allclose(quaternion, theirs[3:], rtol=0, atol=1e-9, err_msg=str(question))


def recorded() -> tuple[Rows, list[Through], list[NDArray[np.float64] | None]]:
    """Read `RECORDED`: transforms, questions, and poses (None: tf2 refuses)."""
    content = json.loads(RECORDED.read_text())
    rows: Rows = [
        ((parent, child, stamp_ns, *map(float.fromhex, pose)), static)
        for parent, child, stamp_ns, *pose, static in content["transforms"]
    ]
    answers = [
        None if answer is None else np.array([float.fromhex(value) for value in answer])
        for answer in content["answers"]
    ]
    return rows, [Through(*question) for question in content["lookups"]], answers

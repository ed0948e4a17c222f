"""Random transforms, and questions about them, for tf2 and for the buffer."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from pc2scan.transforms.builder import TransformBuilder

if TYPE_CHECKING:
    from pc2scan.core.rigid import TransformRow
    from pc2scan.transforms.buffer import TransformBuffer

#: Target, source, stamp in nanoseconds.
Question: TypeAlias = tuple[str, str, int]

#: Transforms in the order of their arrival, and whether each is static.
Rows: TypeAlias = "list[tuple[TransformRow, bool]]"

SECOND = 1_000_000_000
EPOCH = 1_600_000_000 * SECOND


def built(rows: Rows) -> TransformBuffer:
    builder = TransformBuilder()
    for row, static in rows:
        builder.add([row], static=static)
    return builder.build()


def random_pose(rng: np.random.Generator) -> tuple[float, ...]:
    """Half of the rotations are of unit length, the others as people type them, or as far off as tf2 allows."""
    quaternion = rng.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    match rng.integers(4):
        case 0:
            quaternion = quaternion.round(int(rng.integers(3, 7)))
        case 1:
            quaternion *= rng.uniform(0.9951, 1.0049)
        case _:
            pass
    return (*(rng.normal(size=3) * 10).tolist(), *quaternion.tolist())


def row(parent: str, child: str, stamp_ns: int, pose: tuple[float, ...]) -> TransformRow:
    x, y, z, i, j, k, r = pose
    return (parent, child, stamp_ns, x, y, z, i, j, k, r)


def random_questions(rng: np.random.Generator, frames: list[str], stamps: list[int], count: int) -> list[Question]:
    """Stamps that samples have, stamps between, before and after, and 0."""
    first, last = min(stamps) - SECOND // 2, max(stamps) + SECOND // 2
    questions = []
    for _ in range(count):
        target, source = rng.choice(frames, 2).tolist()
        kind = rng.integers(8)
        stamp_ns = 0 if kind == 0 else int(rng.integers(first, last))
        if kind < 3 and kind:
            stamp_ns = stamps[int(rng.integers(len(stamps)))]
        questions.append((target, source, stamp_ns))
    return questions


def random_tree(rng: np.random.Generator) -> tuple[Rows, list[str]]:
    """Transforms of moving and fixed frames, in any order, in one tree or more; and the frames' names."""
    frames = [f"f{number}" for number in range(12)]
    rows: Rows = []
    for number in range(1, len(frames)):
        if rng.random() < 0.1:
            continue  # another tree begins
        parent, static = frames[int(rng.integers(number))], bool(rng.random() < 0.3)
        stamps = EPOCH + np.sort(rng.integers(0, 10 * SECOND, 1 if static else rng.integers(1, 40)))
        rows += [(row(parent, frames[number], stamp_ns, random_pose(rng)), static) for stamp_ns in stamps.tolist()]
    return [rows[index] for index in rng.permutation(len(rows))], frames


def changing_tree(rng: np.random.Generator) -> tuple[Rows, list[str]]:
    """Transforms of children that pick among the frames before them, again and again; no loops can arise."""
    frames = [f"f{number}" for number in range(7)]
    rows: Rows = []
    for number in range(1, len(frames)):
        stamps = EPOCH + rng.integers(0, 10, 15) * (SECOND // 2) + 1000 * number
        rows += [
            (row(frames[int(rng.integers(number))], frames[number], stamp_ns, random_pose(rng)), False)
            for stamp_ns in stamps.tolist()
        ]
    return [rows[index] for index in rng.permutation(len(rows))], frames

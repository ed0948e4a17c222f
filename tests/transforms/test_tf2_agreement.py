"""The buffer against tf2 itself: the same transforms, the same questions, the same answers and refusals, to the bit."""

from __future__ import annotations

import itertools
import json
import math
import subprocess
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest

from pc2scan.core.rigid import Rigid
from pc2scan.errors import TransformError
from transforms.trees import EPOCH, SECOND, built, changing_tree, random_pose, random_questions, random_tree, row

if TYPE_CHECKING:
    from collections.abc import Callable

    from transforms.trees import Question, Rows

    Answer = list[float] | list[str]

PYTHON = "/usr/bin/python3"
ORACLE = Path(__file__).with_name("tf2_oracle.py")

#: What tf2 calls a refusal, and what our message then says.
REFUSALS = {
    "LookupException": "no transform has the",
    "ConnectivityException": "no transforms connect",
    "ExtrapolationException": "is not known at",
}
HALF, TENTH = SECOND // 2, SECOND // 10


class Case(NamedTuple):
    """Transforms, questions, and how many answers of a kind there are at least, so that it is known what is covered."""

    rows: Rows
    questions: list[Question]
    least: dict[str, int]


def a_random_tree(seed: int) -> Case:
    rng = np.random.default_rng(seed)
    rows, frames = random_tree(rng)
    questions = random_questions(rng, [*frames, "nowhere"], [entry[0][2] for entry in rows], 2000)
    return Case(rows, questions, {"found": 51, "ExtrapolationException": 51, "LookupException": 51})


def children_that_change_parents(seed: int) -> Case:
    rng = np.random.default_rng(100 + seed)
    rows, frames = changing_tree(rng)
    return Case(rows, random_questions(rng, frames, [entry[0][2] for entry in rows], 2000), {"found": 501})


def poses(seed: int, links: list[tuple[str, str, int]], static: bool = False) -> Rows:
    """Transforms with any poses, of parents, children and stamps since `EPOCH`."""
    rng = np.random.default_rng(seed)
    return [(row(parent, child, EPOCH + stamp, random_pose(rng)), static) for parent, child, stamp in links]


def a_frame_on_both_topics(*order: bool) -> Case:
    links = [("a", "b", second * SECOND) for second in (4, 2, 6)]
    rows = [each for static in order for each in poses(11 + static, links, static)]
    return Case(rows, [("a", "b", EPOCH + half * HALF) for half in range(16)], {})


def equal_stamps_and_what_they_leave_behind() -> Case:
    """The repeated one brings a parent that nothing else mentions: known, but connected to nothing."""
    stamps = [("a", 1), ("a", 2), ("ghost", 2), ("a", 1), ("a", 3), ("a", 3)]
    rows = poses(12, [(parent, "child", second * SECOND) for parent, second in stamps])
    questions = [(t, "child", EPOCH + half * HALF) for half in range(8) for t in ("a", "ghost")]
    return Case(rows, questions, {"ConnectivityException": 3})


def transforms_that_are_ignored() -> Case:
    nan, good = float("nan"), (1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8)
    rows = [
        (row("a", "b", EPOCH, good), False),
        (row("/a", "/b", EPOCH + SECOND, good), False),
        (row("a", "b", EPOCH + SECOND // 2, (nan, *good[1:])), False),
        (row("a", "b", EPOCH + SECOND // 3, (*good[:6], nan)), False),
        (row("a", "b", EPOCH + SECOND // 4, (*good[:3], 0.0, 0.0, 0.0, 0.0)), False),
        (row("only_nan", "c", EPOCH, (nan, *good[1:])), True),
        *((row(*names, EPOCH, good), True) for names in (("s", "s"), ("/t", "t"), ("", "d"), ("e", ""), ("e", "/"))),
    ]
    frames = ["a", "b", "c", "d", "e", "s", "t", "only_nan"]
    questions = [(t, s, EPOCH + SECOND * n // 12) for t in frames for s in frames for n in range(13)]
    return Case(rows, questions, {"LookupException": 101})


def a_stamp_of_zero_is_the_latest_common_time() -> Case:
    rows = poses(13, [("map", "odom", tenth * TENTH) for tenth in range(0, 31, 5)])
    rows += poses(14, [("odom", "base", tenth * TENTH) for tenth in range(40)])
    rows += poses(15, [("base", "lidar", 0)], True)
    rows += poses(16, [("base", "late", 9 * SECOND), ("base", "unstamped", -EPOCH), ("base", "since_zero", -EPOCH)])
    rows += poses(17, [("base", "since_zero", 0)]) + poses(18, [("unstamped", "static", -EPOCH)], True)
    frames = ["map", "odom", "base", "lidar", "late", "unstamped", "since_zero", "static"]
    questions = [(target, source, 0) for target in frames for source in frames]
    return Case(rows, questions, {"ExtrapolationException": 1, "found": 21})


def rotations_of_any_length() -> Case:
    """Around both limits of the squared norm, and some far away."""
    rng = np.random.default_rng(16)
    rows: Rows = []
    for number in range(400):
        pose = np.array(random_pose(rng))
        pose[3:] /= np.linalg.norm(pose[3:])
        squared = rng.choice([0.99, 1.01]) + rng.choice([0.0, 1e-16, -1e-16, 1e-9, -1e-9, 0.1, -0.1])
        pose[3:] *= math.sqrt(squared)
        rows.append((row("a", f"b{number}", EPOCH, tuple(pose.tolist())), True))
    questions = [("a", f"b{number}", EPOCH) for number in range(400)]
    return Case(rows, questions, {"found": 101, "LookupException": 101})


def zeros_keep_their_signs() -> Case:
    """Which of them an identity turns around depends on where tf2's walks end."""
    rng = np.random.default_rng(17)
    frames = ["map", "odom", "base", "left", "right", "tip"]
    rows: Rows = []
    for number, (parent, child) in enumerate(itertools.pairwise(frames)):
        for second in range(3):
            i, j, k = rng.choice([0.0, -0.0], 3).tolist()
            pose = (*rng.choice([0.0, -0.0, 1.0], 3).tolist(), i, j, k, float(rng.choice([1.0, -1.0])))
            rows.append((row(parent, child, EPOCH + second * SECOND, pose), number % 2 == 1))
    return Case(
        rows, [(t, s, EPOCH + half * HALF) for t in frames for s in frames for half in range(6)], {"found": 101}
    )


def loops_for_a_while() -> Case:
    """Odometry in both directions, at stamps of their own, above two lidars."""
    rows = [
        *poses(19, [("odom", "body", number * SECOND) for number in range(5)], False),
        *poses(20, [("body", "odom", number * SECOND) for number in range(3, 9)], False),
        *poses(21, [("body", "front", 0), ("body", "rear", 0)], True),
    ]
    frames, stamps = ("odom", "body", "front", "rear"), [0, *(EPOCH + number * SECOND // 2 for number in range(-1, 18))]
    questions = [(one, other, stamp_ns) for one, other in itertools.permutations(frames, 2) for stamp_ns in stamps]
    return Case(rows, questions, {"LookupException": 10, "found": 80, "ExtrapolationException": 10})


#: All of them are one question to tf2.
CASES: dict[str, Callable[[], Case]] = {
    **{f"random tree {seed}": partial(a_random_tree, seed) for seed in range(2)},
    **{f"children that change parents {seed}": partial(children_that_change_parents, seed) for seed in range(2)},
    "a frame on both topics": partial(a_frame_on_both_topics, False, True),
    "a frame on both topics, static first": partial(a_frame_on_both_topics, True, False),
    **{
        case.__name__.replace("_", " "): case
        for case in (
            equal_stamps_and_what_they_leave_behind,
            transforms_that_are_ignored, a_stamp_of_zero_is_the_latest_common_time, rotations_of_any_length,
            zeros_keep_their_signs, loops_for_a_while,
        )
    },
}  # fmt: skip


@cache
def why_not() -> str:
    """Why tf2 cannot be asked; empty if it can."""
    if not Path(PYTHON).exists():
        return f"{PYTHON} is not here"
    probe = subprocess.run([PYTHON, "-c", "import tf2_py"], capture_output=True, text=True, check=False)
    return f"{PYTHON} cannot import tf2_py: apt-get install python3-tf2-ros" if probe.returncode else ""


def in_the_first_days(case: Case) -> Case:
    """The same, in the first days of the epoch.

    tf2_py hands stamps to tf2 as float seconds, which hold nanoseconds only for numbers that small. Any stamps but 0
    will do; tests/parity asks about those of today.
    """
    stamps = [entry[2] for entry, _ in case.rows] + [stamp_ns for _, _, stamp_ns in case.questions]
    shift_ns = min(stamp_ns for stamp_ns in stamps if stamp_ns) - 1000 * SECOND

    def moved(stamp_ns: int) -> int:
        return stamp_ns - shift_ns if stamp_ns else 0

    assert max(stamps) - shift_ns < 1_000_000 * SECOND
    return Case(
        [((*entry[:2], moved(entry[2]), *entry[3:]), static) for entry, static in case.rows],
        [(target, source, moved(stamp_ns)) for target, source, stamp_ns in case.questions],
        case.least,
    )


def ask_tf2(cases: list[Case]) -> list[list[Answer]]:
    asked = [
        {"transforms": [[*entry, static] for entry, static in case.rows], "lookups": case.questions} for case in cases
    ]
    run = subprocess.run([PYTHON, str(ORACLE)], input=json.dumps(asked), capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    answers: list[list[Answer]] = json.loads(run.stdout)
    return answers


@cache
def all_answered() -> dict[str, tuple[Case, list[Answer]]]:
    made = {name: in_the_first_days(case()) for name, case in CASES.items()}
    return dict(zip(made, zip(made.values(), ask_tf2([*made.values()]), strict=True), strict=True))


def assert_agreement(case: Case, answers: list[Answer]) -> None:
    """Poses are equal to the bit; what tf2 refuses is refused with the same reason."""
    buffer = built(case.rows)
    kinds: dict[str, int] = {}
    for question, theirs in zip(case.questions, answers, strict=True):
        try:
            ours: Rigid | str = buffer.lookup(*question)
        except TransformError as err:
            ours = err.message
        if isinstance(theirs[0], str):
            kind = theirs[0]
            told = "contains a loop" if "contains a loop" in str(theirs[1]) else REFUSALS[kind]
            assert isinstance(ours, str), (question, theirs)
            assert told in ours, (question, theirs, ours)
        else:
            kind = "found"
            assert isinstance(ours, Rigid), (question, theirs, ours)
            assert np.array(ours.pose).tobytes() == np.array(theirs).tobytes(), (question, theirs, ours.pose)
        kinds[kind] = kinds.get(kind, 0) + 1
    assert all(kinds.get(kind, 0) >= count for kind, count in case.least.items()), kinds


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_tf2_answers_alike(name: str) -> None:
    if why_not():
        pytest.skip(why_not())
    assert_agreement(*all_answered()[name])

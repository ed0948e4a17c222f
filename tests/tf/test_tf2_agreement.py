"""The buffer against tf2 itself: the same transforms, the same questions, the same answers and refusals."""

from __future__ import annotations

import itertools
import json
import math
import subprocess
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pc2scan.core.rigid import Rigid
from pc2scan.errors import TransformError
from pc2scan.messages.tfmessage import decode_transforms
from support import RECORDINGS, needs_shared
from tf.trees import EPOCH, SECOND, built, changing_tree, random_pose, random_questions, random_tree, row

if TYPE_CHECKING:
    from pc2scan.core.rigid import TransformRow
    from pc2scan.tf.buffer import TransformBuffer
    from tf.trees import Question

    Answer = list[float] | list[str]

PYTHON = "/usr/bin/python3"
ORACLE = Path(__file__).with_name("tf2_oracle.py")

#: What tf2 calls a refusal, and what our message then says.
REFUSALS = {
    "LookupException": "no transform has the",
    "ConnectivityException": "no transforms connect",
    "ExtrapolationException": "is not known at",
}


@cache
def why_not() -> str:
    """Why tf2 cannot be asked; empty if it can."""
    if not Path(PYTHON).exists():
        return f"{PYTHON} is not here"
    probe = subprocess.run([PYTHON, "-c", "import tf2_py"], capture_output=True, text=True, check=False)
    return f"{PYTHON} cannot import tf2_py: apt-get install python3-tf2-ros" if probe.returncode else ""


@pytest.fixture(autouse=True)
def _needs_tf2() -> None:
    if why_not():
        pytest.skip(why_not())


def in_the_first_days(
    rows: list[tuple[TransformRow, bool]], questions: list[Question]
) -> tuple[list[tuple[TransformRow, bool]], list[Question]]:
    """The same, in the first days of the epoch.

    tf2_py hands stamps to tf2 as float seconds, which hold nanoseconds only for numbers that small. Any stamps but 0
    will do; tests/parity asks about those of today.
    """
    stamps = [entry[2] for entry, _ in rows] + [stamp_ns for _, _, stamp_ns in questions]
    shift_ns = min(stamp_ns for stamp_ns in stamps if stamp_ns) - 1000 * SECOND

    def moved(stamp_ns: int) -> int:
        return stamp_ns - shift_ns if stamp_ns else 0

    assert max(stamps) - shift_ns < 1_000_000 * SECOND
    return (
        [((*entry[:2], moved(entry[2]), *entry[3:]), static) for entry, static in rows],
        [(target, source, moved(stamp_ns)) for target, source, stamp_ns in questions],
    )


def ask_tf2(rows: list[tuple[TransformRow, bool]], questions: list[Question]) -> list[Answer]:
    question = {"transforms": [[*entry, static] for entry, static in rows], "lookups": questions}
    run = subprocess.run([PYTHON, str(ORACLE)], input=json.dumps(question), capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    answers: list[Answer] = json.loads(run.stdout)
    return answers


def answer(buffer: TransformBuffer, question: Question) -> Rigid | str:
    try:
        return buffer.lookup(*question)
    except TransformError as err:
        return err.message


def assert_agreement(rows: list[tuple[TransformRow, bool]], questions: list[Question]) -> dict[str, int]:
    """Compare all answers to the bit; return how many there were of each kind, so that callers see what was covered."""
    rows, questions = in_the_first_days(rows, questions)
    buffer = built(rows)
    kinds: dict[str, int] = {}
    for question, theirs in zip(questions, ask_tf2(rows, questions), strict=True):
        ours = answer(buffer, question)
        kind = theirs[0] if isinstance(theirs[0], str) else "found"
        kinds[kind] = kinds.get(kind, 0) + 1
        if isinstance(theirs[0], str):
            assert isinstance(ours, str), (question, theirs)
            assert REFUSALS[theirs[0]] in ours, (question, theirs, ours)
        else:
            assert isinstance(ours, Rigid), (question, theirs, ours)
            assert np.array(ours.pose).tobytes() == np.array(theirs).tobytes(), (question, theirs, ours.pose)
    return kinds


@pytest.mark.parametrize("seed", range(6))
def test_random_trees(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, frames = random_tree(rng)
    stamps_ns = [entry[0][2] for entry in rows]
    kinds = assert_agreement(rows, random_questions(rng, [*frames, "nowhere"], stamps_ns, 2000))
    assert kinds["found"] > 50
    assert kinds["ExtrapolationException"] > 50
    assert kinds["LookupException"] > 50


@pytest.mark.parametrize("seed", range(6))
def test_children_that_change_parents(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    rows, frames = changing_tree(rng)
    kinds = assert_agreement(rows, random_questions(rng, frames, [entry[0][2] for entry in rows], 2000))
    assert kinds["found"] > 500


def test_two_trees_that_exchange_a_child() -> None:
    rng = np.random.default_rng(9)
    rows = [
        (row(parent, child, EPOCH + second * SECOND, random_pose(rng)), False)
        for second in range(10)
        for parent, child in [("a", "carrier"), ("b", "other"), ("ab"[second // 5], "load")]
    ]
    questions = [
        (target, source, EPOCH + tenth * SECOND // 10)
        for tenth in range(-5, 100)
        for target in ("a", "b", "carrier", "other")
        for source in ("load", "a")
    ]
    kinds = assert_agreement(rows, questions)
    assert kinds["ConnectivityException"] > 50
    assert kinds["found"] > 50


def test_the_root_that_changes_sides() -> None:
    # a in b for a while, then b in a: a loop on paper, at no time in fact.
    rng = np.random.default_rng(10)
    rows = [
        (row(*(("b", "a") if second < 5 else ("a", "b")), EPOCH + second * SECOND, random_pose(rng)), False)
        for second in range(10)
    ]
    questions = [(*pair, EPOCH + tenth * SECOND // 10) for tenth in range(-5, 100) for pair in (("a", "b"), ("b", "a"))]
    kinds = assert_agreement(rows, questions)
    assert kinds["found"] > 100
    assert kinds["ExtrapolationException"] > 30


@pytest.mark.parametrize("order", [(False, True), (True, False)])
def test_a_frame_on_both_topics(order: tuple[bool, bool]) -> None:
    rng = np.random.default_rng(11)
    rows = [
        (row("a", "b", EPOCH + second * SECOND, random_pose(rng)), static) for static in order for second in (4, 2, 6)
    ]
    assert_agreement(rows, [("a", "b", EPOCH + half * SECOND // 2) for half in range(16)])


def test_equal_stamps_and_what_they_leave_behind() -> None:
    rng = np.random.default_rng(12)
    # The repeated one brings a parent that nothing else mentions: known, but connected to nothing.
    rows = [
        (row(parent, "child", EPOCH + second * SECOND, random_pose(rng)), False)
        for parent, second in [("a", 1), ("a", 2), ("ghost", 2), ("a", 1), ("a", 3), ("a", 3)]
    ]
    questions = [(t, "child", EPOCH + half * SECOND // 2) for half in range(8) for t in ("a", "ghost")]
    assert assert_agreement(rows, questions)["ConnectivityException"] > 2


def test_transforms_that_are_ignored() -> None:
    nan, good = float("nan"), (1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8)
    rows = [
        (row("a", "b", EPOCH, good), False),
        (row("/a", "/b", EPOCH + SECOND, good), False),
        (row("a", "b", EPOCH + SECOND // 2, (nan, *good[1:])), False),
        (row("a", "b", EPOCH + SECOND // 3, (*good[:6], nan)), False),
        (row("a", "b", EPOCH + SECOND // 4, (*good[:3], 0.0, 0.0, 0.0, 0.0)), False),
        (row("only_nan", "c", EPOCH, (nan, *good[1:])), True),
        (row("s", "s", EPOCH, good), True),
        (row("/t", "t", EPOCH, good), True),
        (row("", "d", EPOCH, good), True),
        (row("e", "", EPOCH, good), True),
        (row("e", "/", EPOCH, good), True),
    ]
    frames = ["a", "b", "c", "d", "e", "s", "t", "only_nan"]
    stamps = [EPOCH + SECOND * n // 12 for n in range(13)]
    questions = [(t, s, n) for t in frames for s in frames for n in stamps]
    assert assert_agreement(rows, questions)["LookupException"] > 100


def test_a_stamp_of_zero_is_the_latest_common_time() -> None:
    rng = np.random.default_rng(13)
    rows = [(row("map", "odom", EPOCH + tenth * SECOND // 10, random_pose(rng)), False) for tenth in range(0, 31, 5)]
    rows += [(row("odom", "base", EPOCH + tenth * SECOND // 10, random_pose(rng)), False) for tenth in range(40)]
    rows += [
        (row("base", "lidar", EPOCH, random_pose(rng)), True),
        (row("base", "late", EPOCH + 9 * SECOND, random_pose(rng)), False),
        (row("base", "unstamped", 0, random_pose(rng)), False),
        (row("base", "since_zero", 0, random_pose(rng)), False),
        (row("base", "since_zero", EPOCH, random_pose(rng)), False),
        (row("unstamped", "static", 0, random_pose(rng)), True),
    ]
    frames = ["map", "odom", "base", "lidar", "late", "unstamped", "since_zero", "static"]
    kinds = assert_agreement(rows, [(target, source, 0) for target in frames for source in frames])
    assert kinds["ExtrapolationException"] > 0
    assert kinds["found"] > 20


def test_rotations_of_any_length_are_taken_or_refused_alike() -> None:
    rng = np.random.default_rng(16)
    rows: list[tuple[TransformRow, bool]] = []
    for number in range(400):
        pose = np.array(random_pose(rng))
        pose[3:] /= np.linalg.norm(pose[3:])
        # Around both limits of the squared norm, and some far away.
        squared = rng.choice([0.99, 1.01]) + rng.choice([0.0, 1e-16, -1e-16, 1e-9, -1e-9, 0.1, -0.1])
        pose[3:] *= math.sqrt(squared)
        rows.append((row("a", f"b{number}", EPOCH, tuple(pose.tolist())), True))
    kinds = assert_agreement(rows, [("a", f"b{number}", EPOCH) for number in range(400)])
    assert kinds["found"] > 100
    assert kinds["LookupException"] > 100


def test_zeros_keep_their_signs() -> None:
    # Which of them an identity turns around depends on where tf2's walks end.
    rng = np.random.default_rng(17)
    zeros = [0.0, -0.0]
    frames = ["map", "odom", "base", "left", "right", "tip"]
    rows = []
    for number, (parent, child) in enumerate(itertools.pairwise(frames)):
        for second in range(3):
            i, j, k = rng.choice(zeros, 3).tolist()
            pose = (*rng.choice([*zeros, 1.0], 3).tolist(), i, j, k, float(rng.choice([1.0, -1.0])))
            rows.append((row(parent, child, EPOCH + second * SECOND, pose), number % 2 == 1))
    questions = [(t, s, EPOCH + half * SECOND // 2) for t in frames for s in frames for half in range(6)]
    assert assert_agreement(rows, questions)["found"] > 100


def test_nearly_equal_rotations_take_tf2s_branch() -> None:
    rng = np.random.default_rng(14)
    rows: list[tuple[TransformRow, bool]] = []
    questions: list[Question] = []
    for number, step in enumerate(np.logspace(-9, -7, 200).tolist()):
        pose = np.array(random_pose(rng))
        moved = pose.copy()
        moved[3:] += rng.normal(size=4) * step
        moved[3:] /= np.linalg.norm(moved[3:])
        rows += [
            (row("a", f"b{number}", EPOCH, tuple(pose.tolist())), False),
            (row("a", f"b{number}", EPOCH + SECOND, tuple(moved.tolist())), False),
        ]
        questions.append(("a", f"b{number}", EPOCH + int(rng.integers(SECOND))))
    assert_agreement(rows, questions)


def test_loops_are_refused_as_tf2_does_where_neither_frame_is_above_the_other() -> None:
    pose = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    edges = [("a", "b"), ("b", "c"), ("c", "a"), ("b", "left"), ("c", "right")]
    rows = [(row(parent, child, EPOCH, pose), True) for parent, child in edges]
    questions = [("left", "right", EPOCH), ("right", "left", EPOCH), ("left", "right", 0)]
    buffer = built(rows)
    for question, theirs in zip(questions, ask_tf2(rows, questions), strict=True):
        assert theirs[0] == "LookupException"
        assert "contains a loop" in str(theirs[1])
        assert "contains a loop" in str(answer(buffer, question))


@needs_shared
@pytest.mark.parametrize("name", ["jarvis_two_lasers.bag", "guardian_pallet.bag"])
def test_real_recordings(name: str) -> None:
    from rosbags.rosbag1 import Reader

    rows: list[tuple[TransformRow, bool]] = []
    log_times = []
    with Reader(RECORDINGS / name) as reader:
        connections = [entry for entry in reader.connections if entry.topic in {"/tf", "/tf_static"}]
        for connection, log_time_ns, data in reader.messages(connections):
            static = connection.topic == "/tf_static"
            rows += [(entry, static) for entry in decode_transforms(data, "ros1")]
            log_times.append(log_time_ns)
    assert len(rows) > 8000
    rng = np.random.default_rng(15)
    frames = sorted({frame for entry, _ in rows for frame in entry[:2]})
    stamps = [entry[2] for entry, _ in rows] + log_times[::10]
    kinds = assert_agreement(rows, random_questions(rng, frames, stamps, 5000))
    assert kinds["found"] > 1000
    assert kinds["ExtrapolationException"] > 50

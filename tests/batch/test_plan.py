"""The plan: what is done with each recording and why, decided without touching a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pc2scan.batch.find import Found
from pc2scan.batch.identity import Identity
from pc2scan.batch.manifest import Record
from pc2scan.batch.plan import Choice, History, Plan, Step, destinations, make_plan
from pc2scan.batch.request import request_of
from pc2scan.errors import DestinationError, RecordingError
from pc2scan.files.records import Left

OUT = Path("/out")
IDENTITY = Identity((("a.bag", 100, 7),))
WRITTEN = Identity((("a_scan.bag", 50, 9),))
CHOICE = Choice(request_of({}), "digest")
FOUND = Found("r/a.bag", (Path("/in/r/a.bag"),), "rosbag1", IDENTITY)
RECORD = Record(
    key="r/a.bag",
    sources=("/in/r/a.bag",),
    identity=IDENTITY,
    container="rosbag1",
    options="digest",
    outcome="converted",
    exit_status=0,
    output="r/a_scan.bag",
    output_identity=WRITTEN,
    sha256="abc",
)


def planned(
    found: Found = FOUND,
    record: Record | None = RECORD,
    *,
    choice: Choice = CHOICE,
    there: Identity = WRITTEN,
    begun: tuple[str, ...] = (),
    **options: Any,
) -> Step:
    records = {} if record is None else {record.key: record}
    plan = make_plan(
        [found],
        {found.key: choice},
        History.read(records.values(), frozenset(begun)),
        out=OUT,
        present=lambda _: there,
        **options,
    )
    (step,) = plan.steps
    return step


def test_what_is_unchanged_is_kept() -> None:
    step = planned()
    assert (step.action, step.why, step.output) == ("keep", "unchanged", "r/a_scan.bag")
    # Wherever it is now: copied elsewhere with its times, it is the same.
    assert planned(replace(FOUND, paths=(Path("/elsewhere/r/a.bag"),))).action == "keep"


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"record": None, "there": Identity()}, "new"),
        ({"record": None, "there": Identity(), "begun": ("r/a_scan.bag",)}, "interrupted before"),
        ({"record": replace(RECORD, version="0.0.1")}, "converted by pc2scan 0.0.1"),
        ({"choice": Choice(request_of({}), "other")}, "other options"),
        ({"there": Identity()}, "its output is missing"),
        (
            {"there": Identity((("a_scan.bag", 51, 9),))},
            "its output was changed: it has 51 B, it was written with 50 B",
        ),
        (
            {"there": Identity((("a_scan.bag", 50, 8),))},
            "its output was changed: it has 50 B, it was written with 50 B",
        ),
        ({"record": replace(RECORD, output="a_scan.mcap"), "there": Identity()}, "written to a_scan.mcap before"),
        ({"force": True}, "forced"),
        (
            {"record": replace(RECORD, outcome="failed", output_identity=Identity(), error={"message": "is cut"})}
            | {"there": Identity()},
            "failed before: is cut",
        ),
        (
            {"found": replace(FOUND, identity=Identity((("a.bag", 101, 7),)))},
            "the source was changed: it has 101 B, it had 100 B",
        ),
        (
            {"found": replace(FOUND, identity=Identity((("a.bag", 100, 8),)))},
            "the source was changed: another time of modification",
        ),
    ],
)
def test_why_something_is_converted(changes: dict[str, Any], why: str) -> None:
    step = planned(**changes)
    assert (step.action, step.why) == ("convert", why)


def test_checksums_decide_instead_of_times() -> None:
    touched = replace(FOUND, identity=Identity((("a.bag", 100, 8),)))
    assert planned(touched, checksum=lambda _: "abc").action == "keep"
    assert planned(touched, checksum=lambda _: "other").why == "the source was changed: another checksum"
    # Not only where the time differs: that may have been set back.
    assert planned(checksum=lambda _: "other").action == "convert"
    # Without a checksum in the manifest, times decide.
    assert planned(touched, replace(RECORD, sha256=None), checksum=lambda _: "abc").action == "convert"


def test_only_the_batchs_own_is_replaced() -> None:
    foreign = planned(record=None, there=WRITTEN)
    assert (foreign.action, foreign.owned) == ("refuse", None)
    assert "was not written by this batch" in str(foreign.error)
    asked = planned(record=None, there=WRITTEN, choice=Choice(request_of({"overwrite": True}), "digest"))
    assert asked.action == "convert"
    begun = planned(record=None, there=WRITTEN, begun=("r/a_scan.bag",))
    assert begun.action == "convert"
    assert begun.owned is not None
    assert begun.owned.files == {"a_scan.bag": None}
    changed = planned(there=Identity((("a_scan.bag", 51, 9),)))
    assert changed.owned is not None
    assert changed.owned.files == {"a_scan.bag": Left(50, 9)}
    # Where it was written before is not where it is written now.
    elsewhere = planned(record=replace(RECORD, output="b_scan.bag"), there=WRITTEN)
    assert elsewhere.action == "refuse"
    # Unless an earlier line names it, and it is as it was left.
    later = replace(RECORD, output="b_scan.bag")
    for there, action in ((WRITTEN, "convert"), (Identity((("a_scan.bag", 51, 9),)), "refuse")):
        history = History.read([RECORD, later], frozenset())
        plan = make_plan([FOUND], {FOUND.key: CHOICE}, history, out=OUT, present=_only("r/a_scan.bag", there))
        assert [step.action for step in plan.steps] == [action]
    error = DestinationError("is a source")
    read = planned(record=None, there=Identity(), forbidden=lambda output: error if output == "r/a_scan.bag" else None)
    assert (read.action, read.error) == ("refuse", error)
    # What is kept is not written.
    assert planned(forbidden=lambda _: error).action == "keep"


def test_a_conversion_that_failed_owns_nothing() -> None:
    failed = replace(RECORD, outcome="failed", output_identity=Identity(), error={"message": "is cut"})
    assert planned(record=failed).action == "refuse"
    # A process that died may have written its output.
    assert planned(record=replace(failed, outcome="died")).action == "convert"


def test_an_earlier_line_says_how_a_result_was_left() -> None:
    failed = replace(RECORD, outcome="failed", output_identity=Identity(), error={"message": "is cut"})
    history = History.read([RECORD, failed], frozenset())
    record = history.record("r/a_scan.bag")
    assert record is not None
    assert record.files == {"a_scan.bag": Left(50, 9)}


def test_what_is_no_recording_is_refused_and_what_is_not_wanted_is_skipped() -> None:
    error = RecordingError("is empty")
    step = planned(replace(FOUND, container="", error=error), record=None)
    assert (step.action, step.error, step.output) == ("refuse", error, "")
    assert planned(choice=Choice(None)).action == "skip"


def found_as(key: str, container: str = "rosbag1") -> Found:
    return Found(key, (Path("/in") / key,), container, IDENTITY)


def outputs_of(*found: Found, **words: Any) -> dict[str, str]:
    choice = Choice(request_of(words))
    return destinations(found, {each.key: choice for each in found})


def test_names_of_results() -> None:
    mcap, folder = found_as("a.mcap", "mcap"), found_as("a", "rosbag2")
    assert outputs_of(found_as("x/a.bag"), found_as("a.db3", "sqlite3"), found_as("b.mcap.zst", "mcap")) == {
        "x/a.bag": "x/a_scan.bag",
        "a.db3": "a_scan",
        "b.mcap.zst": "b_scan.mcap",
    }
    assert outputs_of(found_as("a.bag"), mcap) == {"a.bag": "a_scan.bag", "a.mcap": "a_scan.mcap"}
    together = outputs_of(found_as("a.bag"), mcap, folder, found_as("b.bag"), to="mcap")
    assert together == {
        "a.bag": "a_bag_scan.mcap",
        "a.mcap": "a_mcap_scan.mcap",
        "a": "a_folder_scan.mcap",
        "b.bag": "b_scan.mcap",
    }


def test_results_share_no_folder() -> None:
    nested = [found_as("drive.bag"), found_as("drive/x.bag"), found_as("other.bag")]
    assert outputs_of(*nested, export="npz") == {
        "drive.bag": "drive_bag",
        "drive/x.bag": "drive/x",
        "other.bag": "other",
    }
    # Recordings do not meet there: their names end with _scan.
    assert outputs_of(*nested)["drive.bag"] == "drive_scan.bag"
    meeting = [found_as("a.bag"), found_as("a_scan/b.bag"), found_as("A_SCAN/c/d.bag")]
    assert outputs_of(*meeting, to="rosbag2") == {
        "a.bag": "a_bag_scan",
        "a_scan/b.bag": "a_scan/b_scan",
        "A_SCAN/c/d.bag": "A_SCAN/c/d_scan",
    }


def test_results_that_share_a_folder_all_the_same_are_refused() -> None:
    found = [found_as("a.bag"), found_as("a/x.bag"), found_as("a_bag/y.bag")]
    choice = Choice(request_of({"export": "npz"}), "digest")
    plan = make_plan(
        found,
        {each.key: choice for each in found},
        History.read([], frozenset()),
        out=OUT,
        present=lambda _: Identity(),
    )
    assert [(step.action, step.output) for step in plan.steps] == [
        ("convert", "a_bag"),
        ("convert", "a/x"),
        ("refuse", "a_bag/y"),
    ]
    assert "would be in a_bag, the result of a.bag" in str(plan.steps[2].error)


def test_names_that_meet_all_the_same_are_refused() -> None:
    both = [found_as("A.bag"), found_as("a.bag")]
    choices = {each.key: CHOICE for each in both}
    plan: Plan = make_plan(both, choices, History.read([], frozenset()), out=OUT, present=lambda _: Identity())
    assert [step.action for step in plan.steps] == ["refuse", "refuse"]
    assert "would be the output of both A.bag and a.bag" in str(plan.steps[0].error)


def test_a_result_that_is_not_written_any_more_is_named() -> None:
    record = replace(RECORD, output="r/a_scan.mcap")
    plan = make_plan(
        [FOUND], {FOUND.key: CHOICE}, History.read([record], frozenset()), out=OUT, present=_only("r/a_scan.mcap")
    )
    (warning,) = plan.warnings
    assert warning.startswith("r/a_scan.mcap is out of date: its recording is written to r/a_scan.bag now;")


def _only(output: str, there: Identity = WRITTEN) -> Any:
    return lambda asked: there if asked == output else Identity()

"""``pc2scan diff --explain``: how many differing beams another libm explains, as the whole command says it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

import pc2scan
from support import ROOT, sampled
from support.command import run

if TYPE_CHECKING:
    from pathlib import Path

EXACT = ROOT / "fixtures" / "golden_exact"
OLD, NEW = "expected_old_libm.bag", "expected.bag"


def explained(*arguments: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """A topic, and what is explained of it."""
    done = run("diff", *arguments, "--json")
    assert (done.status, done.stderr) == (1, "")
    (topic,) = json.loads(done.stdout)["topics"]
    return topic, topic["libm"]


def differing(topic: dict[str, Any]) -> int:
    (values,) = topic["values"]
    return int(values["changed"] + values["shifted"])


@pytest.mark.parametrize("case", ["aligned_columns", "hundredths_of_degrees"])
@pytest.mark.parametrize(("a", "b", "glibc"), [(OLD, NEW, "a"), (NEW, OLD, "b")])
def test_what_the_node_returned_on_two_libms(case: str, a: str, b: str, glibc: str) -> None:
    folder = EXACT / case
    topic, libm = explained(folder / a, folder / b, "--clouds", folder / "input.bag")
    found = libm["clouds"]
    assert found["beams"] == found["explained"] == differing(topic) > 10
    assert (found["glibc"], found["topics"], found["scans"]) == (glibc, ["/points"], 1)
    new = "ab".replace(glibc, "")
    assert found[glibc]["fit_glibc"] == found[glibc]["returns"] > found[glibc]["fit_correct"]
    assert found[new]["fit_correct"] == found[new]["returns"] > found[new]["fit_glibc"]
    assert libm["scans_alone"]["scans"] == libm["beams_not_judged"] == 0
    assert libm["reasons"] == {}
    # Without the clouds it is a bound.
    _, libm = explained(folder / a, folder / b, "--explain")
    alone = libm["scans_alone"]
    assert alone["in_neighbour"] + alone["hidden"] == alone["beams"] == differing(topic)
    assert libm["clouds"]["scans"] == libm["clouds"]["explained"] == 0


@pytest.mark.parametrize("case", sampled(["tf_dynamic", "tf_static"], 1))
def test_clouds_are_moved_by_the_transforms_of_their_recording(case: str, tmp_path: Path) -> None:
    """Both scans and the clouds in one recording's folder: the clouds are found in A."""
    source = ROOT / "fixtures" / "golden" / case / "input.bag"
    asked: dict[str, Any] = {"target_frame": "base_link", "angle_increment": 5e-6}
    made = {rounding: tmp_path / f"{rounding}.bag" for rounding in ("correct", "glibc-2.40")}
    for rounding, path in made.items():
        pc2scan.convert(source, path, **asked, angle_rounding=rounding, min_height=-9.0, keep_clouds=True)
    topic, libm = explained(made["correct"], made["glibc-2.40"], "--topic", "/scan", "--explain")
    assert libm["clouds"]["explained"] == differing(topic) > 50
    assert libm["clouds"]["glibc"] == "b"
    # Another band of heights is not explained, and leaves what is so.
    lower = tmp_path / "lower.bag"
    pc2scan.convert(source, lower, **asked, min_height=-0.5)
    found = pc2scan.diff(made["glibc-2.40"], lower, topics=["/scan"], clouds=source).topics[0]
    assert found.libm is not None
    assert 0 < found.libm.explained < 0.05 * found.libm.beams
    same = pc2scan.diff(made["correct"], lower, topics=["/scan"], explain=True).topics[0]
    assert same.libm is not None
    assert (same.libm.explained, same.libm.glibc) == (0, "")
    assert same.libm.beams > 1000

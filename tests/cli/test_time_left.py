"""How long a run still takes."""

from __future__ import annotations

import pytest

from pc2scan.cli.time_left import TimeLeft, shown

TOTAL = 6_000


@pytest.mark.parametrize("start", [0.0, 5.0])
@pytest.mark.parametrize("step", [1, 300])
def test_the_end_of_steady_work_is_known_after_a_tenth(start: float, step: int) -> None:
    left, end = TimeLeft(), start + 100.0
    assert left.seconds(0, TOTAL, 0.0) is None
    for done in range(step, TOTAL + 1, step):
        now = start + 100.0 * done / TOTAL
        told = left.seconds(done, TOTAL, now)
        assert told is not None
        # Before, a start of 5 s is most of it.
        if done >= (0.1 if not start else 0.2) * TOTAL:
            assert now + told == pytest.approx(end, rel=0.1)
    assert told == 0


def test_a_slow_start_is_forgotten() -> None:
    left = TimeLeft()
    left.seconds(0, 100, 0.0)
    # Half of the time for the first tenth: a disk that had to wake up.
    times = {done: 5.0 * min(done, 10) + 50 / 90 * max(0, done - 10) for done in range(1, 101)}
    told = {done: now + (left.seconds(done, 100, now) or 0) for done, now in times.items()}
    assert told[10] == pytest.approx(500)
    assert told[25] == pytest.approx(100, rel=0.1)
    assert told[90] == pytest.approx(100)


@pytest.mark.parametrize(("total", "expected"), [(200, 160), (50, 10), (40, 0)])
def test_other_work_than_was_expected(total: int, expected: float) -> None:
    left = TimeLeft()
    for done in (0, 20, 40):
        left.seconds(done, 100, float(done))
    assert left.seconds(40, total, 40.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(None, "-:--:-- left"), (0.4, "0:00:00 left"), (61.6, "0:01:02 left"), (7_325, "2:02:05 left")],
)
def test_how_it_is_shown(seconds: float | None, text: str) -> None:
    assert shown(seconds) == text

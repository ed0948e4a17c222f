"""How long a run still takes, by the work that is done so far."""

from __future__ import annotations

from collections import deque

#: How many marks are kept at most, while the total stays the same.
_MARKS = 200


class TimeLeft:
    """Predicts when a run ends, from the time that the second half of what is done took.

    So what the start took is soon forgotten, and a few slow messages change little.
    """

    def __init__(self) -> None:
        #: Work and times, seconds; the first is the last one with no more than half of what is done.
        self._marks: deque[tuple[int, float]] = deque()

    def seconds(self, done: int, total: int, now: float) -> float | None:
        """Return how many seconds are left; None if that is unknown yet.

        Parameters
        ----------
        done, total
            The work that is done, and all work; it may turn out to be more or less than before.
        now
            The time, seconds.
        """
        marks = self._marks
        if not marks or done >= marks[-1][0] + total / _MARKS:
            marks.append((done, now))
        while len(marks) > 1 and marks[1][0] <= done / 2:
            marks.popleft()
        begin, began = marks[0]
        return (total - done) * (now - began) / (done - begin) if done > begin else None


def shown(seconds: float | None) -> str:
    """Return a number of seconds as hours, minutes and seconds; dashes if it is unknown."""
    if seconds is None:
        return "-:--:-- left"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02} left"

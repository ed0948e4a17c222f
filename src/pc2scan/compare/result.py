"""The differences between two recordings: text, JSON and the exit status are made from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pc2scan.text import Shown, Table, counted

from .summary import summary

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .topic_difference import TopicDifference


@dataclass(slots=True, repr=False)
class Difference(Shown):
    """The differences between two recordings.

    Attributes
    ----------
    a, b
        Their paths.
    topics
        The compared topics.
    left_aside
        Topics that were not compared, because they are neither scans nor clouds.
    """

    a: str
    b: str
    topics: list[TopicDifference] = field(default_factory=list)
    left_aside: int = 0

    @property
    def same(self) -> bool:
        """Whether there are no differences except allowed ones."""
        return all(topic.same for topic in self.topics)

    @property
    def exit_status(self) -> int:
        """0 same, 1 different."""
        return 0 if self.same else 1

    def as_dict(self) -> dict[str, Any]:
        """Return JSON's types; infinities and NaNs are text."""
        return {
            "same": self.same,
            "exit_status": self.exit_status,
            "a": self.a,
            "b": self.b,
            "topics": [topic.as_dict() for topic in self.topics],
            "left_aside": self.left_aside,
        }

    def text(self, names: tuple[str, str] = ("A", "B")) -> str:
        """Summarize the differences in a few lines; ``names`` are the names of the two sides."""
        return "\n".join(summary(self.topics, self.left_aside, names))

    def __repr__(self) -> str:
        apart = sum(not topic.same for topic in self.topics)
        topics = counted(len(self.topics), "topic")
        found = f"{apart} of {topics} different" if apart else f"{topics} equal"
        return f"<Difference of {self.a!r} and {self.b!r}: {found}>"

    def _shown(self) -> Iterator[str | Table]:
        yield from summary(self.topics, self.left_aside)

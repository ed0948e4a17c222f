"""The differences between two recordings: text, JSON and the exit status are made from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from pc2scan.result import Part, Result
from pc2scan.text import counted

from .summary import summary

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .topic_difference import TopicDifference


@dataclass(slots=True, repr=False)
class Difference(Result):
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

    kind: ClassVar[str] = "difference"
    json_names: ClassVar[tuple[str, ...]] = ("same", "a", "b", "topics", "left_aside")

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

    def text(self, names: tuple[str, str] = ("A", "B")) -> str:
        """Summarize the differences in a few lines; ``names`` are the names of the two sides."""
        return "\n".join(summary(self.topics, self.left_aside, names))

    def __repr__(self) -> str:
        apart = sum(not topic.same for topic in self.topics)
        topics = counted(len(self.topics), "topic")
        found = f"{apart} of {topics} different" if apart else f"{topics} equal"
        return f"<Difference of {self.a!r} and {self.b!r}: {found}>"

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the differences of each topic, and a verdict."""
        yield from summary(self.topics, self.left_aside)

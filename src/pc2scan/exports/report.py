"""The report of an export, which the table and JSON read."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from pc2scan.errors import visible
from pc2scan.result import MAX_LISTED, SHOWN, Part, Remark, Result, Skipped, listed
from pc2scan.tables import Table
from pc2scan.text import count, counted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pc2scan.bags.damage import Damage


@dataclass(slots=True)
class ExportedTopic:
    """The result of one topic.

    Attributes
    ----------
    topic
        Its name; for scans that are made of clouds, the scans' topic.
    path
        Its file or folder; None if nothing was written.
    written, skipped
        Numbers of messages.
    pose_frame, base_frame
        The frame of reference of the poses, and the frame that has them; empty without poses.
    """

    topic: str
    path: str | None = None
    written: int = 0
    skipped: int = 0
    pose_frame: str = ""
    base_frame: str = ""


@dataclass(repr=False)
class ExportReport(Result):
    """The report of an export; ``print`` shows it as a table.

    Attributes
    ----------
    sources
        The recordings.
    destination
        The file, or the folder.
    format
        The name of its format.
    topics
        The result of each topic.
    skipped
        The first hundred messages that were skipped.
    skipped_reasons
        How many were skipped for which reason.
    notes
        Values that were measured, or chosen by default.
    warnings
        Problems that did not stop the export.
    damage
        Damaged places of the sources.
    """

    kind: ClassVar[str] = "export"
    json_names: ClassVar[tuple[str, ...]] = (
        *("sources", "destination", "format", "topics", "skipped", "skipped_count", "skipped_reasons"),
    )

    sources: list[str]
    destination: str
    format: str
    topics: list[ExportedTopic] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    skipped_reasons: Counter[str] = field(default_factory=Counter)
    #: The first message that was skipped for each reason.
    _examples: dict[str, Skipped] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    damage: tuple[Damage, ...] = ()

    @property
    def messages(self) -> int:
        """How many messages were written."""
        return sum(topic.written for topic in self.topics)

    @property
    def skipped_count(self) -> int:
        """How many messages were skipped."""
        return sum(self.skipped_reasons.values())

    @property
    def exit_status(self) -> int:
        """The command's exit status: 3 if messages were skipped or a source is damaged, else 0."""
        return 3 if self.skipped_reasons or self.damage else 0

    def skip(self, entry: Skipped, reason: str) -> None:
        """Count a message that is not written; ``reason`` groups it with others."""
        self.skipped_reasons[reason] += 1
        self._examples.setdefault(reason, entry)
        if len(self.skipped) < MAX_LISTED:
            self.skipped.append(entry)

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield what was written, by topic."""
        rows = []
        for topic in self.topics:
            poses = f"{topic.base_frame} in {topic.pose_frame}" if topic.pose_frame else ""
            rows.append([topic.topic, topic.path or "", count(topic.written), count(topic.skipped), poses])
        yield Table(("topic", "file", "written", "skipped", "poses"), rows, left=("topic", "file", "poses"))

    def remarks(self, *, verbose: bool = False) -> Iterator[Remark]:
        """Yield why messages were skipped, damage and warnings."""
        reasons = [self.explained(*each) for each in self.skipped_reasons.most_common()]
        yield from listed("skipped", reasons, None if verbose else SHOWN)
        if hint := next((entry.hint for entry in self.skipped if entry.hint), ""):
            yield Remark("hint", hint)
        yield from self.usual_remarks(verbose=verbose)

    def explained(self, reason: str, number: int) -> str:
        """Return why messages were skipped, with the first of them."""
        example = self._examples.get(reason)
        first = "" if example is None or example.reason == reason else f"; {example}"
        return f"{counted(number, 'message')}: {reason}{first}"

    def __repr__(self) -> str:
        return f"<ExportReport: {counted(self.messages, 'message')} as {self.format} in {visible(self.destination)}>"

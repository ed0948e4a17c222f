"""The report of an export, which the table and JSON read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from pc2scan.errors import visible
from pc2scan.result import MAX_LISTED, Part, Remark, Result, Skipped, skipped_remarks
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
    skipped, skipped_count
        The first hundred messages that were skipped, and how many were.
    notes
        Values that were measured, or chosen by default.
    warnings
        Problems that did not stop the export.
    damage
        Damaged places of the sources.
    """

    kind: ClassVar[str] = "export"
    json_names: ClassVar[tuple[str, ...]] = ("sources", "destination", "format", "topics", "skipped", "skipped_count")

    sources: list[str]
    destination: str
    format: str
    topics: list[ExportedTopic] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    skipped_count: int = 0
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    damage: tuple[Damage, ...] = ()

    @property
    def messages(self) -> int:
        """How many messages were written."""
        return sum(topic.written for topic in self.topics)

    @property
    def exit_status(self) -> int:
        """The command's exit status: 3 if messages were skipped or a source is damaged, else 0."""
        return 3 if self.skipped_count or self.damage else 0

    def skip(self, entry: Skipped) -> None:
        """Count a message that is not written."""
        self.skipped_count += 1
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
        yield from skipped_remarks(self.skipped, self.skipped_count, verbose=verbose)
        yield from self.usual_remarks(verbose=verbose)

    def __repr__(self) -> str:
        return f"<ExportReport: {counted(self.messages, 'message')} as {self.format} in {visible(self.destination)}>"

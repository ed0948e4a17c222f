"""The valid pages of a log beside a database, their places, and the problems of the log."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from pc2scan.files.source import SourceFile


class LogProblem(NamedTuple):
    """A problem of a log, its offset, and how many bytes of the log are not used."""

    what: str
    offset: int
    bytes_lost: int = 0


@dataclass(slots=True)
class PageLog:
    """The pages of a log that replace those of the database.

    Attributes
    ----------
    file
        The log.
    page_size, stored
        Bytes of a page of the database, and how many it has itself.
    places
        Where in the log a page is, by the number of the page.
    doubtful
        The numbers of pages whose checksum is wrong, by their places: the number or the content has changed.
    page_count
        Pages that the database has with this log; None if the log does not say.
    problems
        What is wrong with it.
    broken
        Whether pages are missing or doubtful, so that those that are left may not fit together.
    """

    file: SourceFile
    page_size: int
    stored: int
    places: dict[int, int] = field(default_factory=dict)
    doubtful: dict[int, int] = field(default_factory=dict)
    page_count: int | None = None
    problems: list[LogProblem] = field(default_factory=list)
    broken: bool = False

    def note(self, what: str, offset: int, bytes_lost: int = 0, *, broken: bool = True) -> None:
        """Add a problem."""
        self.problems.append(LogProblem(what, offset, bytes_lost))
        self.broken |= broken

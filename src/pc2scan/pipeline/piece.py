"""A piece of a recording that a process of its own converts, and its result."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from .conclusion import Tally
    from .report import Report


class Piece(NamedTuple):
    """The messages of a piece, and the folder of its files.

    Attributes
    ----------
    folder
        The directory that the files are written in, with a metadata.yaml of their own.
    start_ns, stop_ns
        Only messages with ``start_ns <= log_time_ns < stop_ns``; None: from the beginning, to the end of what is
        converted.
    is_first
        Whether it has everything that precedes the messages: latched messages from before the cut, attachments, the
        user's transforms.
    first_file
        The number of its first file.
    transforms
        Files with all transforms; see `pc2scan.tf.stored`. Empty if the conversion needs none.
    """

    folder: Path
    start_ns: int | None
    stop_ns: int | None
    is_first: bool
    first_file: int = 0
    transforms: tuple[Path, ...] = ()


class PieceResult(NamedTuple):
    """The result of a piece: its report, not yet concluded, and its files' part of metadata.yaml."""

    report: Report
    tally: Tally
    info: Mapping[str, Any]

    @property
    def file_count(self) -> int:
        """How many files have messages."""
        return sum(file["message_count"] > 0 for file in self.info["files"])

"""Callbacks for what happens in a batch, and its progress."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from .manifest import Record
    from .plan import Plan


class BatchProgress(NamedTuple):
    """The progress of a batch: bytes of sources and number of recordings, done and in total."""

    bytes_done: int
    bytes_total: int
    recordings_done: int
    recordings_total: int


def _ignore(_argument: object) -> None:
    """Do nothing."""


@dataclass(frozen=True, slots=True)
class Watch:
    """Callbacks for what happens in a batch. All are called in the thread that runs the batch.

    Attributes
    ----------
    planned
        Called with the plan.
    progress
        Called from time to time with the progress.
    done
        Called when a recording is done, with its line of the manifest.
    shown
        Called with the report of each conversion as text; None: no such text is made.
    warn
        Called with warnings that the user should see at once.
    inform
        Called with information for the user, such as the address of a dashboard.
    """

    planned: Callable[[Plan], None] = _ignore
    progress: Callable[[BatchProgress], None] = _ignore
    done: Callable[[Record], None] = _ignore
    shown: Callable[[str], None] | None = None
    warn: Callable[[str], None] = _ignore
    inform: Callable[[str], None] = _ignore


@dataclass(slots=True)
class Progress:
    """Adds up the progress of all conversions."""

    sizes: Mapping[str, int]
    watch: Watch
    done: dict[str, int] = field(default_factory=dict)
    ended: set[str] = field(default_factory=set)

    def at(self, key: str, share: float) -> None:
        """Report how much of a recording is done, 0 to 1."""
        self.done[key] = round(self.sizes[key] * min(1.0, share))
        total = sum(self.sizes.values())
        self.watch.progress(BatchProgress(sum(self.done.values()), total, len(self.ended), len(self.sizes)))

    def end(self, key: str) -> None:
        """Report that a recording has ended."""
        self.ended.add(key)
        self.at(key, 1.0)

"""How a batch runs, and callbacks for what happens in it; none of these options affects the outputs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import UsageError

from .summary import BEGINNINGS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from pc2scan.options.call import Options

    from .manifest import ManifestRecord
    from .plan import BatchPlan


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchOptions:
    """How a batch runs. None of these options affects the outputs.

    Attributes
    ----------
    dataset
        The dataset file; None for none.
    jobs
        How many recordings are converted at a time; 0: one for each core, as far as the memory is enough.
    retries
        How often a recording is tried again if its process died: up to 100 times.
    checksum
        Whether sources are compared by SHA-256 instead of their times of modification.
    force
        Whether recordings are converted again whose results are up to date.
    fail_fast
        Whether the run ends when the first recording fails.
    dry_run
        Whether nothing is written; the report then says what would be.
    dask
        The address of a Dask scheduler whose workers convert; True: a Dask cluster is started on this machine.
    report
        A file for the report: ``.json``, ``.csv`` or ``.md``; None for none.
    scratch
        The folder for local copies of what is at URLs; None: the system's folder for temporary files.
    """

    dataset: Path | None = None
    jobs: int = 0
    retries: int = 1
    checksum: bool = False
    force: bool = False
    fail_fast: bool = False
    dry_run: bool = False
    dask: bool | str = False
    report: Path | None = None
    scratch: Path | None = None

    @classmethod
    def of(cls, options: Options) -> BatchOptions:
        """Return how a batch runs, by the options of a call."""
        return cls(**options.among(cls.__dataclass_fields__))

    def __post_init__(self) -> None:
        if isinstance(self.dask, str) and "://" not in self.dask:
            raise UsageError(f"`dask={self.dask}`: the address of a scheduler is tcp://HOST:PORT")
        if isinstance(self.dask, str) and self.jobs:
            raise UsageError(f"`jobs={self.jobs}` has no effect with `dask={self.dask}`", hint="give only one of them")
        if self.report is not None and self.report.suffix.lower() not in BEGINNINGS:
            raise UsageError(
                f"`report={self.report}`: a report of a batch is one of {', '.join('NAME' + end for end in BEGINNINGS)}"
            )


class BatchProgress(NamedTuple):
    """The progress of a batch: bytes of sources and number of recordings, done and in total."""

    bytes_done: int
    bytes_total: int
    recordings_done: int
    recordings_total: int


def _ignore(_argument: object) -> None:
    """Do nothing."""


@dataclass(frozen=True, slots=True)
class BatchCallbacks:
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

    planned: Callable[[BatchPlan], None] = _ignore
    progress: Callable[[BatchProgress], None] = _ignore
    done: Callable[[ManifestRecord], None] = _ignore
    shown: Callable[[str], None] | None = None
    warn: Callable[[str], None] = _ignore
    inform: Callable[[str], None] = _ignore


@dataclass(slots=True)
class ProgressSum:
    """Adds up the progress of all conversions."""

    sizes: Mapping[str, int]
    watch: BatchCallbacks
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

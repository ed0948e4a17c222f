"""Estimates how long a batch would take: by earlier conversions in the manifest, or by converting a recording."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .work import convert_one

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .manifest import Record
    from .work import Job

#: Sizes of recordings that are converted as a sample: smaller ones say little, larger ones take too long.
_SAMPLE_BYTES = range(1_000_000, 300_000_000)


def estimated_seconds(jobs: Sequence[Job], records: Sequence[Record], workers: int) -> float | None:
    """Return how many seconds these jobs would take; None if that cannot be estimated.

    Parameters
    ----------
    jobs
        The recordings that would be converted.
    records
        The lines of the manifest.
    workers
        How many recordings are converted at a time.
    """
    size = sum(job.size_bytes for job in jobs)
    if not size:
        return 0.0
    done = [record for record in records if record.is_written and record.seconds > 0]
    pace = sum(record.identity.size_bytes for record in done) / max(sum(record.seconds for record in done), 1e-9)
    if not done:
        pace = _sampled(jobs)
    return size / pace / max(1, min(workers, len(jobs))) if pace else None


def _sampled(jobs: Sequence[Job]) -> float:
    """Return the bytes per second of a small recording, converted into a temporary folder; 0 if none can be."""
    fitting = sorted((job for job in jobs if job.size_bytes in _SAMPLE_BYTES), key=lambda job: job.size_bytes)
    for job in fitting[:3]:
        with tempfile.TemporaryDirectory(prefix="pc2scan-") as folder:
            destination = str(Path(folder) / Path(job.destination).name)
            result = convert_one(replace(job, destination=destination, dry_run=False))
            if result.report is not None and result.seconds:
                return job.size_bytes / result.seconds
    return 0.0

"""How long the conversions of a dry run would take: by earlier ones on this machine, or by one that is tried."""

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

__all__ = ["estimated_seconds"]

#: The largest recording that is converted as a sample, and the smallest that says anything.
_SAMPLE_BYTES = range(1_000_000, 300_000_000)


def estimated_seconds(jobs: Sequence[Job], records: Sequence[Record], workers: int) -> float | None:
    """Return how long these jobs would take; None if nobody knows.

    Parameters
    ----------
    jobs
        What would be converted.
    records
        The manifest.
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
    """Bytes a second of a small recording, converted into a temporary folder; 0 if there is none that can be."""
    fitting = sorted((job for job in jobs if job.size_bytes in _SAMPLE_BYTES), key=lambda job: job.size_bytes)
    for job in fitting[:3]:
        with tempfile.TemporaryDirectory(prefix="pc2scan-") as folder:
            destination = str(Path(folder) / Path(job.destination).name)
            result = convert_one(replace(job, destination=destination, dry_run=False))
            if result.report is not None and result.seconds:
                return job.size_bytes / result.seconds
    return 0.0

"""Batches whose conversions run in this process, and what they leave."""

from __future__ import annotations

import atexit
import json
import shutil
import tempfile
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pc2scan
from pc2scan.datasets.jobs import convert_one
from support.builders import CONTENT, write_db3, write_mcap, write_rosbag1, write_rosbag2
from support.command import Finished, run

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence

    from pc2scan.datasets.jobs import Job
    from pc2scan.datasets.manifest import ManifestRecord
    from pc2scan.datasets.summary import BatchReport

#: Heights that leave points of `support.builders.CONTENT` in its scans, as they are typed and as keywords.
HEIGHTS = ("--min-height", "-2", "--max-height", "2")
KEYWORDS: dict[str, Any] = {"min_height": -2, "max_height": 2}


def _execute(waiting: Sequence[Job], jobs: list[str], **_: object) -> Generator[ManifestRecord]:
    """Run jobs one after the other."""
    for job in waiting:
        jobs.append(job.key)
        yield convert_one(job)


@contextmanager
def in_this_process() -> Iterator[list[str]]:
    """Let batches convert in this process instead of in processes of their own, which take long to start.

    Yields the keys of the jobs that were begun.
    """
    jobs: list[str] = []
    with patch("pc2scan.datasets.batch.run_jobs", partial(_execute, jobs=jobs)):
        yield jobs


def batch(sources: Any, out: Path | str, **words: Any) -> BatchReport:
    """Run ``pc2scan.batch``, and convert in this process."""
    with in_this_process():
        return pc2scan.batch(sources, out, **{**KEYWORDS, **words})


def run_batch(*words: str | Path, cwd: Path | None = None) -> Finished:
    """Run the command ``pc2scan batch``, and convert in this process."""
    with in_this_process():
        return run("batch", *words, *HEIGHTS, cwd=cwd)


def manifest_of(folder: Path) -> dict[str, dict[str, Any]]:
    """The last line of each recording; a line without its end is ignored, as the command does."""
    path = folder / "manifest.jsonl"
    data = path.read_bytes() if path.exists() else b""
    lines = [json.loads(line) for line in data.split(b"\n")[:-1]]
    return {line["key"]: line for line in lines}


def contents(folder: Path) -> dict[str, bytes | str]:
    """The bytes of every file below a folder, and where links lead; not the manifest."""
    return {
        path.relative_to(folder).as_posix(): str(path.readlink()) if path.is_symlink() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if (path.is_symlink() or path.is_file()) and path.name != "manifest.jsonl"
    }


def place(folder: Path, *names: str) -> Path:
    """Write a recording under each name; its suffix says the container, and one without suffix is a rosbag2 folder."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        template = _template(path.suffix)
        (shutil.copytree if template.is_dir() else shutil.copyfile)(template, path)
    return folder


@cache
def _template(suffix: str) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="pc2scan-test-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    write: Callable[..., Path] = {".bag": write_rosbag1, ".mcap": write_mcap, ".db3": write_db3, "": write_rosbag2}[
        suffix
    ]  # type: ignore[assignment]
    return write(folder / f"content{suffix}", CONTENT)

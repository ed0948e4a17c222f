"""Jobs with sources or results at URLs: sources are downloaded before a worker begins, and results uploaded after.

While workers convert, the next recordings are downloaded and the last results uploaded. Space on the local disk is
reserved before a download: the size of the sources, and as much again for a result that will be uploaded. A recording
whose result needs more is tried again with all the space.
"""

from __future__ import annotations

import shutil
from collections import deque
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import RLock, Thread
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, OutputError, Pc2ScanError, name_list
from pc2scan.files.ownership import ruling
from pc2scan.files.parts import unrecorded_warning
from pc2scan.files.places import LEFTOVERS, parts_among
from pc2scan.files.records import FileState, Record, files_below
from pc2scan.remote.scratch import ScratchError, ScratchSpace, scratch_folder
from pc2scan.remote.urls import UrlNames, is_url

from .folder import first_part
from .identity import Identity, identity_of, versions
from .jobs import JobResult, utc_now
from .processes import JobEnd, Queue
from .stores import identity_in

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from pc2scan.remote.store import RemotePath, StoredObject

    from .jobs import Job
    from .processes import Event

#: Bytes by which a result may be larger than its sources: an index, message definitions.
_BESIDE = 1_000_000

#: Seconds that copying threads have to end. After that the folder is removed in any case.
_END_SECONDS = 5.0

_UNKNOWN = FileState(-1)

#: Space for copies, by folder and size. Dask tasks that run in one process share it.
_rooms: dict[tuple[Path | None, int | None], ScratchSpace] = {}
_rooms_lock = RLock()


class _ClosedQueueError(Exception):
    """The queue was closed, so the copy is not needed."""


@contextmanager
def staged_jobs(jobs: Sequence[Job], workers: int) -> Iterator[Queue]:
    """Yield the queue of jobs. While the context lasts, sources at URLs are copied, and results uploaded.

    Parameters
    ----------
    jobs
        In the order in which they begin.
    workers
        The number of workers, and of recordings that are copied ahead.
    """
    if not any(is_remote(job) and not job.dry_run for job in jobs):
        yield Queue(jobs)
        return
    scratch, most = jobs[0].scratch, jobs[0].scratch_size
    with scratch_folder(None if scratch is None else Path(scratch)) as folder:
        key = folder.parent, most
        with _rooms_lock:
            room = _rooms.setdefault(key, ScratchSpace(folder, most))
        queue = _StagingQueue(jobs, workers, folder, room)
        try:
            yield queue
        finally:
            queue.close()


def is_remote(job: Job) -> bool:
    """Return whether a job reads or writes anything at a URL."""
    others = job.request.options.frames.tf_from
    return any(map(is_url, (*map(Path, job.sources), Path(job.destination), *others)))


@dataclass(slots=True, eq=False)
class _Copy:
    """A job and its local copies."""

    job: Job
    folder: Path
    reserved: int = 0
    #: Whether all the space is reserved for it.
    alone: bool = False
    identity: Identity | None = None
    names: UrlNames = field(default_factory=UrlNames)


class _StagingQueue(Queue):
    """Copies the sources of jobs ahead of the workers."""

    def __init__(self, jobs: Sequence[Job], workers: int, folder: Path, room: ScratchSpace) -> None:
        super().__init__(())
        self._folder = folder
        self._room = room
        self._ahead = max(1, workers)
        self._waiting = deque(_Copy(job, folder / str(number)) for number, job in enumerate(jobs))
        self._copies: dict[str, _Copy] = {}
        self._loading = 0
        self._uploading = 0
        self._closed = False
        self._lock = RLock()
        self._threads: list[Thread] = []
        self._sizes: dict[Path, int] = {}

    def __len__(self) -> int:
        with self._lock:
            return len(self._waiting) + self._loading + len(self._ready)

    @property
    def is_open(self) -> bool:
        """Whether anything is left to do besides the jobs that workers have."""
        with self._lock:
            return bool(len(self) or self._uploading)

    def begin(self, post: Callable[[Event | None], None]) -> None:
        """Start copying; ``post``, which any thread may call, takes events, and None if another job is ready."""
        super().begin(post)
        self._room.listeners.append(self.look)
        self.look()

    def take(self) -> Job | None:
        """Return the next job whose sources are copied; None while there is none."""
        with self._lock:
            job = super().take()
        self.look()
        return job

    def done(self, result: JobResult) -> JobResult | None:
        """Begin to upload a result, and return None; a result that needs no upload is returned."""
        copy = self._copies[result.key]
        if (result.error or {}).get("kind") == ScratchError.__name__ and not copy.alone:
            with self._lock:
                self._release(copy)
                self._waiting.append(_Copy(copy.job, copy.folder.with_name(f"{copy.folder.name}_alone"), alone=True))
            self.look()
            return None
        if result.error is not None or not is_url(Path(copy.job.destination)):
            return self._finish_copy(copy, result)
        with self._lock:
            self._uploading += 1
        self._start(self._upload, copy, result)
        return None

    def close(self) -> None:
        """End all copying."""
        self._closed = True
        with suppress(ValueError):
            self._room.listeners.remove(self.look)
        for thread in self._threads:
            thread.join(_END_SECONDS)
        with self._lock:
            for copy in list(self._copies.values()):
                self._release(copy)

    def look(self) -> None:
        """Begin to copy the next recordings, as far as there is space."""
        with self._lock:
            while self._waiting and not self._closed and self._loading + len(self._ready) < self._ahead:
                copy = self._waiting[0]
                try:
                    needed, result = self._needed(copy.job)
                except Pc2ScanError as err:
                    self._waiting.popleft()
                    self._post(JobEnd(_failure_result(copy, err, "copied")))
                    continue
                if needed > self._room.total:
                    self._waiting.popleft()
                    self._post(JobEnd(_failure_result(copy, self._room.refusal(needed, self._folder.parent), "copied")))
                    continue
                wanted = self._room.total if copy.alone else min(needed + result, self._room.total)
                if not self._room.reserve(wanted):
                    return
                self._waiting.popleft()
                copy.reserved = wanted
                self._copies[copy.job.key] = copy
                self._loading += 1
                self._start(self._load, copy)

    def _needed(self, job: Job) -> tuple[int, int]:
        """Return the bytes of the copies of a job, and the bytes that are reserved for its result."""
        from pc2scan.remote.store import RemotePath  # noqa: PLC0415  # loads fsspec

        needed = job.size_bytes if any(is_url(Path(path)) for path in job.sources) else 0
        for path in job.request.options.frames.tf_from:
            if not is_url(path):
                continue
            if path not in self._sizes:
                files = RemotePath(path).files()
                places = [RemotePath(path)] if files is None else list(files.values())
                self._sizes[path] = sum(place.stat().size for place in places)
            needed += self._sizes[path]
        return needed, job.size_bytes + _BESIDE if is_url(Path(job.destination)) else 0

    def _start(self, work: Callable[..., None], *args: object) -> None:
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        thread = Thread(target=work, args=args, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _check(self) -> None:
        if self._closed:
            raise _ClosedQueueError

    def _load(self, copy: _Copy) -> None:
        """Copy the sources of a job. Runs in a thread."""
        try:
            job = self._copied(copy)
            self._check()
        except _ClosedQueueError:
            return
        except Exception as err:  # noqa: BLE001  # one recording must not end the others
            result = self._finish_copy(copy, _failure_result(copy, err, "copied"))
            with self._lock:
                self._loading -= 1
                self._post(JobEnd(result))
            self.look()
            return
        with self._lock:
            self._loading -= 1
            self._ready.append(job)
            self._post(None)

    def _copied(self, copy: _Copy) -> Job:
        from pc2scan.remote.store import RemotePath  # noqa: PLC0415  # loads fsspec

        job, number = copy.job, 0

        def here(text: str | Path) -> Path:
            nonlocal number
            if not is_url(Path(text)):
                return Path(text)
            place = RemotePath(Path(text))
            folder = copy.folder / "in" / str(number)
            number += 1
            folder.mkdir(parents=True)
            copy.names.add(folder, place.parent)
            target = folder / place.name
            files = place.files()
            if files is not None:
                target.mkdir()
            for name, file in ({"": place} if files is None else files).items():
                path = target / name if name else target
                versions[str(path)] = file.download(path, self._check).version
            return target

        sources = [here(path) for path in job.sources]
        frames = job.request.options.frames
        frames = replace(frames, tf_from=tuple(here(path) for path in frames.tf_from))
        request = replace(job.request, options=replace(job.request.options, frames=frames))
        copy.identity = identity_of(sources)
        destination, most = job.destination, None
        if is_url(Path(destination)):
            place = RemotePath(Path(destination))
            # Where the worker writes the result, which is uploaded from there.
            (copy.folder / "out").mkdir(parents=True)
            copy.names.add(copy.folder / "out", place.parent)
            destination, most = str(copy.folder / "out" / place.name), (str(copy.folder), copy.reserved)
        # The copies are in a new folder, where nothing is replaced.
        owned = job.owned if most is None else None
        return replace(
            job, sources=tuple(map(str, sources)), destination=destination, owned=owned, request=request, room=most
        )

    def _upload(self, copy: _Copy, result: JobResult) -> None:
        """Upload a result. Runs in a thread."""
        try:
            identity, warnings = self._uploaded(copy)
            if warnings and result.report is not None:
                report = {**result.report, "warnings": [*result.report.get("warnings", ()), *warnings]}
                result = replace(result, report=report)
            result = replace(result, output_identity=identity)
        except _ClosedQueueError:
            return
        except Exception as err:  # noqa: BLE001  # one recording must not end the others
            failed = _failure_result(copy, err, "uploaded")
            result = replace(failed, started=result.started, seconds=result.seconds, attempts=result.attempts)
        result = self._finish_copy(copy, result)
        with self._lock:
            self._uploading -= 1
            self._post(JobEnd(result))

    def _uploaded(self, copy: _Copy) -> tuple[Identity, list[str]]:
        """Upload the result, complete or not at all; return its identity, and warnings."""
        from pc2scan.remote.store import RemotePath  # noqa: PLC0415  # loads fsspec

        target = RemotePath(Path(copy.job.destination))
        folder = RemotePath(Path(copy.job.destination.rstrip("/").rpartition("/")[0]))
        here = copy.folder / "out"
        names = [path.name for path in here.iterdir() if not path.name.endswith(LEFTOVERS)]
        is_numbered = target.name not in names
        made = parts_among(names, target.name) if is_numbered else names
        warnings = self._make_way(copy.job, folder, target.name, here, made, is_numbered=is_numbered)
        objects: dict[str, StoredObject] = {}
        done: list[str] = []
        try:
            # From the last part to the first: if the first part exists, all parts exist.
            for name in reversed(made):
                place = folder.child(name)
                if (here / name).is_dir():
                    folder.upload(here / name, name, self._check)
                    objects |= {f"{name}/{below}": found for below, found in place.below().items()}
                else:
                    done.append(folder.upload_file(here / name, name, self._check))
                    objects[name] = place.stat()
        except BaseException:
            # If the recording has several files, none of them stays.
            if len(made) > 1:
                folder.remove(done)
            raise
        return identity_in(objects, first_part(target.name) if is_numbered else target.name), warnings

    def _make_way(
        self, job: Job, folder: RemotePath, target: str, here: Path, made: Sequence[str], *, is_numbered: bool
    ) -> list[str]:
        """Remove what the result replaces in the store; raise if that is not permitted. Return warnings."""
        written: set[str] = set()
        for name in made:
            written |= {f"{name}/{below}" for below in files_below(here / name)} if (here / name).is_dir() else {name}
        listed = folder.below()
        if is_numbered:
            present = parts_among((name for name in listed if "/" not in name), target)
        else:
            present = [name for name in listed if name == target or name.startswith(f"{target}/")]
        record = job.owned or Record({})
        # Of an upload that was killed, only the name is known.
        begun = record.files.get(first_part(target) if is_numbered else target, _UNKNOWN) is None
        overwrite = job.request.output.overwrite or begun
        found = ruling(
            present,
            written,
            record,
            overwrite=overwrite,
            is_unchanged=lambda name, left: left is not None and listed[name] == (left.size, left.time),
        )
        if found.refused or (found.kept and not overwrite and not record.files):
            shown = folder.child((found.refused or found.kept)[0]).shown
            raise DestinationError("exists already", path=shown, hint="`overwrite=True` replaces it")
        if found.kept and not is_numbered:
            raise DestinationError(
                "has something that this batch did not write, or that was changed since, and is not replaced: "
                + name_list(found.kept, 3),
                path=folder.child(target).shown,
                hint="move it away, or write to another folder",
            )
        # Without its metadata.yaml a directory is no recording any more. Files are replaced in one step.
        gone = found.removed if is_numbered else [name for name in (*found.removed, *found.replaced) if "/" in name]
        for name in sorted(gone, key=lambda name: (not name.endswith("/metadata.yaml"), name)):
            folder.child(name).delete()
        return unrecorded_warning(target, found.kept)

    def _finish_copy(self, copy: _Copy, result: JobResult) -> JobResult:
        """Remove the copies, and replace their paths in the result by URLs."""
        shown: JobResult = copy.names.of(replace(result, identity=copy.identity or result.identity))
        with self._lock:
            self._release(copy)
        self.look()
        return shown

    def _release(self, copy: _Copy) -> None:
        self._copies.pop(copy.job.key, None)
        shutil.rmtree(copy.folder, ignore_errors=True)
        for path in [path for path in versions if path.startswith(f"{copy.folder}/")]:
            with suppress(KeyError):
                del versions[path]
        self._room.release(copy.reserved)
        copy.reserved = 0


def _failure_result(copy: _Copy, err: Exception, what: str) -> JobResult:
    """Return the result of a job that could not be copied or uploaded."""
    error = err if isinstance(err, Pc2ScanError) else OutputError(f"cannot be {what}: {type(err).__name__}: {err}")
    copy.names.error(error)
    return JobResult(
        key=copy.job.key,
        outcome="failed",
        exit_status=error.exit_status,
        error=error.as_dict(),
        started=utc_now(),
    )

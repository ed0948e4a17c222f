"""The files of a run: the destination and its options, the inputs, and the report."""

from __future__ import annotations

import time
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import DestinationError, OutputError, Pc2ScanError
from pc2scan.files.outputs import check_file_output, file_output
from pc2scan.files.ownership import OutputPath, inputs_of, refuse_overlap
from pc2scan.files.source import changed_while_read, state_of
from pc2scan.result import BEGINNING, Result

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.transforms.placing import FrameOptions

    from .report import Report


class OutputOptions(NamedTuple):
    """Options of the destination; None means the container's default.

    Attributes
    ----------
    storage
        The storage of a rosbag2 directory: ``mcap`` or ``sqlite3``.
    compression
        ``none``, ``lz4``, ``zstd`` or ``bz2``, as the container allows. With None, chunks that are copied
        whole keep their compression.
    profile
        The profile of an ``.mcap`` file: ``ros1`` or ``ros2``.
    overwrite
        Whether an existing destination, and an existing file at the report's path, are replaced.
    owned
        The files of the destination that a batch has recorded: it is replaced without ``overwrite``, too.
    report
        Path of the report as JSON; None for no file.
    folder
        Folder of a destination that is named after the source; None: next to the source. It is created if it does not
        exist.
    to
        Format of the destination: ``bag``, ``mcap`` or ``rosbag2``; None: by its name, or the source's.
    dry_run
        Whether nothing is written, not even the report.
    like_source
        Whether a named destination has the storage of the source, like a destination that is named after the source.
    scratch
        Folder of the local copies of what is at URLs; None: the system's folder for temporary files.
    """

    storage: str | None = None
    compression: str | None = None
    profile: str | None = None
    overwrite: bool = False
    owned: frozenset[str] | None = None
    report: Path | None = None
    folder: Path | None = None
    to: str | None = None
    dry_run: bool = False
    like_source: bool = False
    scratch: Path | None = None


class RunFiles:
    """The files that a run reads and writes, and its report.

    Attributes
    ----------
    sources, destination
        Paths; ``destination`` is None until it is known.
    """

    def __init__(
        self,
        sources: Sequence[Path],
        destination: Path | None,
        frames: FrameOptions,
        also_read: Mapping[str, Path],
        output: OutputOptions,
    ) -> None:
        self.sources = sources
        self.destination = destination
        self.read = (*sources, *frames.tf_from)
        self._inputs = inputs_of(sources, frames.tf_from, also_read)
        self._states = [state_of(path) for path in self.read]
        self._output = output
        self._write_report: Callable[[str], None] | None = None

    def open_report(self, stack: ExitStack) -> None:
        """Open the report's file; raise if that cannot be done, or if an input would be overwritten.

        In a dry run, it is only checked that the file can be written.
        """
        output, path = self._output, self._output.report
        report = [] if path is None else [OutputPath(path, "`report`")]
        destination = [] if self.destination is None else [OutputPath(self.destination)]
        refuse_overlap(self._inputs, [*destination, *report])
        if path is None:
            return
        try:
            if output.dry_run:
                check_file_output(path, beginning=BEGINNING, overwrite=output.overwrite)
            else:
                written = file_output(path, beginning=BEGINNING, overwrite=output.overwrite)
                self._write_report = stack.enter_context(written)
        except (DestinationError, OutputError) as err:
            err.message = f"the report cannot be written there: {err.message}"
            raise

    def deliver(self, report: Report) -> None:
        """Write the report. If that fails, the recording stays, and the exit status and a warning say so."""
        if self._write_report is None:
            return
        try:
            self._write_report(report.as_json())
        except (DestinationError, OutputError) as err:
            report.undelivered = True
            report.warnings.append(f"{err.path}: the report is not written: {err.message}; {report.destination} is")

    def deliver_failure(self, report: Result) -> None:
        """Write the report of a run that failed, if possible; the error itself is raised in any case."""
        if self._output.report is None or self._output.dry_run:
            return
        if any(error.path == self._output.report for error in report.errors):
            # The error may be that this file cannot be written.
            return
        with suppress(DestinationError, OutputError), ExitStack() as stack:
            if self._write_report is None:
                self.open_report(stack)
            if self._write_report is not None:
                self._write_report(report.as_json())

    @contextmanager
    def reporting(self, report: Report) -> Generator[None]:
        """Write the report at the end, also after an error."""
        began = time.monotonic()
        try:
            yield
        except Exception as err:
            report.errors = [err if isinstance(err, Pc2ScanError) else Pc2ScanError(f"{type(err).__name__}: {err}")]
            report.seconds = round(time.monotonic() - began, 3)
            self.deliver_failure(report)
            raise
        report.seconds = round(time.monotonic() - began, 3)
        self.deliver(report)

    def refuse_changed(self) -> None:
        """Raise if a source changed during the run: the result may mix its old and new bytes."""
        for source, state in zip(self.read, self._states, strict=True):
            if state_of(source) != state:
                raise changed_while_read(source)

"""Runs one export from beginning to end, and reports it."""

from __future__ import annotations

import itertools
import re
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.conversion.corrections import corrected_transforms
from pc2scan.errors import MessageError, OutputError, ResultError, TransformError, UsageError, name_list
from pc2scan.files.outputs import inputs_of, read_record, refuse_overlap, staged_output, write_record
from pc2scan.files.system import remove
from pc2scan.parsing import conversion_of, destination_of
from pc2scan.progress import Meter
from pc2scan.result import MAX_LISTED, Part, Result, Skipped, tell_early
from pc2scan.streams.stream import Clouds, Scans
from pc2scan.text import Table, count

from .writers import RobotPoses, format_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.files.paths import PathText
    from pc2scan.options.call import Options
    from pc2scan.parsing import Warn
    from pc2scan.progress import Progress
    from pc2scan.request.spec import Request

    from .writers import FileWriter, Write

#: The longest name: file systems allow 255 bytes, and staging adds an ending.
_MAX_NAME = 120


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


def file_names(topics: Iterable[str]) -> dict[str, str]:
    """Return a name for the file of each topic: safe on every file system, and no two the same.

    >>> list(file_names(["/front/scan", "/front_scan", "/Front_Scan", "/../x y", "/"]).values())
    ['front_scan', 'front_scan_2', 'Front_Scan_3', 'x_y', 'topic']
    """
    names: dict[str, str] = {}
    for topic in topics:
        safe = re.sub(r"[^A-Za-z0-9_.-]+", "_", topic).strip("_.-")[:_MAX_NAME] or "topic"
        # File systems may ignore case.
        taken = {name.lower() for name in names.values()}
        numbered = (f"{safe}_{number}" for number in itertools.count(2))
        names[topic] = next(name for name in itertools.chain([safe], numbered) if name.lower() not in taken)
    return names


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of the files to write.

    Attributes
    ----------
    format
        A name in `pc2scan.exports.writers.FORMATS`; None for the format of the destination's suffix.
    pose_frame
        The frame of reference of the poses, such as ``odom`` or ``map``; empty for that of the poses of a topic.
    base_frame
        The frame that has these poses. Empty: see `RobotPoses`.
    converting
        Whether scans are made of clouds; otherwise they are read.
    """

    format: str | None
    pose_frame: str
    base_frame: str
    converting: bool

    @classmethod
    def of(cls, options: Options, conversion: Request) -> ExportOptions:
        """Return the options of an export among those of a call."""
        converting = options.makes_scans or conversion.scan.may_combine
        return cls(options.format, options.pose_frame, options.base_frame, converting)


def export(
    sources: Sequence[Path],
    destination: PathText,
    options: Options,
    *,
    warn: Warn | None = None,
    progress: Progress | None = None,
) -> ExportReport:
    """Write scans, trajectories or clouds as files; see `pc2scan.export`."""
    conversion = conversion_of(options, warn)
    path, folder = destination_of(destination)
    form = ExportOptions.of(options, conversion)
    place = path or folder
    assert place is not None
    report = run(sources, place, conversion, form, warn, progress, in_folder=path is None, overwrite=options.overwrite)
    report.warnings += conversion.notes
    return report


def run(
    sources: Sequence[Path],
    destination: Path,
    request: Request,
    form: ExportOptions,
    warn: Callable[[str], None] | None = None,
    progress: Progress | None = None,
    *,
    in_folder: bool,
    overwrite: bool,
) -> ExportReport:
    """Export the scans, or the clouds, of a recording.

    Parameters
    ----------
    sources
        Recordings; several are read as one.
    destination
        The file; or a folder, which is created, for several topics, or for a format with a file for each message.
    request
        As for a conversion: topics, ``start`` and ``end``, the source of transforms, and how clouds are converted.
    form
        The options of the files to write.
    warn
        Called with each warning as soon as it is known, also if an error follows; the report has all of them.
    progress
        Called regularly; see `pc2scan.progress.Progress`.
    in_folder
        Whether ``destination`` is a folder even for a single file.
    overwrite
        Whether an existing destination is replaced.

    Raises
    ------
    UsageError
        If the request contradicts itself or the recording, or the format cannot store its messages.
    DestinationError, OutputError
        If the destination exists, or cannot be written.
    RecordingError
        If a source cannot be read.
    ResultError
        If there is nothing to write.
    MessageError
        If ``options.strict`` and a message cannot be written. After any error nothing is written.
    """
    file_format = format_of(form.format, destination)
    frames = request.frames
    _check_request(file_format, request, form)
    refuse_overlap(inputs_of(sources, frames.tf_from, request.files), [destination])
    meter = None if progress is None else Meter(progress)
    with ExitStack() as stack:
        if file_format.clouds:
            stream: Scans | Clouds = Clouds(sources, request, all_topics=True, meter=meter)
        else:
            reading = replace(request, only_scans=form.converting)
            stream = Scans(sources, reading, form.converting, all_topics=True, meter=meter)
        stack.callback(stream.close)
        names = _names(stream.topics, destination, file_format, in_folder=in_folder)
        entries = [ExportedTopic(topic, str(destination / names[topic])) for topic in stream.topics]
        report = ExportReport([str(source) for source in sources], str(destination), file_format.name, entries)
        stream.listener = tell = partial(tell_early, report.warnings, warn)
        # Before transforms are read, which may take long.
        unfinished = stack.enter_context(staged_output(destination, overwrite=overwrite, record_in=read_record))
        poses, readers = None, []
        if form.pose_frame or frames.odometry:
            readers = open_recordings(sources, stack, strict=request.strict)
            unnamed = form.base_frame.removeprefix("/")
            odometry = tuple(topic._replace(unnamed=unnamed or topic.unnamed) for topic in frames.odometry)
            own = replace(request, frames=replace(frames, odometry=odometry))
            needed = form.pose_frame, form.base_frame
            transforms, others = corrected_transforms(as_one(readers), own, stack, needed, meter)
            readers += others
            # Scans that are made of clouds have the right frame in their headers.
            poses = RobotPoses(transforms, *needed, "" if form.converting else frames.source_frame)
            tell(*transforms.warnings, *transforms.notes)
        try:
            if any(names.values()):
                unfinished.mkdir()
            _write(stream, file_format, {topic: unfinished / name for topic, name in names.items()}, report, poses)
        except OSError as err:
            raise OutputError(f"cannot be written: {err.strerror}", path=err.filename or unfinished) from err
        if unfinished.is_dir():
            write_record(unfinished)
        report.notes += stream.notes
        report.warnings += () if poses is None else poses.doubts()
        report.damage = tuple(dict.fromkeys((*stream.damage, *(d for reader in readers for d in reader.damage))))
    return report


def _check_request(file_format: FileWriter, request: Request, form: ExportOptions) -> None:
    """Raise if an option has no effect on an export, or if one is missing."""
    scan, frames = request.scan, request.frames
    posed = form.pose_frame or frames.odometry
    message = hint = ""
    if file_format.needs_poses and not posed:
        message = f"{file_format.name} needs poses"
        hint = "`pose_frame=odom` reads them from tf, `odom_topic=/odom` from odometry"
    elif scan.reverse or (file_format.clouds and form.converting):
        content = "clouds, but parameters of the projection make scans of them" if file_format.clouds else "scans"
        message = f"{file_format.name} is a format of {content}"
    elif form.converting:
        return
    elif scan.filters or scan.remove or scan.deskew or scan.level or any(topic.target for topic in scan.topics):
        message = "filters, `deskew`, `level`, `remove` and new names of topics have no effect: no clouds are converted"
        hint = "to convert clouds, give parameters: `preset`, `params_file`, or any of them, `min_height=-0.3`"
    elif not posed and (frames.static or frames.tf_from or frames.tf_topics or frames.source_frame):
        message = "transforms have no effect: neither poses nor scans of clouds are requested"
        hint = "`pose_frame=odom` writes poses"
    if message:
        raise UsageError(message, hint=hint or None)


def _names(topics: Sequence[str], destination: Path, file_format: FileWriter, *, in_folder: bool) -> dict[str, str]:
    """Return the name of each topic's file or folder in the destination; empty: it is the destination."""
    if len(topics) == 1 and (file_format.clouds or not in_folder):
        return {topics[0]: ""}
    suffix = "" if file_format.clouds else file_format.suffix
    if suffix and not in_folder and destination.suffix.lower() == suffix:
        text = f"{len(topics)} topics make {len(topics)} files: {name_list(list(topics), 5)}"
        hint = f"name a folder: `destination={destination.with_suffix('')}/`; or choose: `topics={topics[0]}`"
        raise UsageError(text, path=destination, hint=hint)
    return {topic: f"{name}{suffix}" for topic, name in file_names(topics).items()}


def _write(
    stream: Scans | Clouds,
    file_format: FileWriter,
    paths: Mapping[str, Path],
    report: ExportReport,
    poses: RobotPoses | None,
) -> None:
    """Write the messages of all topics, and remove the files of topics without a single one that can be written."""
    entries = {entry.topic: entry for entry in report.topics}
    writers: dict[str, Write] = {}
    with ExitStack() as stack:
        for item in stream:
            entry = entries[item.topic]
            try:
                posed = None if poses is None else poses.at(item)
                if item.topic not in writers:
                    writers[item.topic] = stack.enter_context(file_format.open(paths[item.topic]))
                writers[item.topic](item, posed)
            except MessageError as err:
                err.topic, err.stamp_ns = item.topic, item.stamp_ns
                if poses is not None and isinstance(err, TransformError):
                    # Poses are never extrapolated, so the hint of a conversion does not apply.
                    err.hint = "`pc2scan tf` shows the frames of a recording and their times"
                if stream.strict:
                    raise
                entry.skipped += 1
                reason = err.reason or err.message
                report.skip(Skipped(item.topic, item.log_time_ns, item.stamp_ns, reason, err.hint or ""))
            else:
                entry.written += 1
                if posed is not None:
                    entry.pose_frame = posed.pose_frame
                    entry.base_frame = posed.sensor_frame if file_format.clouds else posed.base_frame
    for skipped in stream.skipped:
        report.skip(skipped)
    report.skipped_count += stream.skipped_count - len(stream.skipped)
    if not report.messages:
        what = "cloud" if file_format.clouds else "scan"
        if not report.skipped:
            raise ResultError(f"no {what} to write: the topic has no messages", topic=stream.topics[0])
        first = report.skipped[0]
        text = f"no {what} can be written; {report.skipped_count:,} are skipped, the first: {first}"
        raise ResultError(text, hint=first.hint or None)
    for entry in report.topics:
        if not entry.written:
            entry.path = None
            remove(paths[entry.topic])
            report.warnings.append(f"{entry.topic}: nothing to write, so there is no file")

"""Runs one export from beginning to end."""

from __future__ import annotations

import re
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.conversion.stamps import corrected
from pc2scan.errors import (
    DestinationError,
    MessageError,
    OutputError,
    ResultError,
    TransformError,
    UsageError,
    name_list,
)
from pc2scan.files.ownership import OutputPath, inputs_of, refuse_overlap
from pc2scan.files.records import read_record, write_record
from pc2scan.files.staging import staged_output
from pc2scan.messages.clouds import CLOUDS, usual_topics
from pc2scan.messages.laserscan import LASERSCAN
from pc2scan.progress import Meter
from pc2scan.request.options import TopicRequest
from pc2scan.requests import conversion_of, destination_of
from pc2scan.result import Skipped, tell_early
from pc2scan.streams.clouds import Clouds
from pc2scan.streams.scans import Scans
from pc2scan.streams.stream import Selection

from .formats import format_of
from .poses import PoseOptions, open_poses
from .report import ExportedTopic, ExportReport

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from pc2scan.files.urls import PathText
    from pc2scan.options.call import Options
    from pc2scan.progress import Progress
    from pc2scan.request.options import ConvertOptions
    from pc2scan.requests import Warn

    from .formats import ExportFormat, TopicWriter
    from .poses import Poses

#: The longest name: file systems allow 255 bytes, and staging adds an ending.
_MAX_NAME = 120

#: Names that Windows reserves for devices.
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


def file_names(topics: Iterable[str]) -> dict[str, str]:
    """Return a name for the file of each topic: safe on every file system, and no two the same.

    >>> list(file_names(["/front/scan", "/front_scan", "/Front_Scan", "/../x y", "/"]).values())
    ['front_scan', 'front_scan_2', 'Front_Scan_3', 'x_y', 'topic']
    """
    taken: set[str] = set()
    found = {}
    for topic in topics:
        safe = re.sub(r"[^A-Za-z0-9_.-]+", "_", topic).strip("_.-")[:_MAX_NAME] or "topic"
        if _DEVICES.fullmatch(safe):
            safe = f"topic_{safe}"
        name, number = safe, 1
        # File systems may ignore case.
        while name.lower() in taken:
            number += 1
            name = f"{safe}_{number}"
        taken.add(name.lower())
        found[topic] = name
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """Options of the files to write.

    Attributes
    ----------
    format
        A name in `pc2scan.exports.formats.FORMATS`; None for the format of the destination's suffix.
    poses
        The poses to write with the messages.
    converting
        Whether scans are made of clouds; otherwise they are read.
    overwrite
        Whether an existing destination is replaced.
    owned
        The files of the destination that a batch has recorded: it is replaced without ``overwrite``, too.
    """

    format: str | None = None
    poses: PoseOptions = field(default_factory=PoseOptions)
    converting: bool = False
    overwrite: bool = False
    owned: frozenset[str] | None = None

    @classmethod
    def of(cls, options: Options, conversion: ConvertOptions, name: str | None) -> ExportOptions:
        """Return the options of an export in the format ``name`` among those of a call."""
        return cls(
            format=name,
            poses=PoseOptions(**{name: getattr(options, name) for name in PoseOptions.__dataclass_fields__}),
            converting=options.makes_scans or conversion.scan.may_combine,
            overwrite=options.overwrite,
        )


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
    place = path if path is not None else folder
    assert place is not None
    done = run(
        sources,
        place,
        conversion.options,
        ExportOptions.of(options, conversion.options, options.format),
        in_folder=path is None,
        also_read=conversion.files,
        progress=progress,
        warn=warn,
    )
    done.warnings += conversion.notes
    return done


def run(
    sources: Sequence[Path],
    destination: Path,
    options: ConvertOptions,
    form: ExportOptions,
    *,
    in_folder: bool = False,
    also_read: Mapping[str, Path] | None = None,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
) -> ExportReport:
    """Export the scans, or the clouds, of a recording.

    Parameters
    ----------
    sources
        Recordings; several are read as one.
    destination
        The file; or a folder, which is created, for several topics, or for a format with a file for each message.
    options
        As for a conversion: topics, ``start`` and ``end``, the source of transforms, and how clouds are converted.
    form
        The options of the files to write.
    in_folder
        Whether ``destination`` is a folder even for a single file.
    also_read
        Files that were read for the options, by option.
    progress
        Called regularly; see `pc2scan.progress.Progress`.
    warn
        Called with each warning as soon as it is known, also if an error follows; the report has all of them.

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
    _check_request(file_format, options, form)
    refuse_overlap(inputs_of(sources, options.frames.tf_from, also_read), [OutputPath(destination)])
    with ExitStack() as stack:
        readers = open_recordings(sources, stack, strict=options.strict)
        reader = as_one(readers)
        names = _topics([c for c in reader.connections if c.ros_version is not None], file_format, options, form)
        meter = None if progress is None else Meter(progress)
        stream = _stream(sources, names, file_format, options, form, meter)
        stack.callback(stream.close)
        folder = _is_folder(destination, stream.topics, file_format, in_folder=in_folder)
        report = ExportReport([str(source) for source in sources], str(destination), file_format.name)
        stream.listener = tell = partial(tell_early, report.warnings, warn)
        # Before transforms are read, which may take long.
        unfinished = stack.enter_context(
            staged_output(destination, overwrite=form.overwrite, owned=form.owned, record_in=read_record)
        )
        poses = None
        if form.poses.is_requested:
            others = open_recordings(options.frames.tf_from, stack, strict=options.strict)
            posing = reader
            if options.clock:
                posing, _ = corrected(reader, [], options.clock, options.frames.tf_topics)
            poses, texts = open_poses([posing, *others], options.frames, form.poses, meter)
            tell(*texts)
        # Scans that are made of clouds have the right frame in their headers.
        frame = "" if form.converting else options.frames.source_frame
        export = _Export(file_format, poses, report, source_frame=frame, failing=options.strict)
        export.lay_out(stream.topics, unfinished, destination, folder=folder)
        try:
            export.write(stream)
        finally:
            export.abort()
        if unfinished.is_dir():
            write_record(unfinished)
        report.notes += getattr(stream, "notes", ())
        report.damage = tuple(dict.fromkeys((*stream.damage, *(d for each in readers for d in each.damage))))
    return report


def _check_request(file_format: ExportFormat, options: ConvertOptions, form: ExportOptions) -> None:
    """Raise if an option has no effect on an export, or if one is missing."""
    if file_format.clouds and form.converting:
        raise UsageError(
            f"{file_format.name} is a format of clouds, but parameters of the projection make scans of them",
            hint="remove the parameters, or choose a format of scans: `format=npz`",
        )
    if file_format.needs_poses and not form.poses.is_requested:
        raise UsageError(
            f"{file_format.name} needs poses",
            hint="`pose_frame=odom` reads them from tf, `odom_topic=/odom` from odometry",
        )
    scan = options.scan
    idle = {
        "scans": options.scans[1:] or scan.name,
        "reverse": scan.reverse,
        "keep_used": scan.keep_used,
        "keep": options.keep,
        "drop": options.drop,
        "keep_clouds": options.keep_clouds,
        "fail_on": options.fail_on,
        "min_used": options.min_used,
        "write_static_tf": options.frames.write_static,
    }
    if given := [f"`{name}`" for name, value in idle.items() if value]:
        raise UsageError(f"{' and '.join(given)} would have no effect: no recording is written")
    frames = options.frames
    if (
        not form.converting
        and not form.poses.is_requested
        and (frames.static or frames.tf_from or frames.tf_topics or frames.source_frame)
    ):
        raise UsageError(
            "transforms would have no effect: neither poses nor scans of clouds are requested",
            hint="`pose_frame=odom` writes poses",
        )
    if not form.converting and (scan.filters or scan.remove or scan.deskew or scan.level):
        raise UsageError(
            "filters, `deskew`, `level` and `remove` have an effect only if clouds become scans",
            hint="give parameters: `preset`, `params_file`, or any of them by name, `min_height=-0.3`",
        )


def _topics(
    connections: Iterable[Any], file_format: ExportFormat, options: ConvertOptions, form: ExportOptions
) -> list[str]:
    """Return the requested topics, or all of the type."""
    requested = options.scan.topics
    if requested:
        if not form.converting and (renamed := [topic for topic in requested if topic.target]):
            raise UsageError(
                f"{renamed[0].source}:={renamed[0].target} renames a topic, but only scans that are made of clouds "
                "get a new topic",
                hint=f"`topics={renamed[0].source}`",
            )
        return [topic.source for topic in requested]
    kinds = options.scan.source_types if form.converting else CLOUDS if file_format.clouds else (LASERSCAN,)
    types: dict[str, set[str]] = {}
    for each in connections:
        types.setdefault(each.topic, set()).add(each.ros_type)
    return sorted(usual_topics(types, kinds))


def _stream(
    sources: Sequence[Path],
    names: Sequence[str],
    file_format: ExportFormat,
    options: ConvertOptions,
    form: ExportOptions,
    meter: Meter | None,
) -> Scans | Clouds:
    selection = Selection(
        paths=tuple(sources),
        topics=tuple(names),
        start=options.start,
        end=options.end,
        strict=options.strict,
        clock=options.clock,
        cloud_scale=options.cloud_scale,
    )
    if file_format.clouds:
        return Clouds(selection, meter)
    if not form.converting:
        return Scans(selection, meter=meter)
    topics = options.scan.topics or tuple(map(TopicRequest, names))
    return Scans(selection, replace(options.with_scan(topics=topics), only_scans=True), meter=meter)


def _is_folder(destination: Path, topics: Sequence[str], file_format: ExportFormat, *, in_folder: bool) -> bool:
    """Whether the files of topics are in a folder; for a format with folders: whether each topic has a subfolder."""
    if (
        len(topics) > 1
        and not in_folder
        and not file_format.folder
        and destination.suffix.lower() == file_format.suffix
    ):
        raise DestinationError(
            f"{len(topics)} topics make {len(topics)} files: {name_list(list(topics), 5)}",
            path=destination,
            hint=f"name a folder: `destination={destination.with_suffix('')}/`; or choose: `topics={topics[0]}`",
        )
    return len(topics) > 1 or (in_folder and not file_format.folder)


class _Export:
    """The writers of all topics."""

    def __init__(
        self, file_format: ExportFormat, poses: Poses | None, report: ExportReport, *, source_frame: str, failing: bool
    ) -> None:
        self._format = file_format
        self._poses = poses
        self._report = report
        self._source_frame = source_frame
        self._failing = failing
        self._entries: dict[str, ExportedTopic] = {}
        self._places: dict[str, tuple[Path, Path]] = {}
        self._writers: dict[str, TopicWriter] = {}

    def lay_out(self, topics: Sequence[str], partial: Path, final: Path, *, folder: bool) -> None:
        """Choose the path of each topic."""
        self._entries = {topic: ExportedTopic(topic) for topic in topics}
        self._report.topics += self._entries.values()
        if not folder:
            self._places = dict.fromkeys(topics, (partial, final))
            return
        suffix = "" if self._format.folder else self._format.suffix
        names = {topic: f"{name}{suffix}" for topic, name in file_names(topics).items()}
        self._places = {topic: (partial / name, final / name) for topic, name in names.items()}
        try:
            partial.mkdir()
        except OSError as err:
            raise OutputError(f"cannot be made: {err.strerror}", path=final) from err

    def write(self, stream: Scans | Clouds) -> None:
        """Write all messages."""
        report = self._report
        for item in stream:
            entry = self._entries[item.topic]
            try:
                self._add(item, entry)
            except MessageError as err:
                err.topic, err.stamp_ns = item.topic, item.stamp_ns
                reason = ""
                if self._poses is not None and isinstance(err, TransformError):
                    # Poses are never extrapolated, so the hint of a conversion does not apply.
                    err.hint = "`pc2scan tf` shows the frames of a recording and their times"
                    reason = f"no pose in {self._poses.pose_frame} at the stamp"
                if self._failing:
                    raise
                entry.skipped += 1
                skipped = Skipped(item.topic, item.log_time_ns, item.stamp_ns, err.message, err.hint or "")
                report.skip(skipped, reason)
        for skipped in stream.skipped:
            report.skip(skipped)
        if further := stream.skipped_count - len(stream.skipped):
            report.skipped_reasons["other messages that cannot be read"] += further
        if not report.messages:
            raise self._nothing(stream)
        for topic, entry in self._entries.items():
            if entry.written:
                report.warnings += (f"{topic}: {text}" for text in self._writers[topic].finish())
            else:
                self._give_up(topic)
                report.warnings.append(f"{topic}: nothing to write, so there is no file")
        report.warnings += () if self._poses is None else self._poses.doubts()

    def _give_up(self, topic: str) -> None:
        """Remove the files of a topic without a message that can be written."""
        if (writer := self._writers.pop(topic, None)) is None:
            return
        writer.abort()
        self._entries[topic].path = None
        path = self._places[topic][0]
        if path.is_dir():
            for file in path.iterdir():
                file.unlink()
            path.rmdir()
        else:
            path.unlink(missing_ok=True)

    def _add(self, item: Any, entry: ExportedTopic) -> None:
        frame = self._source_frame or item.frame
        placed = None if self._poses is None else self._poses.at(frame, item.stamp_ns)
        writer = self._writers.get(item.topic)
        if writer is None:
            partial, final = self._places[item.topic]
            writer = self._writers[item.topic] = self._format.open(partial, posed=placed is not None)
            entry.path = str(final)
        writer.add(item, placed)
        entry.written += 1
        entry.first_ns = item.stamp_ns if entry.first_ns is None else entry.first_ns
        entry.last_ns = item.stamp_ns
        if placed is not None:
            entry.pose_frame = placed.pose_frame
            entry.base_frame = frame.removeprefix("/") if self._format.clouds else placed.base_frame

    def _nothing(self, stream: Scans | Clouds) -> ResultError:
        what = "cloud" if self._format.clouds else "scan"
        reasons = self._report.skipped_reasons.most_common(1)
        if not reasons:
            return ResultError(f"no {what} to write: the topic has no messages", topic=stream.topics[0])
        total = sum(self._report.skipped_reasons.values())
        hint = next((entry.hint for entry in self._report.skipped if entry.hint), None)
        return ResultError(f"no {what} can be written; of {total:,}, {self._report.explained(reasons[0])}", hint=hint)

    def abort(self) -> None:
        """Close the open files; the files of finished writers stay."""
        for writer in self._writers.values():
            writer.abort()

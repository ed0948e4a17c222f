"""What each command does: sources and options become a result. The command line and Python's functions call these.

``warn`` is called with each warning as soon as it is known; the result has all of them. ``progress`` is called with the
work done, the work in all, and the messages read so far.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from .errors import Pc2ScanError
from .requests import OF_FRAMES, conversion_of, destination_of, first_output, frames_of, named_files, output_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from .batch.run import BatchCallbacks
    from .batch.summary import BatchReport
    from .compare.result import Difference
    from .export.report import ExportReport
    from .files.urls import PathText
    from .golden.check import Command
    from .golden.init import NewCase
    from .golden.result import CaseResult, GoldenReport
    from .inspect.check import Check
    from .inspect.info import Info
    from .inspect.tf import FrameTree
    from .look.map_result import Map
    from .look.plot import Plotted
    from .look.view import Page
    from .options.call import Options
    from .pipeline.report import Report
    from .progress import Progress
    from .requests import Warn


_Shown = TypeVar("_Shown", "Page", "Plotted", "Map")


def convert(
    sources: Sequence[Path],
    destination: PathText | None,
    options: Options,
    *,
    warn: Warn | None = None,
    progress: Progress | None = None,
) -> Report:
    """Convert a recording; see `pc2scan.convert`. A wrong option is in the report's file, too."""
    path, folder = destination_of(destination)
    output = output_of(options, folder=folder)
    try:
        if options.wrong is not None:
            raise options.wrong
        conversion = conversion_of(options, warn)
    except Pc2ScanError as err:
        from .pipeline.run import report_failure  # noqa: PLC0415
        from .result import Failure  # noqa: PLC0415

        failure = Failure([err], [str(source) for source in sources], str(path or folder or "") or None)
        report_failure(failure, sources, output, named_files(options))
        raise
    from .pipeline.run import run  # noqa: PLC0415

    return run(
        sources,
        path,
        conversion.options,
        output,
        also_read=conversion.files,
        warnings=conversion.notes,
        progress=progress,
        warn=warn,
    )


def repair(source: Path, destination: PathText | None, options: Options, *, progress: Progress | None = None) -> Report:
    """Write what can be recovered of a recording; see `pc2scan.repair`."""
    from .pipeline.options import ConvertOptions  # noqa: PLC0415
    from .pipeline.run import run  # noqa: PLC0415

    path, folder = destination_of(destination)
    asked = ConvertOptions(repair=True)
    return run([source], path, asked, output_of(options, folder=folder), progress=progress)


def batch(sources: Sequence[str], destination: Path, options: Options, watch: BatchCallbacks) -> BatchReport:
    """Convert every recording of a dataset; see `pc2scan.batch`."""
    from .batch.run import BatchOptions, run_batch  # noqa: PLC0415

    how = BatchOptions.of(options)
    return run_batch(sources, destination, options.of_conversions, how, origins=options.origins, watch=watch)


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
    from .export.run import ExportOptions, run  # noqa: PLC0415

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


def view(sources: Sequence[Path], destination: Path | None, options: Options, *, warn: Warn | None = None) -> Page:
    """Show a recording as a page, which is written if there is a destination; see `pc2scan.view`."""
    conversion = first_output(conversion_of(options, warn), "shown", warn)
    from .look.view import page_of, write_page  # noqa: PLC0415

    asked: dict[str, Any] = {"clouds": options.clouds, "at": options.at, "preset": options.preset or ""}
    # The node's heights are part of its parameters, also where a file of these does not have them.
    asked["proposed"] = not options.given.keys() & {"params", "params_file", "param", "scans"}
    if destination is None:
        return _with(page_of(sources, conversion.options, **asked, warn=warn), conversion.notes)
    page = write_page(
        sources,
        destination,
        conversion.options,
        **asked,
        overwrite=options.overwrite,
        also_read=conversion.files,
        warn=warn,
    )
    return _with(page, conversion.notes)


def plot(sources: Sequence[Path], destination: Path, options: Options, *, warn: Warn | None = None) -> Plotted:
    """Draw clouds; see `pc2scan.plot`."""
    conversion = first_output(conversion_of(options, warn), "shown", warn)
    from .look.plot import plot as draw  # noqa: PLC0415

    drawn = draw(
        sources,
        destination,
        conversion.options,
        clouds=options.clouds,
        at=options.at,
        overwrite=options.overwrite,
        also_read=conversion.files,
        warn=warn,
    )
    return _with(drawn, conversion.notes)


def map(  # noqa: A001  # the command's name
    sources: Sequence[Path],
    destination: Path | None,
    options: Options,
    *,
    write: bool = True,
    warn: Warn | None = None,
    progress: Progress | None = None,
) -> Map:
    """Draw scans into a map, which is written unless ``write`` is false; see `pc2scan.map`."""
    conversion = first_output(conversion_of(options, warn), "drawn", warn)
    from .look.map import map_of, write_map  # noqa: PLC0415
    from .look.map_drawing import MapOptions  # noqa: PLC0415

    asked = MapOptions.of(options)
    if not write:
        return _with(map_of(sources, conversion.options, asked, progress=progress, warn=warn), conversion.notes)
    drawn = write_map(
        sources,
        destination,
        conversion.options,
        asked,
        overwrite=options.overwrite,
        also_read=conversion.files,
        progress=progress,
        warn=warn,
    )
    return _with(drawn, conversion.notes)


def _with(result: _Shown, warnings: Sequence[str]) -> _Shown:
    return replace(result, warnings=(*warnings, *result.warnings))


def info(sources: Sequence[Path], options: Options) -> Info:
    """Describe a recording; see `pc2scan.info`."""
    from .inspect.info import info as look  # noqa: PLC0415

    return look(
        sources,
        described=options.topics,
        target_frame=options.target_frame,
        frames=frames_of(options),
        cloud_scale=options.cloud_scale,
        given={name: options.given[name] for name in options.given if name in {*OF_FRAMES, "cloud_scale"}},
    )


def check(sources: Sequence[Path], options: Options, *, progress: Progress | None = None) -> Check:
    """Check what consumers do with scans; see `pc2scan.check`."""
    from .inspect.check import check as look  # noqa: PLC0415

    return look(
        sources,
        consumers=options.consumers,
        topics=options.topics,
        odom_frame=options.odom_frame,
        base_frame=options.base_frame,
        echo=options.echo,
        frames=frames_of(options),
        progress=progress,
    )


def tf(sources: Sequence[Path], options: Options) -> FrameTree:
    """Read the frames of a recording; see `pc2scan.tf`."""
    from .inspect.tf import frame_tree  # noqa: PLC0415

    return frame_tree(sources, frames_of(options))


def diff(a: Path, b: Path | None, options: Options, *, progress: Progress | None = None) -> Difference:
    """Compare two recordings; see `pc2scan.diff`."""
    from .compare.diff import TopicPair  # noqa: PLC0415
    from .compare.diff import diff as compare  # noqa: PLC0415
    from .compare.rules import Rules  # noqa: PLC0415

    rules = Rules.of(options)
    pairs = [TopicPair.parse(topic) for topic in options.topics]
    return compare(a, b, topics=pairs, all_topics=options.all_topics, rules=rules, progress=progress)


def golden(
    folder: Path,
    pattern: str,
    options: Options,
    run_command: Command,
    *,
    each: Callable[[CaseResult], object] | None = None,
) -> GoldenReport:
    """Check conversions against expected outputs; see `pc2scan.golden`.

    ``each`` is called with the result of each case.
    """
    from .golden.case import case_folders  # noqa: PLC0415
    from .golden.check import check_case  # noqa: PLC0415
    from .golden.result import GoldenReport  # noqa: PLC0415

    report = GoldenReport(str(folder))
    for name, case in case_folders(folder, pattern):
        result = check_case(name, case, run_command, update=options.update)
        report.cases.append(result)
        if each is not None:
            each(result)
    return report


def new_case(folder: Path, options: Options, run_command: Command, *, progress: Progress | None = None) -> NewCase:
    """Make a golden case of a recording; see `pc2scan.golden`."""
    from .golden.init import make_case  # noqa: PLC0415

    part = {"start": options.start, "end": options.end, "topics": options.topics, "params": options.params_file}
    return make_case(folder, options.init, run_command, progress=progress, **part)

"""The functions of ``pc2scan``: each does what the command of the same name does, with the same option names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING

from .arguments import known_keywords, names_in, path_of, paths_in
from .errors import UsageError
from .pipeline.options import ConvertOptions
from .requests import (
    KEYWORDS,
    conversion_names,
    conversion_of,
    destination_of,
    first_output,
    frames_of,
    given_among,
    keywords_among,
    makes_scans,
    moments_of,
    parameter_names,
    selection_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from typing import Any

    from .arguments import PathText
    from .batch.summary import BatchReport
    from .batch.watch import BatchProgress
    from .compare.result import Difference
    from .core.params import ProjectionParams
    from .core.unproject import UnprojectParams
    from .export.report import ExportReport
    from .golden.result import GoldenReport
    from .inspect.check import Check
    from .inspect.info import Info
    from .inspect.tf import FrameTree
    from .look.map_result import Map
    from .look.plot import Plotted
    from .look.view import Page
    from .pipeline.combine.asked import Duration
    from .pipeline.options import Time
    from .pipeline.report import Report
    from .pipeline.run import Progress
    from .pipeline.stages.filters import Filter
    from .streams.clouds import Clouds
    from .streams.scans import Scans
    from .tf.options import FrameOptions, StaticTransform

__all__ = [
    "batch",
    "check",
    "clouds",
    "convert",
    "diff",
    "export",
    "golden",
    "info",
    "map",
    "plot",
    "repair",
    "scans",
    "tf",
    "view",
]

#: Names that users of the command line or of ROS may try, and the arguments that they mean.
_SYNONYMS = {
    "topic": "topics",
    "source": "sources",
    "output": "destination",
    "dst": "destination",
    "channel": "channels",
    "tf_topic": "tf_topics",
    "static": "static_tf",
    "no_verify": "verify",
    "frame": "target_frame",
    "frame_id": "target_frame",
}


#: The keywords of `convert` that functions take which show, draw or export what it would write. Like the commands,
#: they ignore those about a recording that is written, so that a call of `convert` can be shown with few changes.
_OF_A_CONVERSION = KEYWORDS - {"ros_distro"}

#: The keywords of `convert` that decide how clouds become scans, and what is read.
_OF_SCANS = _OF_A_CONVERSION - {
    *("scans", "keep", "drop", "keep_clouds", "only_scans", "keep_used", "write_static_tf", "fail_on", "min_used"),
    *("reverse", "channels", "range_cutoff", "jobs"),
}


@known_keywords(further=parameter_names, synonyms=_SYNONYMS)
def convert(
    sources: PathText | Iterable[PathText],
    destination: PathText | None = None,
    *,
    params: ProjectionParams | None = None,
    preset: str | None = None,
    params_file: PathText | None = None,
    node: str | None = None,
    launch_args: str | Iterable[str] = (),
    param: str | Iterable[str] = (),
    remap: str | Iterable[str] = (),
    scans: PathText | Mapping[str, Any] | Sequence[Any] | None = None,
    topics: str | Iterable[str] = (),
    keep: str | Iterable[str] = (),
    drop: str | Iterable[str] = (),
    keep_clouds: bool = False,
    only_scans: bool = False,
    start: Time | None = None,
    end: Time | None = None,
    static_tf: str | StaticTransform | Iterable[str | StaticTransform] = (),
    static_tf_file: PathText | None = None,
    write_static_tf: bool = False,
    tf_from: PathText | Iterable[PathText] = (),
    tf_topics: str | Iterable[str] = (),
    source_frame: str = "",
    frames: FrameOptions | None = None,
    where: str | Iterable[str] = (),
    exclude_box: str | Iterable[str] = (),
    exclude_polygon: str | Iterable[str] = (),
    min_height_slope: float | None = None,
    ground: str = "keep",
    filters: Iterable[Filter] = (),
    remove: str | Iterable[str] = (),
    keep_used: str = "",
    reverse: bool = False,
    deskew: bool = False,
    fixed_frame: str = "",
    point_time: str = "",
    stamp: str = "header",
    level: bool = False,
    imu: str = "",
    lead: str = "",
    window: Duration | None = None,
    accumulate: Duration | None = None,
    every: Duration | None = None,
    rebin: bool = False,
    channels: str | Iterable[str] | UnprojectParams | None = None,
    range_cutoff: float | None = None,
    on_error: str = "skip",
    fail_on: str = "",
    min_used: float = 0.0,
    storage: str | None = None,
    compression: str | None = None,
    profile: str | None = None,
    metadata_version: int = 8,
    ros_distro: str = "",
    to: str | None = None,
    split: str | None = None,
    repeat_latched: bool = False,
    scratch: PathText | None = None,
    scratch_size: str | None = None,
    overwrite: bool = False,
    report: PathText | None = None,
    dry_run: bool = False,
    jobs: int = 0,
    verify: bool = True,
    strict: bool = False,
    progress: Progress | None = None,
    **parameters: Any,
) -> Report:
    """Convert recorded PointCloud2 to LaserScan, or back, as ``pc2scan convert`` does.

    Parameters
    ----------
    sources
        A recording: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``; or its URL. Several are read as one recording.
    destination
        ``*.bag``: a ROS 1 bag; ``*.mcap``: an MCAP file; text that ends with a slash: a folder, in which the
        destination is named after the first source; any other name: a rosbag2 directory. Default: next to the first
        source, in its format, with ``_scan`` in its name.
    params
        The parameters of the projection, instead of ``preset`` and ``params_file``. Default: upstream's defaults.
    preset
        The name of a consumer of the scans, such as ``slam_toolbox``: the parameters that suit it.
    params_file, node, launch_args
        A ROS parameter file or an XML launch file, the node whose parameters are read from it, and the launch file's
        arguments, ``name:=value``. They override ``preset``.
    param, remap
        Parameters and remappings in ROS's notation: ``range_max:=30``; ``["cloud_in:=/points", "scan:=/flat"]``.
    scans
        Several outputs, each with its own sources, parameters and options: a YAML or JSON file, or the content of such
        a file: ``{"/scan": {"min_height": 0.1}, "/low": {"max_height": 0.1}}``. Parameters by name override those of
        all outputs. Other arguments that an output may have cannot be given besides.
    topics
        The topics to convert, as ``/points`` or ``/points:=/scan``. Default: every PointCloud2 topic.
    keep, drop
        Names or globs of the topics that are not converted: write only these; do not write these.
    keep_clouds, only_scans
        Write the converted clouds too; write nothing but the scans.
    start, end
        Convert only messages with log times from ``start`` on and before ``end``. A number: seconds from the beginning;
        from 100,000,000 on, seconds since 1970; whole numbers from 100,000,000,000 on, nanoseconds since 1970. Or a
        ``datetime`` with a time zone, a ``numpy.datetime64`` (UTC), a ``timedelta`` from the beginning, or text as on
        the command line. Messages that are latched at ``start``, and static transforms, are written there.
    static_tf, static_tf_file, write_static_tf
        Static transforms to add, as `StaticTransform` or as text, ``parent child x y z roll pitch yaw``; a YAML file
        with such transforms; whether they are written to ``/tf_static`` of the destination.
    tf_from, tf_topics
        Further recordings to read transforms from; the topics of the transforms, if not ``/tf`` and ``/tf_static``.
    source_frame
        The frame of the messages to convert, if their own ``frame_id`` is wrong or empty.
    frames
        All of these arguments about frames in one object.
    where, exclude_box, exclude_polygon, min_height_slope, ground
        Filters of points. Used are points whose fields fulfil all conditions (``ring in (3, 4) or intensity > 9``).
        Rejected are points in boxes (``frame x0 x1 y0 y1 z0 z1``), points in polygons
        (``frame x0 y0 x1 y1 x2 y2 ...``), points below ``min_height + min_height_slope * range`` and, with
        ``ground="remove"``, points on the ground.
    filters
        Further filters, as objects.
    remove
        Beams to remove from scans: ``shadows`` (mixed pixels) or ``speckles``, also with the parameters of
        laser_filters, ``"shadows window=2"`` or ``"speckles filter_window=3"``; or several of these.
    keep_used
        A topic to which the points that the scans' beams read are written: PointCloud2 with all of their fields and the
        beam's index. For a scan of several messages: where they were projected, with the fields that all messages have,
        and the index of the source topic.
    reverse
        Convert LaserScan to PointCloud2.
    deskew, fixed_frame, point_time, stamp
        Transform each point (with ``reverse``, each beam) by the pose at its own time. For clouds: a frame that does
        not move, such as ``odom``; the field with the times of points and its unit, as ``t:ns``; and which time becomes
        the scan's stamp: ``header``, ``start``, ``middle`` or ``end``.
    level, imu
        Make scans in a frame without the roll and pitch of the target frame. The direction of up comes from
        ``fixed_frame``, whose z axis points up, or from an IMU, ``/imu/data`` (``/imu/data:imu_link`` if its messages
        have a wrong frame or none).
    lead, window
        When several topics become one scan (``["/front:=/scan", "/rear:=/scan"]``): the topic whose stamps the scan
        has, by default the first; and the maximum difference to the stamps of the others, by default half the median
        period. Times are seconds, text with a unit, or a ``timedelta``.
    accumulate, every
        Use all points of the last seconds, or of the last clouds (``"10clouds"``), in each scan; make a scan once in
        this many seconds, instead of one for each cloud. ``fixed_frame`` compensates the robot's motion in this time.
    rebin
        Convert LaserScan to LaserScan: with other beams, in another frame, or several in one.
    channels, range_cutoff
        With ``reverse``: further fields of the clouds (``distances``, ``stamps``, ``viewpoint``), or all parameters as
        `UnprojectParams`; keep only returns nearer than ``range_cutoff``, in metres.
    on_error
        If a message cannot be converted: ``skip`` counts and lists it, ``fail`` raises an error.
    fail_on, min_used
        Fail if a scan has no return (``empty``), or for any warning (``warning``); fail if less than this share of a
        topic's points, 0 to 1, is in its scans.
    storage, compression, profile, metadata_version, to
        The format of the destination. Default: that of its name, or of the source.
    split, repeat_latched
        Write several files, each with a duration of log time (``60s``, ``10min``) or a size of messages before
        compression (``500MB``, ``1GiB``); repeat latched messages and static transforms at the beginning of each file.
        ``files`` of the report lists the files.
    ros_distro
        The ROS distribution whose message definitions are used if the recording has none.
    scratch, scratch_size
        The folder for local copies of recordings at URLs, and how much space they may take, as ``"20GB"``.
    overwrite
        Replace an existing destination, and an existing file at the report's path.
    report
        A file to write the report to, as JSON.
    dry_run
        Write nothing, not even the report. Numbers of messages and bytes are estimates then.
    jobs
        Number of threads; 0 means one for each core. The output does not depend on it.
    verify
        Check the CRCs of MCAP files.
    strict
        Raise an error if a source is damaged. Otherwise everything readable is recovered.
    progress
        Called from time to time with bytes read, bytes in total, and messages read.
    **parameters
        Parameters of the projection by name, as in `ProjectionParams`: ``min_height=-0.3``. They override
        ``params_file``, ``preset`` and ``params``.

    Returns
    -------
    Report
        Counts of messages and points, warnings and damage; ``print`` shows them as tables.

    Raises
    ------
    UsageError
        If an argument is wrong, contradicts another one, or does not fit the sources or the destination.
    RecordingError
        If a source cannot be read.
    DamageError
        With ``strict``, if a source is damaged.
    OutputError
        If the destination cannot be written.
    ResultError
        If no message was converted, or the result does not meet ``fail_on`` or ``min_used``.
    MessageError
        If ``on_error`` is ``fail`` and a message cannot be converted. After any error the destination is unchanged.

    Examples
    --------
    >>> import pc2scan
    >>> report = pc2scan.convert(
    ...     "drive.bag", "scans.mcap", preset="slam_toolbox", min_height=-0.5, max_height=1.0
    ... )  # doctest: +SKIP
    >>> report.exit_status  # doctest: +SKIP
    0
    """
    notes: list[str] = []
    asked = conversion_of(keywords_among(locals()), note=notes.append)
    from .pipeline.run import OutputOptions, run, scratch_bytes  # noqa: PLC0415

    cut = None
    if split is not None or repeat_latched:
        from .pipeline.parts import cut_of  # noqa: PLC0415  # most recordings are one file

        cut = cut_of(split, repeat_latched=repeat_latched)
    path, folder = destination_of(destination)
    output = OutputOptions(
        storage=storage,
        compression=compression,
        profile=profile,
        metadata_version=metadata_version,
        overwrite=overwrite,
        folder=folder,
        to=to,
        dry_run=dry_run,
        cut=cut,
        report=None if report is None else path_of("report", report),
        scratch=None if scratch is None else path_of("scratch", scratch),
        scratch_size=scratch_bytes(scratch_size),
    )
    done = run(paths_in("sources", sources), path, asked.options, output, also_read=asked.files, progress=progress)
    done.warnings += notes
    return done


def _batch_keywords() -> Iterable[str]:
    """Return the keywords of conversions that `batch` takes."""
    from .batch.request import all_keywords  # noqa: PLC0415

    return all_keywords()


@known_keywords(further=_batch_keywords, synonyms=_SYNONYMS)
def batch(
    sources: PathText | Iterable[PathText],
    destination: PathText,
    *,
    dataset: PathText | None = None,
    jobs: int = 0,
    retries: int = 1,
    force: bool = False,
    checksum: bool = False,
    fail_fast: bool = False,
    dry_run: bool = False,
    dask: bool | str = False,
    scratch: PathText | None = None,
    scratch_size: str | None = None,
    report: PathText | None = None,
    progress: Callable[[BatchProgress], None] | None = None,
    **keywords: Any,
) -> BatchReport:
    """Convert every recording of a dataset by itself, in several processes, as ``pc2scan batch`` does.

    Parameters
    ----------
    sources
        Folders, which are searched; recordings; globs; text files with one path per line. Recordings are recognised by
        content. Any of these may be a URL (``s3://``, ``gs://``, ``az://``; single files at ``https://``).
    destination
        The folder for the results, in the same subfolders as the sources, and for ``manifest.jsonl``. A second call
        converts only recordings whose results are missing, out of date or failed. It may be a URL.
    dataset
        A dataset file, with options for some recordings or all. Options of the call override it.
    jobs
        Number of recordings converted at a time; 0: one for each core, as far as the memory is enough. The outputs do
        not depend on it.
    retries
        How often a recording is tried again if its process died: up to 100 times.
    force
        Convert recordings again whose results are up to date.
    checksum
        Recognise unchanged recordings by their SHA-256, not by their time of modification.
    fail_fast
        End the run when the first recording fails.
    dry_run
        Write nothing. Outcomes are forecasts then, and sizes and times are estimates.
    dask
        The address of a Dask scheduler whose cluster converts, ``tcp://scheduler:8786``; True: start a cluster on this
        machine. Needs ``pc2scan[dask]``. With True, a script needs ``if __name__ == "__main__"``.
    scratch, scratch_size
        The folder for local copies of recordings at URLs, and the space that all copies together may take. With the
        address of a Dask scheduler, each worker has its own folder with this much space.
    report
        A file to write the summary to: ``.json``, ``.csv`` or ``.md``.
    progress
        Called from time to time with the progress.
    **keywords
        Options of `pc2scan.convert`, except those of a single run, and parameters of the projection. With ``export``
        (``npz``, ``csv``, ...), scans or clouds are exported as by `pc2scan.export`, to one folder for each recording;
        ``pose_frame``, ``base_frame`` and ``odom_topic`` are as for that function.

    Returns
    -------
    BatchReport
        The outcome of each recording; ``print`` shows it as a table. A recording that fails does not raise.

    Raises
    ------
    UsageError
        If an option is wrong, for any recording. Nothing was converted then.
    OutputError
        If the folder or its manifest cannot be written.

    Examples
    --------
    >>> import pc2scan
    >>> result = pc2scan.batch("recordings/", "scans/", preset="slam_toolbox")  # doctest: +SKIP
    >>> result.counts  # doctest: +SKIP
    {'failed': 2, 'converted': 998}
    """
    from .batch.options import BatchOptions  # noqa: PLC0415
    from .batch.run import run_batch  # noqa: PLC0415
    from .batch.watch import Watch  # noqa: PLC0415
    from .pipeline.run import scratch_bytes  # noqa: PLC0415

    options = BatchOptions(
        dataset=None if dataset is None else path_of("dataset", dataset),
        jobs=jobs,
        retries=retries,
        checksum=checksum,
        force=force,
        fail_fast=fail_fast,
        dry_run=dry_run,
        dask=dask,
        report=None if report is None else path_of("report", report),
        scratch=None if scratch is None else path_of("scratch", scratch),
        scratch_size=scratch_bytes(scratch_size),
    )
    watch = Watch() if progress is None else Watch(progress=progress)
    names = [str(path) for path in paths_in("sources", sources)]
    return run_batch(names, path_of("destination", destination), keywords, options, watch=watch)


@known_keywords(synonyms=_SYNONYMS)
def repair(
    source: PathText,
    destination: PathText | None = None,
    *,
    storage: str | None = None,
    compression: str | None = None,
    overwrite: bool = False,
    report: PathText | None = None,
    verify: bool = True,
    progress: Progress | None = None,
) -> Report:
    """Write everything that can be recovered from a damaged recording to a new one, as ``pc2scan repair`` does.

    Parameters
    ----------
    source
        A recording, damaged or not. It is not changed. Its messages are copied byte for byte.
    destination
        As for `pc2scan.convert`. Default: next to the source, in its format, with ``_repaired`` in its name.
    storage, compression
        The format of the destination. Default: that of the source.
    overwrite, report, verify, progress
        As for `pc2scan.convert`.

    Returns
    -------
    Report
        ``damage`` lists the damage; ``exit_status`` is 0 if there is none, else 3.

    Raises
    ------
    UsageError
        If the destination exists or is not possible.
    RecordingError
        If nothing of the source can be read.
    OutputError
        If the destination cannot be written.
    """
    from .pipeline.run import OutputOptions, run  # noqa: PLC0415

    path, folder = destination_of(destination)
    output = OutputOptions(
        storage=storage,
        compression=compression,
        overwrite=overwrite,
        report=None if report is None else path_of("report", report),
        folder=folder,
    )
    return run(
        [path_of("source", source)],
        path,
        ConvertOptions(repair=True, verify=verify),
        output,
        progress=progress,
    )


@known_keywords(synonyms=_SYNONYMS)
def info(
    sources: PathText | Iterable[PathText],
    *,
    samples: int = 10,
    target_frame: str = "",
    static_tf: str | StaticTransform | Iterable[str | StaticTransform] = (),
    tf_from: PathText | Iterable[PathText] = (),
    tf_topics: str | Iterable[str] = (),
    source_frame: str = "",
    frames: FrameOptions | None = None,
) -> Info:
    """Describe a recording, as ``pc2scan info`` does: its container, topics, clouds and scans.

    Parameters
    ----------
    sources
        A recording, or several that are read as one.
    samples
        Number of clouds and scans to read from each topic, evenly spread over the recording.
    target_frame
        The frame in which heights are shown, as for conversions. Default: the clouds' own frames.
    static_tf, tf_from, tf_topics, source_frame, frames
        As for `pc2scan.convert`.

    Returns
    -------
    Info
        The description; ``print`` shows it as tables.

    Raises
    ------
    UsageError
        If ``samples`` is not 1 or more.
    RecordingError
        If a source cannot be read.
    """
    from .inspect.info import info as look  # noqa: PLC0415

    if samples < 1:
        raise UsageError(f"`samples` is {samples}, it must be 1 or more")
    return look(
        paths_in("sources", sources),
        samples=samples,
        target_frame=target_frame,
        frames=frames_of(frames, static_tf, tf_from=tf_from, tf_topics=tf_topics, source_frame=source_frame),
    )


@known_keywords(further=conversion_names, synonyms=_SYNONYMS, like=convert, shared=_OF_A_CONVERSION)
def view(
    sources: PathText | Iterable[PathText],
    *,
    clouds: int = 10,
    at: Time | Iterable[Time] = (),
    **keywords: Any,
) -> Page:
    """Show a recording as an HTML page, as ``pc2scan view`` does: its clouds, and their scans with tunable parameters.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    clouds
        Number of clouds of each topic on the page, up to 1,000, evenly spread over the recording.
    at
        A time, or several, whose clouds are shown instead; in the forms of ``start``.
    **keywords
        Options of `pc2scan.convert`, and parameters of the projection. Those about the recording that is written have
        no effect. Of several outputs, the first is shown.

    Returns
    -------
    Page
        The page. Notebooks show it in a cell; ``save`` writes it to a file.

    Raises
    ------
    UsageError
        If the request contradicts itself or the recording.
    RecordingError
        If a source cannot be read, or nothing of it can be shown.

    Examples
    --------
    >>> import pc2scan
    >>> pc2scan.view("drive.bag", preset="slam_toolbox", min_height=-0.3).save("page.html")  # doctest: +SKIP
    """
    notes: list[str] = []
    options = first_output(conversion_of(keywords, note=notes.append).options, "shown", notes.append)
    from .cli.command_line import convert_words  # noqa: PLC0415
    from .look.view import page_of  # noqa: PLC0415

    paths = paths_in("sources", sources)
    page = page_of(
        paths,
        options,
        clouds=clouds,
        at=moments_of(at),
        preset=keywords.get("preset") or "",
        command=convert_words(paths, options, "scans.mcap"),
    )
    return replace(page, notes=(*notes, *page.notes))


@known_keywords(further=conversion_names, synonyms=_SYNONYMS, like=convert, shared=_OF_A_CONVERSION)
def plot(
    sources: PathText | Iterable[PathText],
    destination: PathText,
    *,
    clouds: int = 1,
    at: Time | Iterable[Time] = (),
    overwrite: bool = False,
    **keywords: Any,
) -> Plotted:
    """Draw clouds from above and from the side, with the heights and the scan, as ``pc2scan plot`` does.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    destination
        The figure: ``.png``, ``.svg`` or ``.pdf``. Needs ``pc2scan[plot]``.
    clouds
        Number of clouds of each topic, side by side, evenly spread over the recording.
    at
        A time, or several, whose clouds are drawn instead; in the forms of ``start``.
    overwrite
        Replace an existing file.
    **keywords
        Options of `pc2scan.convert`, and parameters of the projection. Those about the recording that is written have
        no effect. Of several outputs, the first is drawn.

    Returns
    -------
    Plotted
        Notes about what is drawn, and the damage in the parts of the recording that were read.

    Raises
    ------
    UsageError
        If the request contradicts itself or the recording, or matplotlib is not installed.
    DestinationError, OutputError
        If the file exists or cannot be written.
    RecordingError
        If a source cannot be read, or no cloud of it can be drawn.

    Examples
    --------
    >>> import pc2scan
    >>> pc2scan.plot("drive.bag", "figure.png", preset="slam_toolbox", min_height=-0.3)  # doctest: +SKIP
    """
    notes: list[str] = []
    options = first_output(conversion_of(keywords, note=notes.append).options, "shown", notes.append)
    from .look.plot import plot as draw  # noqa: PLC0415

    drawn = draw(
        paths_in("sources", sources),
        path_of("destination", destination),
        options,
        clouds=clouds,
        at=moments_of(at),
        overwrite=overwrite,
    )
    return drawn._replace(notes=[*notes, *drawn.notes])


@known_keywords(further=conversion_names, synonyms=_SYNONYMS, like=convert, shared=_OF_A_CONVERSION)
def map(  # noqa: A001  # the command's name
    sources: PathText | Iterable[PathText],
    *,
    odom_frame: str = "odom",
    base_frame: str = "",
    resolution: float = 0.05,
    max_range: float | None = None,
    clear_to: float = 0.0,
    progress: Progress | None = None,
    **keywords: Any,
) -> Map:
    """Draw the scans of a recording into a map by its recorded odometry, as ``pc2scan map`` does.

    This is a preview, not SLAM: no scans are matched, and no poses corrected. It shows whether heights, mounting,
    stamps and odometry fit together. A scan has the pose at its stamp; with a ``time_increment``, each beam has the
    pose at its own time.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    odom_frame
        The frame of the map, in which the robot moves.
    base_frame
        The robot's frame, whose path is shown. Default: ``base_link``, or ``base_footprint`` if that does not exist.
    resolution
        The side of a cell, in metres.
    max_range
        Returns beyond this range clear cells up to it, and mark none; metres. Default: no limit.
    clear_to
        The range up to which beams without a return clear cells, in metres. Default: such beams are ignored, as in
        gmapping and slam_toolbox.
    progress
        As for `pc2scan.convert`.
    **keywords
        Options of `pc2scan.convert`, and parameters of the projection. Those about the recording that is written have
        no effect. ``topics`` are LaserScan or PointCloud2 topics; by default all scans, or all clouds if there are no
        scans, or if an option is given that converts clouds. Of several outputs, the first is drawn.

    Returns
    -------
    Map
        The map: ``cells`` is an array, ``save`` writes files for map_server. Notebooks show its picture.

    Raises
    ------
    UsageError
        If an argument is wrong or does not fit the recording, a frame does not exist, or the map would be too large.
    RecordingError
        If a source cannot be read.
    ResultError
        If no scan has a pose, or none has a return.

    Examples
    --------
    >>> import pc2scan
    >>> pc2scan.map("drive.bag", min_height=0.1, max_height=1.5).save("map.yaml")  # doctest: +SKIP
    """
    notes: list[str] = []
    options = first_output(conversion_of(keywords, note=notes.append).options, "drawn", notes.append)
    import math  # noqa: PLC0415

    from .look.map import map_of  # noqa: PLC0415
    from .look.map_options import MapOptions  # noqa: PLC0415

    asked = MapOptions(
        odom_frame=odom_frame,
        base_frame=base_frame,
        resolution=resolution,
        max_range=math.inf if max_range is None else max_range,
        clear_to=clear_to,
    )
    made = map_of(paths_in("sources", sources), options, asked, progress=progress)
    return replace(made, notes=(*notes, *made.notes))


@known_keywords(synonyms={**_SYNONYMS, "for": "consumers", "consumer": "consumers"})
def check(
    sources: PathText | Iterable[PathText],
    *,
    consumers: str | Iterable[str] = (),
    topics: str | Iterable[str] = (),
    odom_frame: str = "odom",
    base_frame: str = "",
    tf_from: PathText | Iterable[PathText] = (),
    tf_topics: str | Iterable[str] = (),
    frames: FrameOptions | None = None,
) -> Check:
    """Check whether SLAM and navigation would accept the scans of a recording, as ``pc2scan check`` does.

    Parameters
    ----------
    sources
        A recording, or several that are read as one.
    consumers
        The consumers whose verdicts decide the exit status: ``slam_toolbox``, ``cartographer``, ``gmapping``, ``amcl``,
        ``nav2``, ``mrpt``. Default: all of them, and defects of the scans. All are reported in any case.
    topics
        LaserScan topics to check. Default: all.
    odom_frame, base_frame
        The frames that the scans' frames must be connected with. An empty ``base_frame`` means ``base_link``, or
        ``base_footprint`` if that does not exist.
    tf_from, tf_topics
        Further recordings to read transforms from; the topics of the transforms, if not ``/tf`` and ``/tf_static``.
    frames
        Both of these in one object.

    Returns
    -------
    Check
        The verdicts: ``exit_status`` is 0 if all are good; ``print`` shows the reasons if not.

    Raises
    ------
    UsageError
        If a consumer or a topic does not exist, or if several namespaces have transforms and ``tf_topics`` is empty.
    RecordingError
        If a source cannot be read.
    """
    from .inspect.check import check as look  # noqa: PLC0415

    return look(
        paths_in("sources", sources),
        consumers=names_in("consumers", consumers),
        topics=names_in("topics", topics),
        odom_frame=odom_frame,
        base_frame=base_frame,
        frames=frames_of(frames, tf_from=tf_from, tf_topics=tf_topics),
    )


@known_keywords(synonyms=_SYNONYMS)
def tf(
    sources: PathText | Iterable[PathText],
    *,
    tf_topics: str | Iterable[str] = (),
    static_tf: str | StaticTransform | Iterable[str | StaticTransform] = (),
) -> FrameTree:
    """Read the frames of a recording, as ``pc2scan tf`` does.

    Parameters
    ----------
    sources
        A recording, or several, whose transforms are read together.
    tf_topics
        The topics of the transforms, if not ``/tf`` and ``/tf_static``.
    static_tf
        Transforms to add, as `StaticTransform` or as text: ``parent child x y z roll pitch yaw``.

    Returns
    -------
    FrameTree
        The frames; its ``lookup`` returns the transform between two of them.

    Raises
    ------
    RecordingError
        If a source cannot be read.
    UsageError
        If several namespaces have transforms and ``tf_topics`` is empty.
    """
    from .inspect.tf import frame_tree  # noqa: PLC0415

    return frame_tree(paths_in("sources", sources), frames_of(None, static_tf, tf_topics=tf_topics))


@known_keywords(synonyms={**_SYNONYMS, "k": "pattern", "dir": "folder"})
def golden(
    folder: PathText,
    pattern: str = "",
    *,
    update: bool = False,
    init: PathText | None = None,
    start: Time | None = None,
    end: Time | None = None,
    topics: str | Iterable[str] = (),
    params_file: PathText | None = None,
) -> GoldenReport:
    """Compare the outputs of conversions with expected ones (golden cases), as ``pc2scan golden`` does.

    Parameters
    ----------
    folder
        A folder of cases, or one case.
    pattern
        Check only cases whose names contain this text, or match this glob.
    update
        Write the expected output of cases that differ or have none.
    init
        A recording from which a new case is made first. The new case is ``folder``, which must not exist.
    start, end, topics, params_file
        With ``init``: the part of the recording, the topics of clouds and scans (default: all), and the parameter file.

    Returns
    -------
    GoldenReport
        The result of each case; ``exit_status`` is 0 if all are as expected.

    Raises
    ------
    UsageError
        If the folder does not exist or has no case.

    Notes
    -----
    While a case runs, the output of this process is captured, and on SIGTERM temporary files are removed first.
    """
    from .cli.in_process import run_command  # noqa: PLC0415
    from .golden.case import case_folders  # noqa: PLC0415
    from .golden.check import check_case  # noqa: PLC0415
    from .golden.result import GoldenReport  # noqa: PLC0415

    path = path_of("folder", folder)
    if init is not None:
        from .golden.init import make_case  # noqa: PLC0415

        params = None if params_file is None else path_of("params_file", params_file)
        source, chosen = path_of("init", init), names_in("topics", topics)
        make_case(path, source, run_command, start=start, end=end, topics=chosen, params=params)
    elif start is not None or end is not None or topics or params_file is not None:
        raise UsageError("`start`, `end`, `topics` and `params_file` have no effect without init=SRC")
    report = GoldenReport(str(path))
    for name, case in case_folders(path, pattern):
        report.cases.append(check_case(name, case, run_command, update=update))
    return report


@known_keywords(synonyms=_SYNONYMS)
def diff(
    a: PathText,
    b: PathText | None = None,
    *,
    topics: str | Iterable[str] = (),
    all_topics: bool = False,
    atol: float | Mapping[str, float] = 0.0,
    rtol: float | Mapping[str, float] = 0.0,
    allow_beams: float = 0.0,
    ignore: str | Iterable[str] = (),
    explain: bool = False,
    clouds: PathText | None = None,
    view: PathText | None = None,
) -> Difference:
    """Compare the scans and clouds of two recordings, as ``pc2scan diff`` does.

    Parameters
    ----------
    a, b
        The recordings; ``a`` is the reference. ``b`` is ``a`` by default, to compare two topics of one recording.
    topics
        The topics to compare, as ``/scan`` or ``/scan:=/scan2``. Default: every LaserScan and PointCloud2 topic.
    all_topics
        Compare the other topics too: their messages are matched by log time, and compared byte for byte.
    atol, rtol
        Absolute tolerance, and tolerance relative to the value in ``a``. Their sum is allowed. A number applies to all
        values; a mapping has numbers for ``ranges``, ``intensities`` or fields of the clouds.
    allow_beams
        The share of a topic's beams (clouds: points) that may exceed the tolerance, 0 to 1.
    ignore
        Properties that are not compared: ``log_time``, ``seq``, ``frame_id``, ``order``, ``intensities``, ``ranges``,
        ``angle_min`` and the other numbers of a scan, ``shape``, ``layout``, ``padding``, ``is_dense``.
    explain
        Count the differing beams that another libm explains; see ``libm`` of each topic.
    clouds
        The recording with the clouds from which the scans were made. Default: ``a``; if it has none, ``b``. If it is
        given, ``explain`` is on.
    view
        A page to write, which shows the scans with most differing beams on top of each other.

    Returns
    -------
    Difference
        The differences: ``same`` is true if there are none; ``print`` shows what the command prints.

    Raises
    ------
    UsageError
        If a topic does not exist, there is nothing to compare, or a tolerance or another rule is wrong.
    RecordingError
        If a recording cannot be read.

    Examples
    --------
    >>> import pc2scan
    >>> found = pc2scan.diff("expected.bag", "scans.mcap", rtol=1e-5)  # doctest: +SKIP
    >>> assert found.same, found  # doctest: +SKIP
    """
    from .compare.diff import TopicPair  # noqa: PLC0415
    from .compare.diff import diff as compare  # noqa: PLC0415
    from .compare.rules import Rules  # noqa: PLC0415
    from .tf.reading import recorded_transforms  # noqa: PLC0415

    for name, tolerance in (("atol", atol), ("rtol", rtol)):
        numbers = tolerance.values() if isinstance(tolerance, Mapping) else (tolerance,)
        if not all(isinstance(number, Real) and not isinstance(number, bool) for number in numbers):
            raise TypeError(f"{name} is {tolerance!r}, it must be a number, or a dict of numbers")
    rules = Rules(
        atol=atol if isinstance(atol, Mapping) else {"": atol},
        rtol=rtol if isinstance(rtol, Mapping) else {"": rtol},
        allow_beams=allow_beams,
        ignore=frozenset(names_in("ignore", ignore)),
    )
    pairs = [TopicPair.parse(topic) for topic in names_in("topics", topics)]
    first, second = path_of("a", a), None if b is None else path_of("b", b)
    found = compare(
        first,
        second,
        topics=pairs,
        all_topics=all_topics,
        rules=rules,
        transforms_of=recorded_transforms if explain or clouds is not None else None,
        clouds=None if clouds is None else path_of("clouds", clouds),
    )
    if view is not None:
        from .look.compared import compared_view  # noqa: PLC0415

        page = path_of("view", view)
        compared_view(first, second or first, page, topics=pairs, rules=rules, summary=str(found))
    return found


@known_keywords(further=conversion_names, synonyms=_SYNONYMS, like=convert, shared=_OF_A_CONVERSION)
def export(
    sources: PathText | Iterable[PathText],
    destination: PathText,
    *,
    format: str | None = None,  # noqa: A002  # the command's name for it
    pose_frame: str = "",
    base_frame: str = "",
    odom_topic: str = "",
    overwrite: bool = False,
    progress: Progress | None = None,
    **keywords: Any,
) -> ExportReport:
    """Write scans with poses, trajectories or clouds for learning and evaluation, as ``pc2scan export`` does.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    destination
        A file; a folder for several topics and for clouds, or if the text ends with a slash. The folder is created.
    format
        ``npz``, ``csv``, ``tum``, ``carmen``, ``flaser``, ``pcd`` or ``kitti``. Default: by the file's suffix.
    pose_frame
        Write the robot's pose in this frame, such as ``odom``, at the stamp of each message, from the transforms.
        Messages without a transform at their stamp are skipped.
    base_frame
        The frame whose pose is written. Default: ``base_link`` or ``base_footprint`` if it lies between ``pose_frame``
        and the message's frame; otherwise the highest frame in the tree that does not move relative to the message's
        frame.
    odom_topic
        Take the poses from this nav_msgs/Odometry topic instead.
    overwrite
        Replace an existing destination: a file, or a folder that has only an export in this format.
    progress
        As for `pc2scan.convert`.
    **keywords
        Options of `pc2scan.convert`, and parameters of the projection: any of these means that scans are made from
        clouds. Options about transforms are also used for poses. Without ``topics``, all LaserScan topics are exported;
        if clouds are exported or converted, all PointCloud2 topics. ``on_error`` is about messages that cannot be
        written. Options about a recording that is written are refused.

    Returns
    -------
    ExportReport
        Counts of written and skipped messages; ``print`` shows them as a table.

    Raises
    ------
    UsageError
        If an argument is wrong or does not fit the recording, or the format cannot hold the data.
    RecordingError
        If a source cannot be read.
    DamageError
        With ``strict``, if a source is damaged.
    OutputError
        If the destination cannot be written.
    ResultError
        If no message could be written.
    MessageError
        If ``on_error`` is ``fail`` and a message cannot be written. After any error nothing is written.

    Examples
    --------
    >>> import pc2scan
    >>> pc2scan.export("drive.bag", "scans.npz", pose_frame="odom")  # doctest: +SKIP
    >>> pc2scan.export("drive.bag", "scans.csv", preset="slam_toolbox", min_height=-0.3)  # doctest: +SKIP
    """
    notes: list[str] = []
    asked = conversion_of(keywords, note=notes.append)
    from .export.poses import PoseOptions  # noqa: PLC0415
    from .export.run import ExportOptions, run  # noqa: PLC0415

    converting = makes_scans(keywords) or asked.options.scan.may_combine
    path, folder = destination_of(destination)
    poses = PoseOptions(pose_frame=pose_frame, base_frame=base_frame, odom_topic=odom_topic)
    place = path if path is not None else folder
    assert place is not None
    done = run(
        paths_in("sources", sources),
        place,
        asked.options,
        ExportOptions(format=format, poses=poses, converting=converting, overwrite=overwrite),
        in_folder=path is None,
        also_read=asked.files,
        progress=progress,
    )
    done.warnings += notes
    return done


@known_keywords(further=parameter_names, synonyms=_SYNONYMS, like=convert, shared=_OF_SCANS)
def scans(
    sources: PathText | Iterable[PathText],
    topics: str | Iterable[str] = (),
    *,
    start: Time | None = None,
    end: Time | None = None,
    on_error: str = "skip",
    verify: bool = True,
    strict: bool = False,
    **keywords: Any,
) -> Scans:
    """Iterate over the scans of a recording, or convert its clouds and iterate over the resulting scans.

    Scans are read one by one during the loop, in the order of log time, so memory use stays small. With ``params``,
    ``preset``, ``params_file`` or any parameter of the projection, clouds are converted instead, without writing a
    file. The scans are identical to those that `pc2scan.convert` writes.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    topics
        A topic, or several; for clouds also as ``/points:=/scan``. Default: the only one in the recording.
    start, end, verify, strict
        As for `pc2scan.convert`. Recovered damage is reported as a `pc2scan.errors.RecordingWarning`.
    on_error
        If a message cannot be used: ``skip`` counts and lists it, and issues a warning; ``fail`` raises
        an error.

    **keywords
        Options of `pc2scan.convert` that decide how clouds become scans, and parameters of the projection. Topics that
        share a target become one scan.

    Returns
    -------
    Scans
        An iterable; each loop begins at the start. ``to_xarray`` and ``to_dataframe`` make one table of all scans.

    Raises
    ------
    UsageError
        If an argument is wrong or does not fit the recording, or if a topic is missing or needed.
    RecordingError
        If a source cannot be read.
    DamageError
        With ``strict``, if a source is damaged.
    MessageError
        If ``on_error`` is ``fail`` and a message cannot be used. Raised in the loop.

    Examples
    --------
    >>> import pc2scan
    >>> for scan in pc2scan.scans("scans.mcap"):  # doctest: +SKIP
    ...     print(scan.stamp, scan.ranges.min(), scan.xy().shape)
    >>> for scan in pc2scan.scans("drive.bag", preset="slam_toolbox", min_height=-0.5):  # doctest: +SKIP
    ...     print(scan)
    """
    from .streams.scans import Scans  # noqa: PLC0415

    names = names_in("topics", topics)
    conversion = None
    if makes_scans(keywords) or any(keywords.get(name) for name in ("lead", "window", "accumulate", "every", "rebin")):
        read = {"start": start, "end": end, "on_error": on_error, "verify": verify, "strict": strict}
        conversion = conversion_of({**keywords, **read, "topics": names, "only_scans": True}).options
        if conversion.scan.reverse:
            raise UsageError("the parameter file is for laserscan_to_pointcloud, which does not make scans")
    elif given_among(keywords):
        raise UsageError(
            "transforms, filters, `node`, `deskew`, `level` and `remove` have no effect: no clouds are converted",
            hint="to convert clouds, give `preset`, `params_file`, or a parameter by name, `target_frame=base_link`",
        )
    selection = selection_of(sources, names, start, end, on_error, verify=verify, strict=strict)
    return Scans(selection, conversion)


@known_keywords(synonyms=_SYNONYMS)
def clouds(
    sources: PathText | Iterable[PathText],
    topics: str | Iterable[str] = (),
    *,
    start: Time | None = None,
    end: Time | None = None,
    on_error: str = "skip",
    verify: bool = True,
    strict: bool = False,
) -> Clouds:
    """Iterate over the clouds of a recording.

    Clouds are read one by one during the loop, in the order of log time, so memory use stays small.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    topics
        A topic, or several. Default: the only one in the recording.
    start, end, verify, strict
        As for `pc2scan.convert`. Recovered damage is reported as a `pc2scan.errors.RecordingWarning`.
    on_error
        If a message cannot be read: ``skip`` counts and lists it, and issues a warning; ``fail`` raises
        an error.

    Returns
    -------
    Clouds
        An iterable; each loop begins at the start. ``to_dataframe`` makes one table of all clouds.

    Raises
    ------
    UsageError
        If a topic does not exist, or if none is given and there are several.
    RecordingError
        If a source cannot be read.
    DamageError
        With ``strict``, if a source is damaged.
    MessageError
        If ``on_error`` is ``fail`` and a message cannot be read. Raised in the loop.

    Examples
    --------
    >>> import pc2scan
    >>> for cloud in pc2scan.clouds("drive.bag", topics="/points"):  # doctest: +SKIP
    ...     print(cloud.stamp, cloud.xyz().shape, cloud["intensity"].max())
    """
    from .streams.clouds import Clouds  # noqa: PLC0415

    names = names_in("topics", topics)
    return Clouds(selection_of(sources, names, start, end, on_error, verify=verify, strict=strict))

"""The functions of ``pc2scan``: what the commands do, for Python, in the same words."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from typing import TYPE_CHECKING

from .arguments import known_keywords, names_in, path_of, paths_in
from .errors import UsageError
from .pipeline.options import ConvertOptions
from .requests import (
    conversion_of,
    destination_of,
    frames_of,
    given_among,
    moments_of,
    parameter_names,
    selection_of,
    words_among,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from typing import Any

    from .arguments import PathText
    from .batch.run import BatchProgress
    from .batch.summary import BatchReport
    from .compare.result import Difference
    from .core.params import ProjectionParams
    from .core.unproject import UnprojectParams
    from .export.report import ExportReport
    from .golden.result import GoldenReport
    from .inspect.check import Check
    from .inspect.info import Info
    from .inspect.tf import FrameTree
    from .look.map import Map
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
    "repair",
    "scans",
    "tf",
    "view",
]

#: Words of the command line, and of ROS, for what an argument is called.
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


@known_keywords(further=parameter_names, synonyms=_SYNONYMS)
def convert(
    sources: PathText | Iterable[PathText],
    destination: PathText | None = None,
    *,
    params: ProjectionParams | None = None,
    preset: str | None = None,
    params_file: PathText | None = None,
    node: str | None = None,
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
        A recording, or several that are one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``; or its URL.
    destination
        ``*.bag``: a ROS 1 bag; ``*.mcap``: an MCAP file; text that ends with a slash: into that folder, named after
        the first source; any other name: a rosbag2 directory. Default: next to the first source, in its format, with
        ``_scan`` in its name.
    params
        The parameters of the projection, instead of ``preset`` and ``params_file``. Default: upstream's defaults.
    preset
        A consumer of the scans: what suits it.
    params_file, node
        A ROS parameter file, and the node whose section of it counts. Beats ``preset``.
    scans
        Several outputs, each with sources, parameters and choices of its own: a YAML or JSON file, or what such a file
        has: ``{"/scan": {"min_height": 0.1}, "/low": {"max_height": 0.1}}``. Parameters by name beat all outputs'; the
        other arguments that an output has cannot be given too.
    topics
        What to convert, as ``/points`` or ``/points:=/scan``. Default: every PointCloud2 topic.
    keep, drop
        Names or globs that choose among the topics that are not converted.
    keep_clouds, only_scans
        Whether the converted clouds are written too; whether nothing but the scans is.
    start, end
        The cut by log time, from ``start`` on and before ``end``. A number: seconds from the beginning, from
        100,000,000 on seconds since 1970, whole numbers from 100,000,000,000 on nanoseconds since 1970. Or a
        ``datetime`` with a time zone, a ``numpy.datetime64`` (UTC), a ``timedelta`` from the beginning, or text as
        the command line takes it.
    static_tf, static_tf_file, write_static_tf
        Transforms that the recording lacks, as `StaticTransform` or as text, ``parent child x y z roll pitch yaw``; a
        YAML file of such; whether they are written to ``/tf_static`` of the destination.
    tf_from, tf_topics
        Further recordings whose transforms count; where the transforms are, if not on ``/tf`` and ``/tf_static``.
    source_frame
        Frame of the messages to convert, where their own is wrong or empty.
    frames
        All of these in one object, instead of them.
    where, exclude_box, exclude_polygon, min_height_slope, ground
        Which points of the clouds are used: those whose fields fulfil conditions (``ring in (3, 4) or intensity > 9``),
        not those in boxes (``frame x0 x1 y0 y1 z0 z1``) or polygons (``frame x0 y0 x1 y1 x2 y2 ...``), not those below
        a limit that grows with range, and with ``ground="remove"`` not those on the ground.
    filters
        Further filters, as objects.
    remove
        Which beams of scans are removed, by the rules of laser_filters: ``shadows``, ``speckles``, or with parameters,
        ``"speckles filter_window=3"``; or several.
    keep_used
        A topic for the points that the scans' beams read: PointCloud2 with all their fields, and the beam's number.
    reverse
        Whether LaserScan becomes PointCloud2.
    deskew, fixed_frame, point_time, stamp
        Whether each point (with ``reverse`` each beam) is transformed by the pose at its own time. Of clouds: through a
        frame that does not move, such as ``odom``; the field with the times of points, and its unit, as ``t:ns``; which
        time the scan has: ``header``, ``start``, ``middle`` or ``end``.
    level, imu
        Whether scans are made in a frame without the roll and pitch of the target frame: by ``fixed_frame``, whose z is
        up, or by an IMU, ``/imu/data`` (``/imu/data:imu_link`` if its messages have another frame or none).
    lead, window
        Of topics that become one scan (``["/front:=/scan", "/rear:=/scan"]``), the one whose stamps the scan has, by
        default the first; and how far stamps of the others may be from it, by default half the median period. Times
        are seconds, text with a unit, or a ``timedelta``.
    accumulate, every
        A scan has all points of the last so many seconds, or clouds as ``"10clouds"``; and is made once for each so
        many seconds, instead of for each cloud. ``fixed_frame`` accounts for what the robot moved meanwhile.
    rebin
        Whether LaserScan becomes LaserScan: other beams, other frames, several in one.
    channels, range_cutoff
        Further fields of the clouds that ``reverse`` makes (``distances``, ``stamps``, ``viewpoint``), or all of them
        as `UnprojectParams`; only returns nearer than ``range_cutoff`` are kept, metres.
    on_error
        ``skip`` counts and lists messages that cannot be converted, ``fail`` makes the first one an error.
    fail_on, min_used
        What makes the run fail: ``empty`` (a scan without any return) or ``warning``; and fewer of a topic's points in
        its scans than this share, 0 to 1.
    storage, compression, profile, metadata_version, to
        The form of the destination. Default: that of its format.
    split, repeat_latched
        Write several files, each of so much log time (``60s``, ``10min``) or so many bytes of messages before
        compression (``500MB``, ``1GiB``); whether latched messages and static transforms are repeated at the beginning
        of each. ``files`` of the report lists them.
    ros_distro
        Whose definitions stand in for those that the recording lacks.
    scratch, scratch_size
        Where local copies of what is at URLs are, and how much room they may take there, as ``"20GB"``.
    overwrite
        Whether an existing destination is replaced, and whatever is in the report's place.
    report
        A file to write the report to, as JSON.
    dry_run
        Whether nothing is written, the report neither: the numbers of messages and bytes are estimates then.
    jobs
        Threads; 0 means as many as there are cores. The output does not depend on it.
    verify
        Whether the CRCs that MCAP files carry are compared.
    strict
        Whether damage of a source is an error; otherwise everything readable is recovered.
    progress
        Called now and then with bytes read, bytes in all, and messages read.
    **parameters
        Parameters of the projection by name, as `ProjectionParams` has them: ``min_height=-0.3``. They beat
        ``params_file``, ``preset`` and ``params``.

    Returns
    -------
    Report
        What happened, message by message and point by point; ``print`` shows it as a table.

    Raises
    ------
    UsageError
        If the request contradicts itself, the sources or the destination.
    RecordingError
        If a source cannot be read.
    DamageError
        With ``strict``, if a source is damaged.
    OutputError
        If the destination cannot be written.
    ResultError
        If no message was converted, or the result is not as good as ``fail_on`` and ``min_used`` demand.
    MessageError
        If ``on_error`` is ``fail`` and a message cannot be converted. After any error the destination is as it was.

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
    asked = conversion_of(words_among(locals()), note=notes.append)
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


def _batch_words() -> Iterable[str]:
    """Return the words of conversions that `batch` takes."""
    from .batch.request import words_known  # noqa: PLC0415

    return words_known()


@known_keywords(further=_batch_words, synonyms=_SYNONYMS)
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
    **words: Any,
) -> BatchReport:
    """Convert every recording of a dataset, each by itself, in processes, as ``pc2scan batch`` does.

    Parameters
    ----------
    sources
        Folders, which are searched; recordings; globs; text files with a path a line. Recordings are found by content.
        Any of them may be a URL (``s3://``, ``gs://``, ``az://``; single files at ``https://``).
    destination
        The folder for the results, in the tree of the sources, and for ``manifest.jsonl``. A second call does only what
        is missing, changed or failed. It may be a URL.
    dataset
        A dataset file: options that differ between recordings. ``words`` override it.
    jobs
        Recordings at a time; 0 means as many as there are cores, and memory for. What is written does not depend on it.
    retries
        How often a recording is tried again whose process died.
    force
        Whether what was converted before is converted again.
    checksum
        Whether unchanged recordings are recognised by SHA-256, not by their time of modification.
    fail_fast
        Whether the first recording that fails ends the run.
    dry_run
        Whether nothing is written; outcomes are forecasts, sizes and times estimates.
    dask
        True: a Dask cluster on this machine converts; an address, ``tcp://scheduler:8786``: the cluster of that
        scheduler. Needs ``pc2scan[dask]``. With True, a script needs ``if __name__ == "__main__"``.
    scratch, scratch_size
        As for `pc2scan.convert`: the folder for local copies of what is at URLs, and what all of them may take there.
        With the ``dask`` cluster of an address each worker has a folder, and so much room, of its own.
    report
        A file to write the summary to: ``.json``, ``.csv`` or ``.md``.
    progress
        Called now and then with how far it is.
    **words
        Every option of `pc2scan.convert` that is not one of a single run, and the parameters of the projection. With
        ``export`` (``npz``, ``csv``, ...) results are what `pc2scan.export` writes, in a folder for each recording;
        ``pose_frame``, ``base_frame`` and ``odom_topic`` as there.

    Returns
    -------
    BatchReport
        What became of each recording; ``print`` shows it as a table. A recording that fails is no exception.

    Raises
    ------
    UsageError
        If an option is wrong, for whichever recording; nothing was begun then.
    OutputError
        If the folder or its manifest cannot be written.

    Examples
    --------
    >>> import pc2scan
    >>> result = pc2scan.batch("recordings/", "scans/", preset="slam_toolbox")  # doctest: +SKIP
    >>> result.counts  # doctest: +SKIP
    {'failed': 2, 'converted': 998}
    """
    from .batch.run import BatchOptions, Watch, run_batch  # noqa: PLC0415
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
    return run_batch(names, path_of("destination", destination), words, options, watch=watch)


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
    """Make a sound recording of a damaged one, as ``pc2scan repair`` does: all that can be recovered, byte for byte.

    Parameters
    ----------
    source
        A recording, damaged or not. It is never changed.
    destination
        As for `pc2scan.convert`. Default: next to the source, in its format, with ``_repaired`` in its name.
    storage, compression
        The form of the destination. Default: the source's.
    overwrite, report, verify, progress
        As for `pc2scan.convert`.

    Returns
    -------
    Report
        ``damage`` lists what is damaged; ``exit_status`` is 0 if nothing is, else 3.

    Raises
    ------
    UsageError
        If the destination cannot be.
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
    """Look into a recording, as ``pc2scan info`` does: containers, topics, and what its clouds look like.

    Parameters
    ----------
    sources
        A recording, or several that are one.
    samples
        Clouds and scans of each topic to look at, spread evenly over the recording.
    target_frame
        Frame that heights are shown in, as conversions see them. Default: the clouds' own.
    static_tf, tf_from, tf_topics, source_frame, frames
        As for `pc2scan.convert`.

    Returns
    -------
    Info
        What is in it; ``print`` shows it as tables.

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


@known_keywords(further=parameter_names, synonyms=_SYNONYMS)
def view(
    sources: PathText | Iterable[PathText],
    *,
    clouds: int = 10,
    at: Time | Iterable[Time] = (),
    params: ProjectionParams | None = None,
    preset: str | None = None,
    params_file: PathText | None = None,
    node: str | None = None,
    topics: str | Iterable[str] = (),
    start: Time | None = None,
    end: Time | None = None,
    static_tf: str | StaticTransform | Iterable[str | StaticTransform] = (),
    static_tf_file: PathText | None = None,
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
    verify: bool = True,
    strict: bool = False,
    **parameters: Any,
) -> Page:
    """Show a recording as a page, as ``pc2scan view`` does: its clouds and the scan that comes of them, to be tuned.

    Parameters
    ----------
    sources
        A recording, or several that are one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    clouds
        How many moments of each topic are on the page, evenly spread over the recording.
    at
        A moment to show instead, or several, as ``start`` takes it.
    params, preset, params_file, node, topics, start, end, **parameters
        As for `pc2scan.convert`.
    static_tf, static_tf_file, tf_from, tf_topics, source_frame, frames
        As for `pc2scan.convert`.
    where, exclude_box, exclude_polygon, min_height_slope, ground, filters, verify, strict
        As for `pc2scan.convert`.

    Returns
    -------
    Page
        Notebooks show it in their cell; ``save`` writes it to a file.

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
    options = conversion_of(words_among(locals())).options
    from .cli.command_line import convert_words  # noqa: PLC0415
    from .look.view import page_of  # noqa: PLC0415

    paths = paths_in("sources", sources)
    return page_of(
        paths,
        options,
        clouds=clouds,
        at=moments_of(at),
        preset=preset or "",
        command=convert_words(paths, options, "scans.mcap"),
    )


@known_keywords(further=parameter_names, synonyms=_SYNONYMS)
def map(  # noqa: A001  # as the command is called
    sources: PathText | Iterable[PathText],
    *,
    odom_frame: str = "odom",
    base_frame: str = "",
    resolution: float = 0.05,
    max_range: float | None = None,
    clear_to: float = 0.0,
    params: ProjectionParams | None = None,
    preset: str | None = None,
    params_file: PathText | None = None,
    node: str | None = None,
    topics: str | Iterable[str] = (),
    start: Time | None = None,
    end: Time | None = None,
    static_tf: str | StaticTransform | Iterable[str | StaticTransform] = (),
    static_tf_file: PathText | None = None,
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
    on_error: str = "skip",
    verify: bool = True,
    strict: bool = False,
    progress: Progress | None = None,
    **parameters: Any,
) -> Map:
    """Draw the scans of a recording into a map, as ``pc2scan map`` does: where the recorded odometry places them.

    A preview, no SLAM: nothing is matched or corrected. It shows whether heights, mounts, stamps and odometry fit
    together. Scans are placed at their stamp, their beams at their own time where ``time_increment`` says it.

    Parameters
    ----------
    sources
        A recording, or several that are one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    odom_frame
        The frame in which the robot moves; that of the map.
    base_frame
        The robot's frame, whose way is shown. Default: ``base_link``, or ``base_footprint`` where that is not there.
    resolution
        The side of a cell, metres.
    max_range
        Returns beyond it only clear the way so far, metres. Default: all returns count.
    clear_to
        How far beams without a return clear, metres. By default they say nothing, as in gmapping and slam_toolbox.
    topics
        LaserScan or PointCloud2 topics. Default: all scans; all clouds if there are no scans, or if anything is given
        that makes scans of clouds.
    params, preset, params_file, node, start, end, **parameters
        As for `pc2scan.convert`.
    static_tf, static_tf_file, tf_from, tf_topics, source_frame, frames
        As for `pc2scan.convert`.
    where, exclude_box, exclude_polygon, min_height_slope, ground, filters
        As for `pc2scan.convert`.
    deskew, fixed_frame, point_time, stamp, level, imu
        As for `pc2scan.convert`.
    lead, window, accumulate, every, rebin
        As for `pc2scan.convert`. Topics that share a target become one scan.
    on_error, verify, strict, progress
        As for `pc2scan.convert`.

    Returns
    -------
    Map
        Its ``cells`` are an array; ``save`` writes it for map_server. Notebooks show its picture.

    Raises
    ------
    UsageError
        If the request contradicts itself or the recording, there is no such frame, or the map would be too large.
    RecordingError
        If a source cannot be read.
    ResultError
        If no scan has a place, or none has a return.

    Examples
    --------
    >>> import pc2scan
    >>> pc2scan.map("drive.bag", min_height=0.1, max_height=1.5).save("map.yaml")  # doctest: +SKIP
    """
    options = conversion_of(words_among(locals())).options
    import math  # noqa: PLC0415

    from .look.map import MapOptions, map_of  # noqa: PLC0415

    asked = MapOptions(
        odom_frame=odom_frame,
        base_frame=base_frame,
        resolution=resolution,
        max_range=math.inf if max_range is None else max_range,
        clear_to=clear_to,
    )
    return map_of(paths_in("sources", sources), options, asked, progress=progress)


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
    """Tell whether SLAM and navigation would accept the scans of a recording, as ``pc2scan check`` does.

    Parameters
    ----------
    sources
        A recording, or several that are one.
    consumers
        Whose verdicts count: ``slam_toolbox``, ``cartographer``, ``gmapping``, ``amcl``, ``nav2``, ``mrpt``. Default:
        all, and defects count too. All are reported in any case.
    topics
        LaserScan topics to look at. Default: all.
    odom_frame, base_frame
        The frames that scans must be connected with; an empty ``base_frame`` means ``base_link``, or
        ``base_footprint`` where that is not there.
    tf_from, tf_topics
        Further recordings whose transforms count; where the transforms are, if not on ``/tf`` and ``/tf_static``.
    frames
        Both of these in one object, instead of them.

    Returns
    -------
    Check
        ``exit_status`` is 0 if the scans are good; ``print`` shows why not.

    Raises
    ------
    UsageError
        If a consumer is unknown, there is no such topic, or several namespaces have transforms and none was named.
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
        Recordings; their transforms count together.
    tf_topics
        Where the transforms are, if not on ``/tf`` and ``/tf_static``.
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
        If several namespaces have transforms and none was named.
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
    """Check conversions against what they are expected to make, as ``pc2scan golden`` does.

    Parameters
    ----------
    folder
        A folder of cases, or one case.
    pattern
        Only cases with this in their name; may be a glob.
    update
        Whether to write the expected output of cases that differ or have none.
    init
        Make a new case of this recording first: ``folder``, which must not exist.
    start, end, topics, params_file
        With ``init``: the cut of the recording, its topics of clouds and scans (default: all), and the parameter file.

    Returns
    -------
    GoldenReport
        What became of each case; ``exit_status`` is 0 if all are as expected.

    Raises
    ------
    UsageError
        If there is no such folder, or no case in it.

    Notes
    -----
    While a case runs, what this process prints is held back, and SIGTERM ends the process in order.
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
        raise UsageError("`start`, `end`, `topics` and `params_file` are for a new case: init=SRC")
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
) -> Difference:
    """Compare the scans and clouds of two recordings, as ``pc2scan diff`` does.

    Parameters
    ----------
    a, b
        ``a`` is the reference. Default of ``b``: ``a`` itself, for two topics of it.
    topics
        What to compare, as ``/scan`` or ``/scan:=/scan2``. Default: every LaserScan and PointCloud2 topic.
    all_topics
        Whether the other topics are compared too: matched by log time, byte for byte.
    atol, rtol
        Absolute tolerance, and tolerance relative to the value in ``a``; they add up. A number is for all values, a
        mapping has one for ``ranges``, ``intensities`` or a field of the clouds.
    allow_beams
        Share of a topic's beams (clouds: points) that may be beyond the tolerance.
    ignore
        What is not compared: ``log_time``, ``seq``, ``frame_id``, ``order``, ``intensities``, ``ranges``, ``angle_min``
        and the other numbers of a scan, ``shape``, ``layout``, ``padding``, ``is_dense``.
    explain
        Whether to find out how many differing beams another libm explains; see ``libm`` of each topic.
    clouds
        The recording with the clouds that the scans were made of. Default: ``a``, or where it has none, ``b``. If it
        is given, differing beams are explained.

    Returns
    -------
    Difference
        ``same`` is true if nothing differs; ``print`` shows what the command prints.

    Raises
    ------
    UsageError
        If a topic is not there, there is nothing to compare, or a rule cannot be.
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
    return compare(
        path_of("a", a),
        None if b is None else path_of("b", b),
        topics=[TopicPair.parse(topic) for topic in names_in("topics", topics)],
        all_topics=all_topics,
        rules=rules,
        transforms_of=recorded_transforms if explain or clouds is not None else None,
        clouds=None if clouds is None else path_of("clouds", clouds),
    )


@known_keywords(further=parameter_names, synonyms=_SYNONYMS)
def export(
    sources: PathText | Iterable[PathText],
    destination: PathText,
    *,
    format: str | None = None,  # noqa: A002  # the command's word
    pose_frame: str = "",
    base_frame: str = "",
    odom_topic: str = "",
    topics: str | Iterable[str] = (),
    start: Time | None = None,
    end: Time | None = None,
    params: ProjectionParams | None = None,
    preset: str | None = None,
    params_file: PathText | None = None,
    node: str | None = None,
    static_tf: str | StaticTransform | Iterable[str | StaticTransform] = (),
    static_tf_file: PathText | None = None,
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
    on_error: str = "skip",
    overwrite: bool = False,
    verify: bool = True,
    strict: bool = False,
    progress: Progress | None = None,
    **parameters: Any,
) -> ExportReport:
    """Write scans with poses, trajectories or clouds for learning and evaluation, as ``pc2scan export`` does.

    Parameters
    ----------
    sources
        A recording, or several that are one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    destination
        A file; or a folder, which is made: of several topics, of clouds, and where the text ends with a slash.
    format
        ``npz``, ``csv``, ``tum``, ``carmen``, ``flaser``, ``pcd`` or ``kitti``. Default: that of the file's suffix.
    pose_frame
        Write the robot's pose in this frame, such as ``odom``, at each message's own stamp, from the transforms.
        Messages without a transform at their stamp are skipped.
    base_frame
        Whose pose. Default: ``base_link``, or ``base_footprint``, where it is between ``pose_frame`` and the message's
        frame; else the frame farthest up that nothing moves against the message's frame.
    odom_topic
        Take the poses from this nav_msgs/Odometry topic instead.
    topics, start, end
        As for `pc2scan.convert`. Default: all LaserScan topics; of clouds, and where scans are made of them, all
        PointCloud2 topics.
    params, preset, params_file, node, **parameters
        As for `pc2scan.scans`: with any of them scans are made of clouds on the way.
    static_tf, static_tf_file, tf_from, tf_topics, source_frame, frames
        As for `pc2scan.convert`; for poses too.
    where, exclude_box, exclude_polygon, min_height_slope, ground, filters
        As for `pc2scan.convert`, where scans are made of clouds.
    deskew, fixed_frame, point_time, stamp, level, imu
        As for `pc2scan.convert`, where scans are made of clouds.
    lead, window, accumulate, every, rebin
        As for `pc2scan.convert`. Topics that share a target become one scan.
    on_error
        ``skip`` counts and lists messages that cannot be written, ``fail`` makes the first one an error.
    overwrite
        Whether an existing destination is replaced: a file, or a folder with nothing but an export of this format.
    verify, strict, progress
        As for `pc2scan.convert`.

    Returns
    -------
    ExportReport
        What was written, and what was skipped; ``print`` shows it as a table.

    Raises
    ------
    UsageError
        If the request contradicts itself or the recording, or the format cannot hold the data.
    RecordingError
        If a source cannot be read.
    DamageError
        With ``strict``, if a source is damaged.
    OutputError
        If the destination cannot be written.
    ResultError
        If there is nothing to write.
    MessageError
        If ``on_error`` is ``fail`` and a message cannot be written. After any error nothing is written.

    Examples
    --------
    >>> import pc2scan
    >>> pc2scan.export("drive.bag", "scans.npz", pose_frame="odom")  # doctest: +SKIP
    >>> pc2scan.export("drive.bag", "scans.csv", preset="slam_toolbox", min_height=-0.3)  # doctest: +SKIP
    """
    notes: list[str] = []
    asked = conversion_of(words_among(locals()), note=notes.append)
    from .export.poses import PoseOptions  # noqa: PLC0415
    from .export.run import ExportOptions, run  # noqa: PLC0415

    converting = bool(parameters) or any(each is not None for each in (params, preset, params_file))
    converting = converting or asked.options.scan.may_combine
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


@known_keywords(further=parameter_names, synonyms={**_SYNONYMS, "topics": "topic", "sources": "source"})
def scans(
    source: PathText | Iterable[PathText],
    topic: str | Iterable[str] | None = None,
    *,
    start: Time | None = None,
    end: Time | None = None,
    params: ProjectionParams | None = None,
    preset: str | None = None,
    params_file: PathText | None = None,
    node: str | None = None,
    static_tf: str | StaticTransform | Iterable[str | StaticTransform] = (),
    static_tf_file: PathText | None = None,
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
    on_error: str = "skip",
    verify: bool = True,
    strict: bool = False,
    **parameters: Any,
) -> Scans:
    """Iterate over the scans of a recording, or over scans that are made of its clouds on the way.

    Scans are read as the loop goes on, in the order of log time, so that memory stays small. With ``params``,
    ``preset``, ``params_file`` or any parameter of the projection the clouds are converted instead, without a file;
    the scans are those that `pc2scan.convert` writes, to the bit.

    Parameters
    ----------
    source
        A recording, or several that are one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    topic
        A topic, or several; of clouds also as ``/points:=/scan``. Default: the only one.
    start, end, verify, strict
        As for `pc2scan.convert`. Damage that is read around is a `pc2scan.errors.RecordingWarning`.
    params, preset, params_file, node, **parameters
        As for `pc2scan.convert`.
    static_tf, static_tf_file, tf_from, tf_topics, source_frame, frames
        As for `pc2scan.convert`; for clouds with a ``target_frame``.
    where, exclude_box, exclude_polygon, min_height_slope, ground, filters
        As for `pc2scan.convert`.
    deskew, fixed_frame, point_time, stamp, level, imu
        As for `pc2scan.convert`.
    lead, window, accumulate, every, rebin
        As for `pc2scan.convert`. Topics that share a target become one scan.
    on_error
        ``skip``: messages that cannot be used are counted and listed, and a warning says so. ``fail``: the first one is
        an error.

    Returns
    -------
    Scans
        Iterate over it; each loop starts again. ``to_xarray`` and ``to_dataframe`` make one table of all scans.

    Raises
    ------
    UsageError
        If the request contradicts itself or the recording, a topic is missing, or there are several and none was named.
    RecordingError
        If a source cannot be read.
    DamageError
        With ``strict``, if a source is damaged.
    MessageError
        If ``on_error`` is ``fail`` and a message cannot be used; in the loop.

    Examples
    --------
    >>> import pc2scan
    >>> for scan in pc2scan.scans("scans.mcap"):  # doctest: +SKIP
    ...     print(scan.stamp, scan.ranges.min(), scan.xy().shape)
    >>> for scan in pc2scan.scans("drive.bag", preset="slam_toolbox", min_height=-0.5):  # doctest: +SKIP
    ...     print(scan)
    """
    words = words_among(locals())
    from .streams.scans import Scans  # noqa: PLC0415

    names = names_in("topic", topic)
    conversion = None
    given = set(given_among(words))
    projected = bool(parameters) or any(each is not None for each in (params, preset, params_file))
    if projected or given & {"lead", "window", "accumulate", "every", "rebin"}:
        conversion = conversion_of({**words, "topics": names, "only_scans": True}).options
        if conversion.scan.reverse:
            raise UsageError("the parameter file is for laserscan_to_pointcloud, scans are made of clouds")
    elif given - {"start", "end", "on_error", "verify", "strict"}:
        raise UsageError(
            "transforms, filters, `node`, `deskew` and `level` count only where clouds are converted",
            hint="give parameters: `preset`, `params_file`, or any of them by name, `target_frame=base_link`",
        )
    selection = selection_of(source, names, start, end, on_error, verify=verify, strict=strict)
    return Scans(selection, conversion)


@known_keywords(synonyms={**_SYNONYMS, "topics": "topic", "sources": "source"})
def clouds(
    source: PathText | Iterable[PathText],
    topic: str | Iterable[str] | None = None,
    *,
    start: Time | None = None,
    end: Time | None = None,
    on_error: str = "skip",
    verify: bool = True,
    strict: bool = False,
) -> Clouds:
    """Iterate over the clouds of a recording.

    Clouds are read as the loop goes on, in the order of log time, so that memory stays small.

    Parameters
    ----------
    source
        A recording, or several that are one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    topic
        A topic, or several. Default: the only one.
    start, end, verify, strict
        As for `pc2scan.convert`. Damage that is read around is a `pc2scan.errors.RecordingWarning`.
    on_error
        ``skip``: messages that cannot be read are counted and listed, and a warning says so. ``fail``: the first one is
        an error.

    Returns
    -------
    Clouds
        Iterate over it; each loop starts again. ``to_dataframe`` makes one table of all clouds.

    Raises
    ------
    UsageError
        If a topic is missing, or there are several and none was named.
    RecordingError
        If a source cannot be read.
    DamageError
        With ``strict``, if a source is damaged.
    MessageError
        If ``on_error`` is ``fail`` and a message cannot be read; in the loop.

    Examples
    --------
    >>> import pc2scan
    >>> for cloud in pc2scan.clouds("drive.bag", topic="/points"):  # doctest: +SKIP
    ...     print(cloud.stamp, cloud.xyz().shape, cloud["intensity"].max())
    """
    from .streams.clouds import Clouds  # noqa: PLC0415

    names = names_in("topic", topic)
    return Clouds(selection_of(source, names, start, end, on_error, verify=verify, strict=strict))

"""The functions of ``pc2scan``: each does what the command of the same name does, with the same options.

The options are those of the table, `pc2scan.options.table`, which also has the types of the keywords.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .arguments import names_in
from .cli.in_process import run_command
from .compare.diff import diff as compare
from .compare.golden import check_cases, make_case
from .conversion.run import convert as convert_by
from .conversion.run import repair as repair_by
from .datasets.batch import run_batch
from .errors import UsageError
from .exports.export import export as write
from .files.paths import path_of, paths_in
from .options.call import Options
from .options.effects import refuse_idle
from .options.keywords import takes_options
from .options.table import options_of
from .parsing import conversion_of, frames_of, reading_of
from .show.check import check as judge
from .show.info import info as describe
from .show.map import draw_map
from .show.plot import plot as draw
from .show.tf import frame_tree
from .show.view import page_of
from .streams.stream import Clouds, Scans

if TYPE_CHECKING:
    from collections.abc import Iterable

    from typing_extensions import Unpack

    from .compare.differences import Difference
    from .compare.golden import GoldenReport
    from .conversion.report import Report
    from .datasets.summary import BatchReport
    from .exports.export import ExportReport
    from .files.paths import PathText
    from .options import table
    from .show.check import Check
    from .show.info import Info
    from .show.map import Map
    from .show.plot import Plot
    from .show.tf import FrameTree
    from .show.view import Page


@takes_options
def convert(
    sources: PathText | Iterable[PathText],
    destination: PathText | None = None,
    **options: Unpack[table.ConvertKeywords],
) -> Report:
    """Convert recorded PointCloud2 to LaserScan, or back, as ``pc2scan convert`` does.

    Parameters of the projection by name override those of ``params_file``, which override those of ``preset``.

    Parameters
    ----------
    sources
        A recording: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``; or its URL. Several are read as one recording.
    destination
        ``*.bag``: a ROS 1 bag; ``*.mcap``: an MCAP file; text that ends with a slash: a folder, in which the
        destination is named after the first source; any other name: a rosbag2 directory. Default: next to the first
        source, in its format, with ``_scan`` in its name.
    **options

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
        With ``strict``, if a message cannot be converted. After any error the destination is unchanged.

    Examples
    --------
    >>> import pc2scan
    >>> report = pc2scan.convert(
    ...     "drive.bag", "scans.mcap", preset="slam_toolbox", min_height=-0.5, max_height=1.0
    ... )  # doctest: +SKIP
    >>> report.exit_status  # doctest: +SKIP
    0
    """
    call = Options("convert", options)
    return convert_by(paths_in("sources", sources), destination, call, progress=call.progress)


@takes_options
def batch(
    sources: PathText | Iterable[PathText],
    destination: PathText,
    **options: Unpack[table.BatchKeywords],
) -> BatchReport:
    """Convert every recording of a dataset by itself, in several processes, as ``pc2scan batch`` does.

    Parameters
    ----------
    sources
        Folders, which are searched; recordings; globs. Recordings are recognised by content. Folders and recordings may
        be URLs (``s3://``, ``gs://``, ``az://``; single files at ``https://``).
    destination
        The folder for the results, in the same subfolders as the sources, and for ``manifest.jsonl``. A second call
        converts only recordings whose results are missing, out of date or failed.
    **options

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
    call = Options("batch", options)
    names = [str(path) for path in paths_in("sources", sources)]
    return run_batch(names, path_of("destination", destination), call, progress=call.progress)


@takes_options
def repair(
    source: PathText,
    destination: PathText | None = None,
    **options: Unpack[table.RepairKeywords],
) -> Report:
    """Write everything that can be recovered from a damaged recording to a new one, as ``pc2scan repair`` does.

    Parameters
    ----------
    source
        A recording, damaged or not. It is not changed. Its messages are copied byte for byte.
    destination
        As for `pc2scan.convert`. Default: next to the source, in its format, with ``_repaired`` in its name.
    **options

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
    call = Options("repair", options)
    return repair_by(path_of("source", source), destination, call, progress=call.progress)


@takes_options
def info(
    sources: PathText | Iterable[PathText],
    **options: Unpack[table.InfoKeywords],
) -> Info:
    """Describe a recording, as ``pc2scan info`` does: its container, topics, clouds and scans.

    Parameters
    ----------
    sources
        A recording, or several that are read as one.
    **options

    Returns
    -------
    Info
        The description; ``print`` shows it as tables.

    Raises
    ------
    RecordingError
        If a source cannot be read.
    """
    return describe(paths_in("sources", sources), Options("info", options))


@takes_options
def view(
    sources: PathText | Iterable[PathText],
    **options: Unpack[table.ViewKeywords],
) -> Page:
    """Show a recording as an HTML page, as ``pc2scan view`` does: its clouds, and their scans with tunable parameters.

    If there are several outputs, the first is shown.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    **options

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
    return page_of(paths_in("sources", sources), Options("view", options))


@takes_options
def plot(
    sources: PathText | Iterable[PathText],
    destination: PathText,
    **options: Unpack[table.PlotKeywords],
) -> Plot:
    """Draw clouds from above and from the side, with the heights and the scan, as ``pc2scan plot`` does.

    If there are several outputs, the first is drawn.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    destination
        The figure: ``.png``, ``.svg`` or ``.pdf``. Needs ``pc2scan[plot]``.
    **options

    Returns
    -------
    Plot
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
    return draw(paths_in("sources", sources), path_of("destination", destination), Options("plot", options))


@takes_options
def map(  # noqa: A001  # the command's name
    sources: PathText | Iterable[PathText],
    **options: Unpack[table.MapKeywords],
) -> Map:
    """Draw the scans of a recording into a map by its recorded odometry, as ``pc2scan map`` does.

    This is a preview, not SLAM: no scans are matched, and no poses corrected. It shows whether heights, mounting,
    stamps and odometry fit together. A scan has the pose at its stamp; with a ``time_increment``, each beam has the
    pose at its own time. ``topics`` are topics of scans or clouds; by default all scans, or all clouds if there
    are no scans, or if an option is given that converts clouds. If there are several outputs, the first is drawn.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    **options

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
    call = Options("map", options)
    return draw_map(paths_in("sources", sources), None, call, progress=call.progress)


@takes_options
def check(
    sources: PathText | Iterable[PathText],
    **options: Unpack[table.CheckKeywords],
) -> Check:
    """Check whether SLAM and navigation would accept the scans of a recording, as ``pc2scan check`` does.

    Parameters
    ----------
    sources
        A recording, or several that are read as one.
    **options

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
    return judge(paths_in("sources", sources), Options("check", options))


@takes_options
def tf(
    sources: PathText | Iterable[PathText],
    **options: Unpack[table.TfKeywords],
) -> FrameTree:
    """Read the frames of a recording, as ``pc2scan tf`` does.

    Parameters
    ----------
    sources
        A recording, or several, whose transforms are read together.
    **options

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
    return frame_tree(paths_in("sources", sources), frames_of(Options("tf", options)))


@takes_options
def golden(
    folder: PathText,
    pattern: str = "",
    **options: Unpack[table.GoldenKeywords],
) -> GoldenReport:
    """Compare the outputs of conversions with expected ones (golden cases), as ``pc2scan golden`` does.

    Parameters
    ----------
    folder
        A folder of cases, or one case.
    pattern
        Check only cases whose names contain this text, or match this glob.
    **options

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
    path, call = path_of("folder", folder), Options("golden", options)
    if call.init is not None:
        make_case(path, run_command, call)
    refuse_idle(call.given, "golden")
    return check_cases(path, pattern, run_command, update=call.update)


@takes_options
def diff(
    a: PathText,
    b: PathText | None = None,
    **options: Unpack[table.DiffKeywords],
) -> Difference:
    """Compare the scans and clouds of two recordings, as ``pc2scan diff`` does.

    Parameters
    ----------
    a, b
        The recordings; ``a`` is the reference. ``b`` is ``a`` by default, to compare two topics of one recording.
    **options

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
    >>> difference = pc2scan.diff("expected.bag", "scans.mcap", rtol=1e-5)  # doctest: +SKIP
    >>> assert difference.same, difference  # doctest: +SKIP
    """
    other = None if b is None else path_of("b", b)
    return compare(path_of("a", a), other, Options("diff", options))


@takes_options
def export(
    sources: PathText | Iterable[PathText],
    destination: PathText,
    **options: Unpack[table.ExportKeywords],
) -> ExportReport:
    """Write scans with poses, trajectories or clouds for learning and evaluation, as ``pc2scan export`` does.

    With any parameter of the projection, clouds are converted first. Without ``topics``, all LaserScan topics are
    exported; if clouds are exported or converted, all topics of clouds. Options about transforms are also used for
    poses.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    destination
        A file; a folder for several topics and for clouds, or if the text ends with a slash. The folder is created.
    **options

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
        With ``strict``, if a message cannot be written. After any error nothing is written.

    Examples
    --------
    >>> import pc2scan
    >>> pc2scan.export("drive.bag", "scans.npz", pose_frame="odom")  # doctest: +SKIP
    >>> pc2scan.export("drive.bag", "scans.csv", preset="slam_toolbox", min_height=-0.3)  # doctest: +SKIP
    """
    call = Options("export", options)
    return write(paths_in("sources", sources), destination, call, progress=call.progress)


@takes_options
def scans(
    sources: PathText | Iterable[PathText],
    topics: str | Iterable[str] = (),
    **options: Unpack[table.ScansKeywords],
) -> Scans:
    """Iterate over the scans of a recording, or convert its clouds and iterate over the resulting scans.

    Scans are read one by one during the loop, in the order of log time, so memory use stays small. With ``params``,
    ``preset``, ``params_file`` or any parameter of the projection, clouds are converted instead, without writing a
    file. The scans are identical to those that `pc2scan.convert` writes; topics that share a target become one scan.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    topics
        A topic, or several; for clouds also as ``/points:=/scan``. Default: the only one in the recording.
    **options

    Returns
    -------
    Scans
        An iterable; each loop begins at the start.

    Raises
    ------
    UsageError
        If an argument is wrong or does not fit the recording, or if a topic is missing or needed.
    RecordingError
        If a source cannot be read.
    DamageError
        With ``strict``, if a source is damaged.
    MessageError
        With ``strict``, if a message cannot be used. Raised in the loop.

    Examples
    --------
    >>> import pc2scan
    >>> for scan in pc2scan.scans("scans.mcap"):  # doctest: +SKIP
    ...     print(scan.stamp, scan.ranges.min(), scan.xy().shape)
    >>> for scan in pc2scan.scans("drive.bag", preset="slam_toolbox", min_height=-0.5):  # doctest: +SKIP
    ...     print(scan)
    """
    names, call = names_in("topics", topics), Options("scans", options)
    conversion = None
    if call.makes_scans:
        given = {**call.given, "topics": names, "only_scans": True}
        conversion = conversion_of(Options("convert", given))
        if conversion.scan.reverse:
            raise UsageError("the parameter file is for laserscan_to_pointcloud, which does not make scans")
    elif call.given.keys() - options_of("clouds").keys() - {"jobs"}:
        raise UsageError(
            "transforms, filters, `node`, `deskew`, `level` and `remove` have no effect: no clouds are converted",
            hint="to convert clouds, give `preset`, `params_file`, or a parameter by name, `target_frame=base_link`",
        )
    paths = paths_in("sources", sources)
    return Scans(paths, conversion or reading_of(names, call), conversion is not None)


@takes_options
def clouds(
    sources: PathText | Iterable[PathText],
    topics: str | Iterable[str] = (),
    **options: Unpack[table.CloudsKeywords],
) -> Clouds:
    """Iterate over the clouds of a recording.

    Clouds are read one by one during the loop, in the order of log time, so memory use stays small.

    Parameters
    ----------
    sources
        A recording, or several that are read as one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    topics
        A topic, or several. Default: the only one in the recording.
    **options

    Returns
    -------
    Clouds
        An iterable; each loop begins at the start.

    Raises
    ------
    UsageError
        If a topic does not exist, or if none is given and there are several.
    RecordingError
        If a source cannot be read.
    DamageError
        With ``strict``, if a source is damaged.
    MessageError
        With ``strict``, if a message cannot be read. Raised in the loop.

    Examples
    --------
    >>> import pc2scan
    >>> for cloud in pc2scan.clouds("drive.bag", topics="/points"):  # doctest: +SKIP
    ...     print(cloud.stamp, cloud.xyz().shape, cloud["intensity"].max())
    """
    reading = reading_of(names_in("topics", topics), Options("clouds", options))
    return Clouds(paths_in("sources", sources), reading)

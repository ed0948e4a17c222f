"""``pc2scan convert``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.errors import OutputError, UsageError, stamp_text
from pc2scan.pipeline.parameters import PARAMETERS

from .damage import SHOWN, show_recovery
from .render import count, printable, size, table

if TYPE_CHECKING:
    from pc2scan.core.unproject import UnprojectParams
    from pc2scan.pipeline.parameters import Direction, ResolvedParams
    from pc2scan.pipeline.report import Report, Skipped

__all__ = ["Compression", "Storage", "convert", "show", "write_report"]


class Storage(StrEnum):
    """Storages of a rosbag2 directory."""

    mcap = "mcap"
    sqlite3 = "sqlite3"


class Compression(StrEnum):
    """Compressions of the destination."""

    none = "none"
    lz4 = "lz4"
    zstd = "zstd"
    bz2 = "bz2"


class Profile(StrEnum):
    """Profiles of an MCAP file."""

    ros1 = "ros1"
    ros2 = "ros2"


class Channel(StrEnum):
    """Channels that laser_geometry can add to a cloud."""

    distances = "distances"
    stamps = "stamps"
    viewpoint = "viewpoint"


class OnError(StrEnum):
    """What a message that cannot be converted does."""

    skip = "skip"
    fail = "fail"


_PARAMS = "Parameters of pointcloud_to_laserscan"
_SLAM = "Ready for SLAM (beyond pointcloud_to_laserscan)"
_TOPICS = "Topics and time"
_FRAMES = "Frames"
_REVERSE = "The way back"
_OUTPUT = "Output"
_REPORT = "Report"


def _parameter(name: str) -> typer.models.OptionInfo:
    """The option of one parameter; unset unless given, so that files can speak."""
    parameter = PARAMETERS[name]
    default = str(parameter.default).lower() if parameter.kind == "bool" else str(parameter.default)
    # There 0 means that another parameter tells.
    told = (
        f"  [default: {' '.join(filter(None, (default, parameter.unit)))}]"
        if default and name not in {"beams", "kth"}
        else ""
    )
    metavar = {"float": parameter.unit.upper(), "int": "N", "str": "NAME"}.get(parameter.kind)
    if name == "target_frame":
        metavar = "FRAME"
    elif parameter.words:
        metavar = "|".join((parameter.unit.upper(),) * (parameter.kind == "float") + parameter.words)
    flag = parameter.option
    option: typer.models.OptionInfo = typer.Option(
        f"{flag}/--no-{flag.removeprefix('--')}" if parameter.kind == "bool" else flag,
        help=parameter.help + told,
        show_default=False,
        metavar=metavar,
        rich_help_panel=_PARAMS if parameter.upstreams else _SLAM,
    )
    return option


def convert(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SRC...",
            help="ROS 1 bag, rosbag2 directory, .db3 or .mcap file. Several are one recording, merged in time order.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DST",
            help="*.bag: ROS 1 bag; *.mcap: MCAP file; any other name: rosbag2 directory. "
            "Left out: beside SRC, in its format, with _scan in its name.",
        ),
    ] = None,
    *,
    topics: Annotated[
        list[str],
        typer.Option(
            "--topic",
            "-t",
            metavar="IN[:=OUT]",
            help="PointCloud2 topic to convert, and the topic of its scans. Repeatable. "
            "Default: every PointCloud2 topic; one becomes /scan, several <topic>/scan.",
            rich_help_panel=_TOPICS,
        ),
    ] = [],  # noqa: B006 - typer reads the default and never hands it out
    keep: Annotated[
        list[str],
        typer.Option(
            "--keep",
            metavar="TOPIC",
            help="Of the topics that are not converted, write only these (names or globs). Repeatable.",
            rich_help_panel=_TOPICS,
        ),
    ] = [],  # noqa: B006
    drop: Annotated[
        list[str],
        typer.Option(
            "--drop",
            metavar="TOPIC",
            help="Leave these topics out (names or globs). Repeatable.",
            rich_help_panel=_TOPICS,
        ),
    ] = [],  # noqa: B006
    keep_clouds: Annotated[
        bool, typer.Option("--keep-clouds", help="Write the converted clouds too.", rich_help_panel=_TOPICS)
    ] = False,
    only_scans: Annotated[
        bool, typer.Option("--only-scans", help="Write nothing but the scans.", rich_help_panel=_TOPICS)
    ] = False,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="Begin here: seconds from the beginning, @seconds since 1970, or a date and time (ISO 8601). "
            "Latched and static-transform messages from before are kept.",
            rich_help_panel=_TOPICS,
        ),
    ] = None,
    end: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="End before this time; like --start.", rich_help_panel=_TOPICS),
    ] = None,
    params_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="ROS 2 parameter file or ROS 1 YAML, the file that ran the robot.",
            rich_help_panel=_PARAMS,
        ),
    ] = None,
    node: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Whose section of the parameter file, if it has several.",
            rich_help_panel=_PARAMS,
        ),
    ] = None,
    param: Annotated[
        list[str],
        typer.Option(
            "--param",
            "-p",
            metavar="NAME:=VALUE",
            help="A parameter in ROS's notation. Repeatable; beats the file, and an option below beats it.",
            rich_help_panel=_PARAMS,
        ),
    ] = [],  # noqa: B006
    target_frame: Annotated[str | None, _parameter("target_frame")] = None,
    transform_tolerance: Annotated[float | None, _parameter("transform_tolerance")] = None,
    min_height: Annotated[float | None, _parameter("min_height")] = None,
    max_height: Annotated[float | None, _parameter("max_height")] = None,
    angle_min: Annotated[float | None, _parameter("angle_min")] = None,
    angle_max: Annotated[float | None, _parameter("angle_max")] = None,
    angle_increment: Annotated[float | None, _parameter("angle_increment")] = None,
    scan_time: Annotated[str | None, _parameter("scan_time")] = None,
    range_min: Annotated[float | None, _parameter("range_min")] = None,
    range_max: Annotated[float | None, _parameter("range_max")] = None,
    use_inf: Annotated[bool | None, _parameter("use_inf")] = None,
    inf_epsilon: Annotated[float | None, _parameter("inf_epsilon")] = None,
    queue_size: Annotated[int | None, _parameter("queue_size")] = None,
    preset: Annotated[
        str | None,
        typer.Option(
            metavar="CONSUMER",
            help="Choose what suits a consumer of the scans: slam_toolbox, cartographer, gmapping, amcl, nav2. Every "
            "parameter that is given, here or in a file, beats it.",
            rich_help_panel=_SLAM,
        ),
    ] = None,
    geometry: Annotated[str | None, _parameter("geometry")] = None,
    beams: Annotated[int | None, _parameter("beams")] = None,
    no_return: Annotated[str | None, _parameter("no_return")] = None,
    reduce: Annotated[str | None, _parameter("reduce")] = None,
    kth: Annotated[int | None, _parameter("kth")] = None,
    min_points: Annotated[int | None, _parameter("min_points")] = None,
    intensity_field: Annotated[str | None, _parameter("intensity_field")] = None,
    time_increment: Annotated[str | None, _parameter("time_increment")] = None,
    static_tf: Annotated[
        list[str],
        typer.Option(
            "--static-tf",
            metavar="TRANSFORM",
            help="A transform that the recording lacks: 'parent child x y z qx qy qz qw' or "
            "'parent child x y z roll pitch yaw' (m, rad). Repeatable; beats the recording's.",
            rich_help_panel=_FRAMES,
        ),
    ] = [],  # noqa: B006
    static_tf_file: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A YAML list of such transforms.", rich_help_panel=_FRAMES),
    ] = None,
    write_static_tf: Annotated[
        bool,
        typer.Option(
            "--write-static-tf",
            help="Write the added transforms to DST's /tf_static.",
            rich_help_panel=_FRAMES,
        ),
    ] = False,
    tf_from: Annotated[
        list[Path],
        typer.Option(
            "--tf-from",
            metavar="FILE",
            help="Take transforms from this recording too. Repeatable.",
            rich_help_panel=_FRAMES,
        ),
    ] = [],  # noqa: B006
    tf_topic: Annotated[
        list[str],
        typer.Option(
            "--tf-topic",
            metavar="TOPIC",
            help="Where the transforms are, if not on /tf and /tf_static. Repeatable.",
            rich_help_panel=_FRAMES,
        ),
    ] = [],  # noqa: B006
    source_frame: Annotated[
        str,
        typer.Option(
            metavar="FRAME",
            help="Frame of the messages to convert, where their own frame_id is wrong or empty.",
            show_default=False,
            rich_help_panel=_FRAMES,
        ),
    ] = "",
    reverse: Annotated[
        bool,
        typer.Option(
            "--reverse",
            help="Convert LaserScan to PointCloud2, as laserscan_to_pointcloud does.",
            rich_help_panel=_REVERSE,
        ),
    ] = False,
    deskew: Annotated[
        bool,
        typer.Option(
            "--deskew",
            help="Transform each beam by the pose at its own time; needs a --target-frame such as odom.",
            rich_help_panel=_REVERSE,
        ),
    ] = False,
    channels: Annotated[
        list[Channel],
        typer.Option(
            "--channel",
            metavar="NAME",
            help="Further fields of the cloud: distances, stamps, viewpoint. Repeatable.",
            rich_help_panel=_REVERSE,
        ),
    ] = [],  # noqa: B006
    range_cutoff: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Keep only returns nearer than this.  [default: the scan's range_max]",
            rich_help_panel=_REVERSE,
        ),
    ] = None,
    storage: Annotated[
        Storage | None,
        typer.Option(help="Storage of a rosbag2 directory.  [default: mcap]", rich_help_panel=_OUTPUT),
    ] = None,
    compression: Annotated[
        Compression | None,
        typer.Option(
            help="Bags: lz4 (default), none, bz2. MCAP: zstd (default), none, lz4. sqlite3: none (default), zstd. "
            "Left out, chunks that are copied whole keep theirs.",
            show_default=False,
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    profile: Annotated[
        Profile | None,
        typer.Option(help="ROS generation of an .mcap file.  [default: the source's]", rich_help_panel=_OUTPUT),
    ] = None,
    metadata_version: Annotated[
        int,
        typer.Option(
            min=8,
            max=9,
            metavar="8|9",
            help="Version of a rosbag2 directory's metadata.yaml; older readers refuse 9.",
            rich_help_panel=_OUTPUT,
        ),
    ] = 8,
    ros_distro: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Whose message definitions stand in for those that a recording lacks.  [default: noetic, jazzy]",
            show_default=False,
            rich_help_panel=_OUTPUT,
        ),
    ] = "",
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace DST if it exists.", rich_help_panel=_OUTPUT)
    ] = False,
    on_error: Annotated[
        OnError,
        typer.Option(
            help="What a message that cannot be converted does: skip counts and lists it, fail ends the run.",
            rich_help_panel=_REPORT,
        ),
    ] = OnError.skip,
    jobs: Annotated[
        int,
        typer.Option(
            "--jobs",
            "-j",
            min=0,
            metavar="N",
            help="Threads; the output does not depend on it.  [default: the cores]",
            show_default=False,
            rich_help_panel=_REPORT,
        ),
    ] = 0,
    no_verify: Annotated[
        bool,
        typer.Option(
            "--no-verify",
            help="Do not compare the CRCs of an MCAP source: faster, but damage may go unnoticed.",
            rich_help_panel=_REPORT,
        ),
    ] = False,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict",
            help="Refuse a damaged source. Without it everything readable is recovered, the rest is told, "
            "and the exit status is 3.",
            rich_help_panel=_REPORT,
        ),
    ] = False,
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write what happened as JSON.", rich_help_panel=_REPORT),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Show warnings and errors only.", rich_help_panel=_REPORT)
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Show every parameter and its origin.", rich_help_panel=_REPORT),
    ] = False,
) -> None:
    """Convert recorded clouds to laser scans, or back.

    PointCloud2 becomes LaserScan as ROS's pointcloud_to_laserscan does it. Every other topic passes through.
    Nothing is dropped in silence: what could not be converted is counted, listed, and told by the exit status.
    """
    given = locals()
    options = {name: given[name] for name in PARAMETERS if given[name] is not None}
    if report is not None and not report.parent.is_dir():
        raise UsageError("the report cannot be written: its directory does not exist", path=report)
    reverse, resolved = _resolve(options, param, params_file, node, preset, reverse=reverse)

    from pc2scan.pipeline.frames import FrameOptions, StaticTransform, load_static_transforms
    from pc2scan.pipeline.options import ConvertOptions, TimeBound, TopicRequest
    from pc2scan.pipeline.run import OutputOptions, run

    from .progress import progress_bar

    request = ConvertOptions(
        params=resolved.params,
        reverse=reverse,
        channels=_channels(channels, range_cutoff),
        deskew=deskew,
        frames=FrameOptions(
            tf_topics=tuple(tf_topic),
            tf_from=tuple(tf_from),
            static=(
                *(load_static_transforms(static_tf_file) if static_tf_file else ()),
                *(StaticTransform.parse(text) for text in static_tf),
            ),
            source_frame=source_frame,
            write_static=write_static_tf,
        ),
        topics=tuple(TopicRequest.parse(topic) for topic in topics),
        keep_clouds=keep_clouds,
        only_scans=only_scans,
        keep=tuple(keep),
        drop=tuple(drop),
        start=None if start is None else TimeBound.parse(start),
        end=None if end is None else TimeBound.parse(end),
        on_error=on_error.value,
        ros_distro=ros_distro,
        jobs=jobs,
        verify=not no_verify,
        strict=strict,
    )
    form = OutputOptions(
        storage=storage and storage.value,
        compression=compression and compression.value,
        profile=profile and profile.value,
        metadata_version=metadata_version,
        overwrite=overwrite,
    )
    with progress_bar(enabled=not quiet) as progress:
        result = run(sources, output, request, form, origins=resolved.origin, progress=progress)
    if report is not None:
        write_report(result, report)
    if not quiet:
        show(result, verbose=verbose)
    show_recovery(result, limit=len(result.damage) if verbose else SHOWN)
    for warning in result.warnings:
        typer.echo(f"warning: {printable(warning)}", err=True)
    raise typer.Exit(result.exit_status)


def _channels(names: list[Channel], range_cutoff: float | None) -> UnprojectParams | None:
    """The fields of the clouds; None where nothing was asked for, which is cheaper to start."""
    if not names and range_cutoff is None:
        return None
    from pc2scan.core.unproject import UnprojectParams

    return UnprojectParams(
        distances=Channel.distances in names,
        stamps=Channel.stamps in names,
        viewpoint=Channel.viewpoint in names,
        range_cutoff=-1.0 if range_cutoff is None else range_cutoff,
    )


def _resolve(
    options: dict[str, object],
    param: list[str],
    params_file: Path | None,
    node: str | None,
    preset: str | None,
    *,
    reverse: bool,
) -> tuple[bool, ResolvedParams]:
    """The direction and the parameters: options beat ``--param``, which beats the file, which beats the preset.

    A file whose section is ``laserscan_to_pointcloud`` asks for the way back.
    """
    from pc2scan.pipeline.param_assignment import parse_param
    from pc2scan.pipeline.parameters import Setting, preset_settings, resolve
    from pc2scan.pipeline.ros_scalars import plain_scalar

    settings = []
    for name, value in options.items():
        parameter = PARAMETERS[name]
        # An option that is a number or a word arrives as text.
        number = parameter.kind == "float" and isinstance(value, str)
        settings.append(Setting(name, plain_scalar(str(value)) if number else value, parameter.option))
    settings += [parse_param(text) for text in reversed(param)]
    if params_file is not None:
        from pc2scan.pipeline.params_file import load_params_file

        file = load_params_file(params_file, node=node)
        settings += file.settings
        if reverse and file.direction == "pointcloud_to_laserscan":
            raise UsageError(f"{file.node} is for pointcloud_to_laserscan, --reverse is not", path=params_file)
        reverse = reverse or file.direction == "laserscan_to_pointcloud"
        for origin in file.ignored:
            typer.echo(f"warning: not a parameter of the projection, ignored: {printable(origin)}", err=True)
    if preset is not None:
        settings += preset_settings(preset)
    direction: Direction = "laserscan_to_pointcloud" if reverse else "pointcloud_to_laserscan"
    return reverse, resolve(settings, direction=direction)


def write_report(report: Report, path: Path) -> None:
    """Write the report beside its name and rename it, so that a half-written one is never read."""
    import json

    text = json.dumps(report.as_dict(), indent=2) + "\n"
    partial = path.with_name(f"{path.name}.pc2scan-partial")
    try:
        partial.write_text(text, "utf-8")
        partial.replace(path)
    except OSError as err:
        raise OutputError(f"the report cannot be written: {err.strerror}", path=path) from err


def show(report: Report, *, verbose: bool = False) -> None:
    """Print what happened."""
    if verbose:
        table(
            ("parameter", "value", "from"),
            [(name, str(getattr(report.params, name)), report.origins.get(name, "default")) for name in PARAMETERS],
            left=("parameter", "from"),
        )
        typer.echo()
    table(
        ("topic", "to", "in", "out", "skipped", "what"),
        [
            (
                topic.topic,
                topic.target or "-",
                count(topic.messages_in),
                count(topic.messages_out),
                count(topic.skipped),
                topic.action + (" (cloud kept)" if topic.clouds_kept else "") + (topic.note and f": {topic.note}"),
            )
            for topic in report.topics
        ],
        left=("topic", "to", "what"),
    )
    converted = [topic for topic in report.topics if topic.action == "converted"]
    if converted:
        typer.echo()
        table(
            ("on", "points", "used", "NaN", "height", "range", "angle", "past end", "empty"),
            [
                (
                    topic.target or "-",
                    count(topic.points.total),
                    count(topic.points.used),
                    count(topic.points.nan),
                    count(topic.points.height),
                    count(topic.points.range),
                    count(topic.points.angle),
                    count(topic.points.past_end),
                    count(topic.empty_scans),
                )
                for topic in converted
            ],
            left=("on",),
        )
    typer.echo()
    for note in report.notes:
        typer.echo(printable(f"note: {note}"))
    _show_skipped(report, limit=len(report.skipped) if verbose else SHOWN)
    typer.echo(
        printable(
            f"{report.destination}: {size(report.bytes_written)} from {size(report.bytes_read)} "
            f"in {report.seconds:.1f} s"
        )
    )


def _show_skipped(report: Report, limit: int) -> None:
    """List skipped messages, those of one reason together, and what to do about the first."""
    reasons: dict[tuple[str, str], list[Skipped]] = {}
    for entry in report.skipped:
        reasons.setdefault((entry.topic, entry.reason), []).append(entry)
    shown = 0
    for (topic, reason), entries in list(reasons.items())[:limit]:
        first = entries[0]
        stamp = "unknown" if first.stamp_ns is None else stamp_text(first.stamp_ns)
        several = f" and {len(entries) - 1} more" if len(entries) > 1 else ""
        typer.echo(printable(f"skipped: {topic}, stamp {stamp}{several}: {reason}"), err=True)
        shown += len(entries)
    if report.skipped_count > shown:
        typer.echo(f"skipped: {report.skipped_count - shown:,} more (--verbose or --report tell them)", err=True)
    hints = [entry.hint for entry in report.skipped if entry.hint]
    if hints:
        typer.echo(printable(f"hint: {hints[0]}"), err=True)

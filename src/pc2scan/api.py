"""The library's front door to a whole conversion."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from .core.params import ProjectionParams
from .pipeline.frames import FrameOptions
from .pipeline.options import ConvertOptions, TimeBound, TopicRequest
from .pipeline.run import OutputOptions, Progress, run

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from .core.unproject import UnprojectParams
    from .pipeline.report import Report

__all__ = ["convert"]


def convert(
    sources: str | PathLike[str] | Sequence[str | PathLike[str]],
    destination: str | PathLike[str] | None = None,
    *,
    params: ProjectionParams | None = None,
    reverse: bool = False,
    channels: UnprojectParams | None = None,
    deskew: bool = False,
    frames: FrameOptions | None = None,
    topics: Iterable[str] = (),
    keep_clouds: bool = False,
    only_scans: bool = False,
    keep: Iterable[str] = (),
    drop: Iterable[str] = (),
    start: str | None = None,
    end: str | None = None,
    on_error: str = "skip",
    storage: str | None = None,
    compression: str | None = None,
    profile: str | None = None,
    metadata_version: int = 8,
    ros_distro: str = "",
    overwrite: bool = False,
    jobs: int = 0,
    verify: bool = True,
    strict: bool = False,
    progress: Progress | None = None,
) -> Report:
    """Convert recorded PointCloud2 to LaserScan, or back, as ``pc2scan convert`` does.

    Parameters
    ----------
    sources
        A recording, or several that are one: ROS 1 bag, rosbag2 directory, ``.db3`` or ``.mcap``.
    destination
        ``*.bag``: a ROS 1 bag; ``*.mcap``: an MCAP file; any other name: a rosbag2 directory. None: beside
        the first source, in its format, with ``_scan`` in its name.
    params
        The projection's parameters; None means upstream's defaults.
    reverse, channels, deskew
        The way back: LaserScan to PointCloud2, the fields of the clouds, and whether each beam is transformed by the
        pose at its own time.
    frames
        Where transforms come from, for a ``target_frame``; None means the sources' ``/tf`` and ``/tf_static``.
    topics
        What to convert, as ``/points`` or ``/points:=/scan``; empty means every PointCloud2 topic.
    keep_clouds, only_scans, keep, drop, on_error, ros_distro, jobs, verify, strict
        See `pc2scan.pipeline.options.ConvertOptions`.
    start, end
        Times as `pc2scan.pipeline.options.TimeBound.parse` reads them.
    storage, compression, profile, metadata_version, overwrite
        See `pc2scan.pipeline.run.OutputOptions`.
    progress
        Called now and then with bytes read, bytes in all, and messages read.

    Returns
    -------
    Report
        What happened, message by message and point by point; ``damage`` lists what is damaged in the sources.

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
    MessageError
        If ``on_error`` is ``fail`` and a message cannot be converted. After any error the destination is as it was.

    Examples
    --------
    >>> import pc2scan
    >>> params = pc2scan.ProjectionParams(min_height=-0.5, max_height=1.0)
    >>> report = pc2scan.convert("drive.bag", "scans.mcap", params=params)  # doctest: +SKIP
    >>> report.exit_status  # doctest: +SKIP
    0
    """
    paths = [sources] if isinstance(sources, str | PathLike) else sources
    options = ConvertOptions(
        params=params or ProjectionParams(),
        reverse=reverse,
        channels=channels,
        deskew=deskew,
        frames=frames or FrameOptions(),
        topics=tuple(TopicRequest.parse(topic) for topic in topics),
        keep_clouds=keep_clouds,
        only_scans=only_scans,
        keep=tuple(keep),
        drop=tuple(drop),
        start=None if start is None else TimeBound.parse(start),
        end=None if end is None else TimeBound.parse(end),
        on_error=on_error,
        ros_distro=ros_distro,
        jobs=jobs,
        verify=verify,
        strict=strict,
    )
    output = OutputOptions(
        storage=storage,
        compression=compression,
        profile=profile,
        metadata_version=metadata_version,
        overwrite=overwrite,
    )
    return run(
        [Path(path) for path in paths],
        None if destination is None else Path(destination),
        options,
        output,
        progress=progress,
    )

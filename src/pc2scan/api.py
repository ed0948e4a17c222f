"""The library's front door to a whole conversion."""

from __future__ import annotations

import os
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.compare.diff import TopicPair
from pc2scan.compare.diff import diff as compare
from pc2scan.compare.rules import Rules
from pc2scan.core.params import ProjectionParams
from pc2scan.pipeline.options import ConvertOptions, destination_and_folder
from pc2scan.pipeline.run import OutputOptions, Progress, run
from pc2scan.tf.options import FrameOptions
from pc2scan.tf.reading import recorded_transforms

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pc2scan.compare.result import Difference
    from pc2scan.core.unproject import UnprojectParams
    from pc2scan.pipeline.report import Report
    from pc2scan.pipeline.stages.filters import Filter

__all__ = ["convert", "diff"]


def convert(
    sources: str | PathLike[str] | Sequence[str | PathLike[str]],
    destination: str | PathLike[str] | None = None,
    *,
    params: ProjectionParams | None = None,
    reverse: bool = False,
    channels: UnprojectParams | None = None,
    deskew: bool = False,
    filters: Iterable[Filter] = (),
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
    to: str | None = None,
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
        ``*.bag``: a ROS 1 bag; ``*.mcap``: an MCAP file; text that ends with a slash: into that folder, named after
        the first source; any other name: a rosbag2 directory. None: next to the first source, in its format, with
        ``_scan`` in its name.
    params
        The projection's parameters; None means upstream's defaults.
    reverse, channels, deskew
        The way back: LaserScan to PointCloud2, the fields of the clouds, and whether each beam is transformed by the
        pose at its own time.
    filters
        What selects points of clouds before they are projected, in order; see `pc2scan.pipeline.stages.filters.Filter`.
    frames
        Where transforms come from, for a ``target_frame``; None means the sources' ``/tf`` and ``/tf_static``.
    topics
        What to convert, as ``/points`` or ``/points:=/scan``; empty means every PointCloud2 topic.
    keep_clouds, only_scans, keep, drop, on_error, ros_distro, jobs, verify, strict
        See `pc2scan.pipeline.options.ConvertOptions`.
    start, end
        Times as `pc2scan.pipeline.options.TimeBound.parse` reads them.
    storage, compression, profile, metadata_version, to, overwrite
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
    options = ConvertOptions.of(
        params=params or ProjectionParams(),
        reverse=reverse,
        channels=channels,
        deskew=deskew,
        filters=tuple(filters),
        frames=frames or FrameOptions(),
        topics=topics,
        keep_clouds=keep_clouds,
        only_scans=only_scans,
        keep=keep,
        drop=drop,
        start=start,
        end=end,
        on_error=on_error,
        ros_distro=ros_distro,
        jobs=jobs,
        verify=verify,
        strict=strict,
    )
    path, folder = destination_and_folder(destination if destination is None else os.fspath(destination))
    output = OutputOptions(
        storage=storage,
        compression=compression,
        profile=profile,
        metadata_version=metadata_version,
        overwrite=overwrite,
        folder=folder,
        to=to,
    )
    return run(
        [Path(path) for path in paths],
        path,
        options,
        output,
        progress=progress,
    )


def diff(
    a: str | PathLike[str],
    b: str | PathLike[str] | None = None,
    *,
    topics: Iterable[str] = (),
    all_topics: bool = False,
    atol: float | Mapping[str, float] = 0.0,
    rtol: float | Mapping[str, float] = 0.0,
    allow_beams: float = 0.0,
    ignore: Iterable[str] = (),
    explain: bool = False,
    clouds: str | PathLike[str] | None = None,
) -> Difference:
    """Compare the scans and clouds of two recordings, as ``pc2scan diff`` does.

    Parameters
    ----------
    a, b
        ``a`` is the reference. ``b`` left out: ``a`` itself, for two topics of it.
    topics
        What to compare, as ``/scan`` or ``/scan:=/scan2``; empty means every LaserScan and PointCloud2 topic.
    all_topics
        Whether the other topics are compared too: matched by log time, byte for byte.
    atol, rtol, allow_beams, ignore
        See `pc2scan.compare.rules.Rules`; a tolerance that is a number is for all values.
    explain
        Whether to find out how many differing beams another libm explains: `Explanation` at each topic's ``libm``.
    clouds
        The recording with the clouds that the scans were made of; None: ``a``, or where it has none, ``b``. Given,
        differing beams are explained.

    Returns
    -------
    Difference
        ``same`` tells whether there is none; as text it is what the command prints.

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
    rules = Rules(
        atol=atol if isinstance(atol, Mapping) else {"": atol},
        rtol=rtol if isinstance(rtol, Mapping) else {"": rtol},
        allow_beams=allow_beams,
        ignore=frozenset(ignore),
    )
    pairs = [TopicPair.parse(topic) for topic in topics]
    return compare(
        Path(a),
        None if b is None else Path(b),
        topics=pairs,
        all_topics=all_topics,
        rules=rules,
        transforms_of=recorded_transforms if explain or clouds is not None else None,
        clouds=None if clouds is None else Path(clouds),
    )

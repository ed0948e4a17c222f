"""Translates the names of options from Python to the command line.

The library's messages name an option as in Python, in backticks: ```overwrite=True` replaces it``. The command shows
``--overwrite replaces it``.
"""

from __future__ import annotations

import re

from pc2scan.pipeline.parameters import PARAMETERS

__all__ = ["OPTIONS", "as_typed"]

_NAMED = re.compile(r"`([a-z_]+)(?:=([^`]*))?`")

#: The options that messages name: their name in the library, and on the command line.
OPTIONS = {
    **{name: parameter.option for name, parameter in PARAMETERS.items()},
    "accumulate": "--accumulate",
    "all_topics": "--all-topics",
    "base_frame": "--base-frame",
    "channels": "--channel",
    "clear_to": "--clear-to",
    "clouds": "--clouds",
    "compression": "--compression",
    "deskew": "--deskew",
    "destination": "-o",
    "drop": "--drop",
    "dry_run": "--dry-run",
    "each": "--each",
    "end": "--end",
    "every": "--every",
    "exclude_box": "--exclude-box",
    "exclude_polygon": "--exclude-polygon",
    "export": "--export",
    "fail_on": "--fail-on",
    "fixed_frame": "--fixed-frame",
    "format": "--format",
    "ground": "--ground",
    "ignore": "--ignore",
    "imu": "--imu",
    "keep": "--keep",
    "keep_clouds": "--keep-clouds",
    "lead": "--lead",
    "at": "--at",
    "keep_used": "--keep-used",
    "launch_args": "--arg",
    "level": "--level",
    "max_range": "--max-range",
    "metadata_version": "--metadata-version",
    "min_height_slope": "--min-height-slope",
    "min_used": "--min-used",
    "node": "--node",
    "odom_frame": "--odom-frame",
    "odom_topic": "--odom-topic",
    "only_scans": "--only-scans",
    "on_error": "--on-error",
    "overwrite": "--overwrite",
    "params_file": "--params-file",
    "png": "--png",
    "pose_frame": "--pose-frame",
    "preset": "--preset",
    "point_time": "--point-time",
    "profile": "--profile",
    "range_cutoff": "--range-cutoff",
    "rebin": "--rebin",
    "repeat_latched": "--repeat-latched",
    "scratch": "--scratch",
    "scratch_size": "--scratch-size",
    "report": "--report",
    "resolution": "--resolution",
    "reverse": "--reverse",
    "remove": "--remove",
    "ros_distro": "--ros-distro",
    "source_frame": "--source-frame",
    "stamp": "--stamp",
    "split": "--split",
    "start": "--start",
    "remap": "--remap",
    "samples": "--samples",
    "scans": "--scans",
    "static_tf": "--static-tf",
    "static_tf_file": "--static-tf-file",
    "storage": "--storage",
    "strict": "--strict",
    "tf_from": "--tf-from",
    "tf_topics": "--tf-topic",
    "to": "--to",
    "topics": "--topic",
    "update": "--update",
    "where": "--where",
    "checksum": "--checksum",
    "dask": "--dask",
    "dataset": "--dataset",
    "fail_fast": "--fail-fast",
    "force": "--force",
    "jobs": "--jobs",
    "retries": "--retries",
    "param": "--param",
    "window": "--window",
    "write_static_tf": "--write-static-tf",
}


def as_typed(text: str) -> str:
    """Return a text with its options as they are typed; other text in backticks is unchanged.

    >>> as_typed("`overwrite=True` replaces it; `topics=/points:=/b` is free; see `min_height` and `ls`")
    '--overwrite replaces it; --topic /points:=/b is free; see --min-height and `ls`'
    """
    return _NAMED.sub(_spelled, text) if "`" in text else text


def _spelled(named: re.Match[str]) -> str:
    name, value = named.groups()
    option = OPTIONS.get(name)
    if option is None:
        return named[0]
    return option if value in (None, "True") else f"{option} {value}"

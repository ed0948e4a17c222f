"""The command that most users run after a recording was written."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from pc2scan.bags.formats import FORMATS
from pc2scan.pipeline.parameters import from_preset

if TYPE_CHECKING:
    from pc2scan.pipeline.report import Report

#: More files than these are written as a pattern.
_NAMED = 3


def next_line(report: Report) -> str:
    """Return the last line of a conversion: ``next: COMMAND``."""
    return f"next: {_next_command(report)}"


def _next_command(report: Report) -> str:
    """Return the command: quoted for a shell, and right for the destination's container and ROS version."""
    destination = _destination(report)
    if report.all_empty:
        return f"pc2scan info {_quoted(report.sources[0])}"
    consumer = next((origin.split()[-1] for origin in report.origins.values() if from_preset(origin)), "")
    if consumer:
        return f"pc2scan check {destination} --for {consumer}"
    if not any(topic.action == "converted" for topic in report.topics):
        return f"pc2scan info {destination}"
    entry = FORMATS[report.container]
    is_one = entry.is_directory or len(report.files) < 2
    if entry.play and entry.ros_version == report.ros_version and (is_one or entry.plays_several):
        return entry.play.format(destination)
    # For the rest there is no player: none of ROS 1 reads MCAP, and that of ROS 2 reads only one file.
    return f"pc2scan check {destination}"


def _destination(report: Report) -> str:
    """Return the destination quoted for the shell: the recording, or a pattern for all its files."""
    if not report.files or FORMATS[report.container].is_directory:
        return _quoted(report.destination)
    if len(report.files) <= _NAMED:
        return " ".join(map(_quoted, report.files))
    stem, _, rest = report.files[0].rpartition("_0")
    return f"{_quoted(stem)}_*{shlex.quote(rest)}"


def _quoted(path: str) -> str:
    return shlex.quote(f"./{path}" if path.startswith("-") else path)

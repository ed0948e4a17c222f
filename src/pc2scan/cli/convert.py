"""``pc2scan convert`` and ``pc2scan repair``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.bags.formats import FORMATS
from pc2scan.conversion.run import convert as convert_by
from pc2scan.conversion.run import repair as repair_by
from pc2scan.files.urls import is_url
from pc2scan.options.call import Options
from pc2scan.request.parameters import preset_of
from pc2scan.text import shell_word

from .render import LiveWarnings, progress_bar, say, show

if TYPE_CHECKING:
    from pc2scan.conversion.report import Report


def convert(sources: list[Path], destination: str | None, *, options: Options) -> int:
    """Convert a recording."""
    # Remappings and parameters as rosrun has them. Names with two underscores are the node's own.
    words = [word for word in map(str, sources) if ":=" in word and not word.startswith("__")]
    if words:
        params = [word for word in words if word.startswith("_")]
        remaps = [word for word in words if not word.startswith("_")]
        options = options.with_further({"param": params, "remap": remaps})
    recordings = [source for source in sources if ":=" not in str(source)]
    warn = LiveWarnings()
    with progress_bar(options) as progress:
        result = convert_by(recordings, destination, options, warn=warn, progress=progress)
    status = show(result, options, known=warn)
    if not result.dry_run:
        _say_next(result, options)
    return status


def repair(source: Path, destination: str | None, *, options: Options) -> int:
    """Write what can be recovered of a damaged recording."""
    with progress_bar(options) as progress:
        result = repair_by(source, destination, options, progress=progress)
    status = show(result, options)
    _say_next(result, options)
    return status


def _say_next(report: Report, options: Options) -> None:
    """Show the command that most users run after a recording was written: scans are checked, clouds are played."""
    if not options.given.keys() & {"quiet", "as_json"}:
        say(f"next: {_next_command(report)}")


def _next_command(report: Report) -> str:
    """Return the next command: quoted for a shell, and right for the destination's container and ROS version."""
    entry, destination = FORMATS[report.container], _quoted(report.destination)
    if report.all_empty:
        return f"pc2scan info {_quoted(report.sources[0])}"
    if consumer := next(filter(None, map(preset_of, report.origins.values())), ""):
        return f"pc2scan check {destination} --for {consumer}"
    specs = [topic.spec for topic in report.converted]
    if any(spec is not None and not spec.reverse for spec in specs):
        return f"pc2scan check {destination}"
    if specs and entry.play and entry.ros_version == report.ros_version and not is_url(report.destination or ""):
        return entry.play.format(destination)
    # For the rest there is no player: none reads URLs, and none of ROS 1 reads MCAP.
    return f"pc2scan info {destination}"


def _quoted(path: str) -> str:
    return shell_word(f"./{path}" if path.startswith("-") else path)

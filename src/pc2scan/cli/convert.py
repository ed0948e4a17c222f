"""``pc2scan convert`` and ``pc2scan repair``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.bags.formats import FORMATS
from pc2scan.conversion.run import convert as convert_by
from pc2scan.conversion.run import repair as repair_by
from pc2scan.files.paths import is_url
from pc2scan.options.call import Options
from pc2scan.request.precedence import preset_of
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
    if options.given.keys() & {"quiet", "as_json"}:
        return
    path = report.sources[0] if report.all_empty else report.destination
    quoted = shell_word(f"./{path}" if path.startswith("-") else path)
    entry, specs = FORMATS[report.container], [topic.spec for topic in report.converted if not report.all_empty]
    # Also where there is no player: none reads URLs, and none of ROS 1 reads MCAP.
    command = f"pc2scan info {quoted}"
    if specs and (consumer := next(filter(None, map(preset_of, report.scans[0].origins.values())), "")):
        command = f"pc2scan check {quoted} --for {consumer}"
    elif any(spec is not None and not spec.reverse for spec in specs):
        command = f"pc2scan check {quoted}"
    elif specs and entry.play and entry.ros_version == report.ros_version and not is_url(report.destination or ""):
        command = entry.play.format(quoted)
    say(f"next: {command}")

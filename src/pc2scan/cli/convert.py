"""``pc2scan convert``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.bags.formats import FORMATS
from pc2scan.files.urls import is_url
from pc2scan.options.call import Options
from pc2scan.request.parameters import preset_of
from pc2scan.requests import convert as run
from pc2scan.text import shell_word

from .render import LiveWarnings, progress_bar, say, show

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pc2scan.conversion.report import Report


def convert(sources: list[Path], destination: str | None, *, options: Options) -> int:
    """Convert a recording."""
    sources, further = _ros_arguments(sources)
    if further:
        options = options.with_further(further)
    warn = LiveWarnings()
    with progress_bar(enabled=not options.quiet) as progress:
        result = run(sources, destination, options, warn=warn, progress=progress)
    show(result, quiet=options.quiet, verbose=options.verbose, known=warn)
    if not options.quiet and not result.dry_run:
        say(f"next: {next_command(result)}")
    return result.exit_status


def _ros_arguments(words: Iterable[Path]) -> tuple[list[Path], dict[str, list[str]]]:
    """Split the positional arguments into recordings, and remappings and parameters as ``rosrun`` reads them."""
    sources: list[Path] = []
    further: dict[str, list[str]] = {}
    for word in words:
        text = str(word)
        if ":=" not in text:
            sources.append(word)
        elif not text.startswith("__"):
            further.setdefault("param" if text.startswith("_") else "remap", []).append(text)
    return sources, further


def next_command(report: Report) -> str:
    """Return the command that most users run after a recording was written: scans are checked, clouds are played.

    It is quoted for a shell, and right for the destination's container and ROS version.
    """
    entry = FORMATS[report.container]
    destination = _quoted(report.destination)
    if report.all_empty:
        return f"pc2scan info {_quoted(report.sources[0])}"
    consumer = next(filter(None, map(preset_of, report.origins.values())), "")
    if consumer:
        return f"pc2scan check {destination} --for {consumer}"
    converted = [topic.spec for topic in report.converted]
    if any(spec is not None and not spec.reverse for spec in converted):
        return f"pc2scan check {destination}"
    is_playable = entry.ros_version == report.ros_version
    if converted and entry.play and is_playable and not is_url(report.destination):
        return entry.play.format(destination)
    # For the rest there is no player: none reads URLs, and none of ROS 1 reads MCAP.
    return f"pc2scan info {destination}"


def _quoted(path: str) -> str:
    return shell_word(f"./{path}" if path.startswith("-") else path)

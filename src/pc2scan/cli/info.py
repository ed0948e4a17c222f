"""``pc2scan info``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.options.call import Options
from pc2scan.requests import OF_FRAMES, frames_of
from pc2scan.show.info import info as describe

from .render import show


def info(sources: list[Path], *, options: Options) -> int:
    """Describe a recording."""
    result = describe(
        sources,
        described=options.topics,
        frames=frames_of(options),
        given=options.among({*OF_FRAMES, "cloud_scale"}),
        **options.among(("target_frame", "cloud_scale")),
    )
    show(result, as_json=options.as_json)
    return result.exit_status

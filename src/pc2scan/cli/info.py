"""``pc2scan info``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.options.call import Options
from pc2scan.show.info import info as describe

from .render import show


def info(sources: list[Path], *, options: Options) -> int:
    """Describe a recording."""
    return show(describe(sources, options), options)

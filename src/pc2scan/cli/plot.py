"""``pc2scan plot``."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

from pc2scan.files.paths import path_or_url
from pc2scan.options.call import Options
from pc2scan.show.plot import plot as draw

from .render import LiveWarnings, show


def plot(sources: list[Path], destination: str, *, options: Options) -> int:
    """Draw clouds."""
    warn = LiveWarnings()
    with TemporaryDirectory(prefix="pc2scan-fonts-") as folder:
        # For matplotlib's list of fonts, which would be written into the user's home.
        os.environ.setdefault("MPLCONFIGDIR", folder)
        figure = draw(sources, path_or_url(destination), options, warn=warn)
    return show(figure, options, known=warn)

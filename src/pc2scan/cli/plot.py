"""``pc2scan plot``."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from pc2scan.files.urls import path_or_url
from pc2scan.options.call import Options
from pc2scan.show.plot import plot as run

from .render import LiveWarnings, show

if TYPE_CHECKING:
    from collections.abc import Iterator

_WHERE = "MPLCONFIGDIR"


def plot(sources: list[Path], destination: str, *, options: Options) -> int:
    """Draw clouds."""
    warn = LiveWarnings()
    with _temporary_fonts():
        drawn = run(sources, path_or_url(destination), options, warn=warn)
    show(drawn, known=warn)
    return drawn.exit_status


@contextmanager
def _temporary_fonts() -> Iterator[None]:
    """Make matplotlib write its list of fonts into a temporary folder, unless the user has set MPLCONFIGDIR.

    By default it is in the user's home. The library changes no setting of matplotlib, because it may run in another
    program's process.
    """
    if os.environ.get(_WHERE):
        yield
        return
    with TemporaryDirectory(prefix="pc2scan-fonts-") as folder:
        os.environ[_WHERE] = folder
        try:
            yield
        finally:
            del os.environ[_WHERE]

"""Keeps matplotlib's list of fonts out of the user's home.

By default matplotlib writes this list into the home folder. The command makes matplotlib write it into a temporary
folder, which costs a tenth of a second or more. The library changes no setting of matplotlib, because it may run in
another program's process.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

_WHERE = "MPLCONFIGDIR"


@contextmanager
def fonts_noted_elsewhere() -> Iterator[None]:
    """Make matplotlib use a temporary folder, unless the user has set MPLCONFIGDIR."""
    if os.environ.get(_WHERE):
        yield
        return
    from tempfile import TemporaryDirectory

    with TemporaryDirectory(prefix="pc2scan-fonts-") as folder:
        os.environ[_WHERE] = folder
        try:
            yield
        finally:
            del os.environ[_WHERE]

"""Where matplotlib notes which fonts there are, while the command runs.

By itself it writes that into the user's home. The command has it written into a folder that is gone at the end, which
takes a tenth of a second or more. The library leaves matplotlib as it finds it: its process may be somebody else's.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["fonts_noted_elsewhere"]

_WHERE = "MPLCONFIGDIR"


@contextmanager
def fonts_noted_elsewhere() -> Iterator[None]:
    """Keep matplotlib out of the user's home, unless the user says where its files are."""
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

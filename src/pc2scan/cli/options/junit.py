"""Options about JUnit XML.

No ``from __future__ import annotations`` here: see `pc2scan.cli.groups.Group`.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pc2scan.cli.groups import Group
from pc2scan.errors import UsageError

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from pc2scan.files.junit import JUnitCase

__all__ = ["JUnitGroup"]


class JUnitGroup(Group):
    """Options about JUnit XML."""

    junit: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the results as JUnit XML, for CI systems.")
    ] = None
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the file of --junit, whatever it contains.")
    ] = False

    def writing(
        self, command: str, inputs: Iterable[Path] = ()
    ) -> "AbstractContextManager[Callable[[Iterable[JUnitCase]], None]]":
        """Check that the file can be written; the context is the function that writes it."""
        if self.overwrite and self.junit is None:
            raise UsageError("--overwrite has no effect without --junit")
        from pc2scan.files.junit import junit_file

        return junit_file(self.junit, command, inputs, overwrite=self.overwrite, option="--junit")

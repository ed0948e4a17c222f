"""A progress bar on standard error, on a terminal only."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@contextmanager
def progress_bar(*, enabled: bool) -> Iterator[Callable[[int, int, int], None] | None]:
    """Show bytes, messages, rate and the remaining time; yields the function that updates the bar, or None.

    The function takes the bytes read so far, the total bytes, and the messages read so far.
    """
    if not enabled or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )

    with Progress(
        BarColumn(),
        DownloadColumn(),
        TextColumn("{task.fields[messages]:,} messages"),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        # `Screen` writes warnings above the bar, fitted to the terminal; rich would write them as they are.
        redirect_stdout=False,
        redirect_stderr=False,
    ) as bar:
        task = bar.add_task("convert", total=None, messages=0)

        def update(done: int, total: int, messages: int) -> None:
            bar.update(task, completed=done, total=total, messages=messages)

        yield update

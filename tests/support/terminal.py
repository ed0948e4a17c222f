"""What the command shows on a terminal, in a process of its own."""

from __future__ import annotations

import fcntl
import os
import pty
import struct
import subprocess
import termios
from typing import TYPE_CHECKING

from support.command import COMMAND, environment

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["shown"]


def shown(*arguments: str | Path, columns: int | None = None, **variables: str) -> str:
    """What a command prints on a pipe, or with ``columns`` on a terminal so wide."""
    command = [*COMMAND, *map(str, arguments)]
    env = {name: value for name, value in environment().items() if name not in ("COLUMNS", "NO_COLOR", "FORCE_COLOR")}
    env |= {"TERM": "xterm", **variables}
    if columns is None:
        done = subprocess.run(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=env, timeout=120, check=False
        )
        return done.stdout
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=env)
    os.close(theirs)
    data = b""
    while True:
        try:
            piece = os.read(ours, 65536)
        except OSError:  # the terminal was closed
            break
        if not piece:
            break
        data += piece
    process.wait(60)
    os.close(ours)
    return data.decode().replace("\r\n", "\n")

"""Runs commands one after the other, each in a child of this process, while the system's calls are traced.

Jobs are read from standard input, as JSON: a list of objects with ``arguments``, ``folder`` and ``seconds``. For each a
line of JSON is written: the exit status, and the end of what it printed. A child finds all modules loaded, so that a
command takes milliseconds. Before a job, the trace gets a mark: the name of a file that is not there, `MARK` and the
job's number.
"""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import shutil
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pc2scan
from pc2scan.cli import main as command

if TYPE_CHECKING:
    from collections.abc import Callable

#: What is loaded only where it is needed, and takes long.
_LATE = ("ruamel.yaml", "rosbags.typesys.stores.ros1_noetic", "rosbags.typesys.stores.ros2_jazzy")

#: What begins the name that marks a job in the trace.
MARK = "/pc2scan-job-"


def load_everything() -> None:
    """Import all modules of the package, and with them what they need."""
    for module in pkgutil.walk_packages(pc2scan.__path__, "pc2scan."):
        # The entry point runs the command.
        if module.name != "pc2scan.__main__":
            importlib.import_module(module.name)
    for name in _LATE:
        importlib.import_module(name)


def elsewhere(path: Path) -> None:
    """Go to a file's folder, and write to it by its name alone."""
    os.chdir(path.parent)
    Path(path.name).write_text("x")


def misbehave(what: str, target: str) -> None:
    """Do what no command may do, for the test that this is seen."""
    path = Path(target)
    other = path.with_name("other")
    ways: dict[str, Callable[[], object]] = {
        "write": lambda: path.write_text("x"),
        "append": lambda: path.open("ab").close(),
        "update": lambda: path.open("rb+").close(),
        "create": other.touch,
        "truncate": lambda: os.truncate(path, 0),
        "remove": path.unlink,
        "remove from a folder": lambda: shutil.rmtree(path.parent),
        "rename": lambda: path.rename(other),
        "replace": lambda: (path.parent / "new").replace(path),
        "link": lambda: os.link(path, other),
        "symlink": lambda: other.symlink_to(path),
        "mode": lambda: path.chmod(0o600),
        "owner": lambda: os.chown(path, os.getuid(), os.getgid()),
        "times": lambda: os.utime(path),
        "attribute": lambda: os.setxattr(path, "user.x", b"x"),
        "folder": other.mkdir,
        "fifo": lambda: os.mkfifo(other),
        "through a link": lambda: (path.parent / "out" / "link").write_text("x"),
        "mode of an open file": lambda: os.fchmod(os.open(path, os.O_RDONLY), 0o600),
        "in another folder": lambda: elsewhere(path),
        "nothing": path.read_text,
        "by another program": lambda: os.execv("/bin/rm", ["rm", str(path)]),
    }
    with suppress(OSError):
        ways[what]()


def run(arguments: list[str], folder: str, seconds: int) -> tuple[int, str]:
    """Run one command in a child; returns its exit status and what it printed."""
    reading, writing = os.pipe()
    process = os.fork()
    if process == 0:
        os.chdir(folder)
        os.dup2(writing, 1)
        os.dup2(writing, 2)
        # A command that hangs is ended, and its status says so.
        signal.alarm(seconds)
        status = 70
        try:
            if arguments[0] == "misbehave":
                misbehave(*arguments[1:])
                status = 0
            elif arguments[0] == "execute":
                os.execv(arguments[1], arguments[1:])
            else:
                sys.argv[1:] = arguments
                command()
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 1
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        said = stream.read().decode()
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), said[-2000:]


def main() -> None:
    """Run the jobs."""
    load_everything()
    for number, job in enumerate(json.load(sys.stdin)):
        with suppress(OSError):
            os.close(os.open(f"{MARK}{number}", os.O_RDONLY))
        status, said = run(**job)
        # Not through a buffer, which the next child would have too.
        os.write(1, (json.dumps([status, said]) + "\n").encode())


if __name__ == "__main__":
    main()

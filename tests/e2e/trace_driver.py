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


def _other(path: Path) -> Path:
    return path.with_name("other")


#: What no command may do to a file, and the name of what is touched.
WAYS: dict[str, tuple[Callable[[Path], object], str]] = {
    "nothing": (Path.read_text, ""),
    "write": (lambda path: path.write_text("x"), "target"),
    "append": (lambda path: path.open("ab").close(), "target"),
    "update": (lambda path: path.open("rb+").close(), "target"),
    "create": (lambda path: _other(path).touch(), "other"),
    "truncate": (lambda path: os.truncate(path, 0), "target"),
    "remove": (Path.unlink, "target"),
    "remove from a folder": (lambda path: shutil.rmtree(path.parent), "target"),
    "rename": (lambda path: path.rename(_other(path)), "other"),
    "replace": (lambda path: (path.parent / "new").replace(path), "new"),
    "link": (lambda path: os.link(path, _other(path)), "other"),
    "symlink": (lambda path: _other(path).symlink_to(path), "other"),
    "mode": (lambda path: path.chmod(0o600), "target"),
    "owner": (lambda path: os.chown(path, os.getuid(), os.getgid()), "target"),
    "times": (os.utime, "target"),
    "attribute": (lambda path: os.setxattr(path, "user.x", b"x"), "target"),
    "folder": (lambda path: _other(path).mkdir(), "other"),
    "fifo": (lambda path: os.mkfifo(_other(path)), "other"),
    "through a link": (lambda path: (path.parent / "out" / "link").write_text("x"), "target"),
    "mode of an open file": (lambda path: os.fchmod(os.open(path, os.O_RDONLY), 0o600), "target"),
    "in another folder": (elsewhere, "target"),
    "by another program": (lambda path: os.execv("/bin/rm", ["rm", str(path)]), "target"),
}


def misbehave(what: str, target: str) -> None:
    """Do what no command may do, for the test that this is seen."""
    with suppress(OSError):
        WAYS[what][0](Path(target))


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

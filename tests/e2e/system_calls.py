"""What commands do to files, as the system's calls tell: run under strace."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from e2e.trace_driver import MARK
from support.command import environment

__all__ = ["Job", "Touch", "Traced", "no_tracer", "trace"]

#: Every call that can change a file, a folder or what leads to one, where the system has it.
_CHANGING = (
    *("mkdir", "mkdirat", "mknod", "mknodat", "rename", "renameat", "renameat2", "rmdir", "unlink", "unlinkat"),
    *("link", "linkat", "symlink", "symlinkat", "truncate", "truncate64", "ftruncate", "ftruncate64", "fallocate"),
    *("chmod", "fchmod", "fchmodat", "fchmodat2", "chown", "fchown", "lchown", "fchownat"),
    *("utime", "utimes", "futimesat", "utimensat"),
    *("setxattr", "lsetxattr", "fsetxattr", "removexattr", "lremovexattr", "fremovexattr"),
    *("mount", "umount2", "pivot_root", "chroot", "open_by_handle_at", "io_uring_setup"),
    # What changes nothing here may do so elsewhere.
    *("socket", "connect", "bind"),
)
_OPENING = ("creat", "open", "openat", "openat2")
_MOVING = ("chdir", "fchdir")

#: Of these, the first path is only read, or is a text.
_SECOND_PATH_ONLY = {"symlink", "symlinkat"}
#: Of these, what follows the first path is no path.
_FIRST_PATH_ONLY = {"setxattr", "lsetxattr", "removexattr", "lremovexattr"}
#: Of these, no text is a path.
_NO_PATH = {"fsetxattr", "fremovexattr"}
_WRITING = re.compile(r"O_(WRONLY|RDWR|CREAT|TRUNC|APPEND|TMPFILE)")

_CALL = re.compile(r"(\d+) +(\w+)\((.*)")
_RESUMED = re.compile(r"(\d+) +<\.\.\. (\w+) resumed>(.*)")
_RETURNED = re.compile(r"\) += \d+<(.*)>$")
#: A path, with the folder that it is relative to where the call has one; or only an open file.
_ARGUMENT = re.compile(r'(?:(?:AT_FDCWD|\d+)<((?:[^>\\]|\\.)*)>, )?"((?:[^"\\]|\\.)*)"(\.\.\.)?|\d+<((?:[^>\\]|\\.)*)>')


class Job(NamedTuple):
    """A command, the folder that it runs in, and what it may write."""

    arguments: tuple[str, ...]
    folder: Path
    writes: tuple[Path, ...] = ()
    seconds: int = 100


class Touch(NamedTuple):
    """A call that changes what is at a path, or would if it succeeded."""

    call: str
    path: Path


class Traced(NamedTuple):
    """How a job ended, what it printed, and what it touched."""

    job: Job
    status: int
    said: str
    touched: tuple[Touch, ...]


def no_tracer() -> str | None:
    """Why nothing can be traced here; None if it can."""
    if sys.platform != "linux":
        return "only Linux has strace"
    if shutil.which("strace") is None:
        return "strace is not installed"
    tried = subprocess.run(_strace(Path(os.devnull), "true"), capture_output=True, text=True, check=False)
    return f"strace cannot be used here: {tried.stderr.strip()}" if tried.returncode else None


def trace(jobs: list[Job], folder: Path) -> list[Traced]:
    """Run jobs one after the other.

    Parameters
    ----------
    folder
        For the trace, and for the commands' temporary files; the latter have a folder of their own in it.
    """
    log, temporary = folder / "trace.txt", folder / "temporary"
    temporary.mkdir()
    given = [{"arguments": job.arguments, "folder": str(job.folder), "seconds": job.seconds} for job in jobs]
    done = subprocess.run(
        _strace(log, sys.executable, "-m", "e2e.trace_driver"),
        input=json.dumps(given),
        capture_output=True,
        text=True,
        # What the interpreter compiles it keeps beside the modules.
        env={**_environment(), "TMPDIR": str(temporary), "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"},
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    ends = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(ends) == len(jobs), done.stderr[-2000:]
    assert list(temporary.iterdir()) == [], "temporary files are left"
    touched = _read(log.read_text("utf-8", "surrogateescape").splitlines(), [job.folder for job in jobs])
    return [
        Traced(job, status, said, tuple(touch for touch in touches if not touch.path.is_relative_to(temporary)))
        for job, (status, said), touches in zip(jobs, ends, touched, strict=True)
    ]


def _environment() -> dict[str, str]:
    inherited = environment()
    tests = str(Path(__file__).parents[1])
    return {**inherited, "PYTHONPATH": os.pathsep.join(filter(None, (tests, inherited.get("PYTHONPATH"))))}


def _strace(log: Path, *command: str) -> list[str]:
    # Of a call that a processor's system does not have, the question mark makes no error.
    calls = ",".join(f"?{call}" for call in (*_CHANGING, *_OPENING, *_MOVING))
    return ["strace", "--seccomp-bpf", "-f", "-y", "-s", "5000", "-o", str(log), "-e", f"trace={calls}", *command]


def _read(lines: list[str], folders: list[Path]) -> list[list[Touch]]:
    """What each job touched; what the driver does before the first must be nothing."""
    found: list[list[Touch]] = [[]]
    folder = Path("/")
    opening: dict[str, str] = {}
    for line in lines:
        if resumed := _RESUMED.fullmatch(line):
            call = opening.pop(resumed[1], None)
            if call and (opened := _RETURNED.search(line)):
                found[-1].append(Touch(f"{call}, leads to", _path(opened[1])))
            continue
        if (started := _CALL.match(line)) is None:
            # Signals, and ends of processes.
            continue
        process, call, arguments = started.groups()
        if f'"{MARK}' in arguments:
            found.append([])
            folder = folders[len(found) - 2]
            continue
        if call in _OPENING and call != "creat" and not _WRITING.search(_ARGUMENT.sub("", arguments)):
            continue
        paths = _paths(call, arguments, folder)
        if call in _MOVING:
            folder = paths[0]
            continue
        found[-1] += [Touch(call, path) for path in paths]
        if call in _OPENING and line.endswith("<unfinished ...>"):
            opening[process] = call
        elif call in _OPENING and (opened := _RETURNED.search(line)):
            found[-1].append(Touch(f"{call}, leads to", _path(opened[1])))
    assert found[0] == [], "loading the modules touches files"
    return found[1:]


def _paths(call: str, arguments: str, folder: Path) -> list[Path]:
    """What a call names, or has open."""
    paths = []
    for base, text, cut, opened in _ARGUMENT.findall(arguments.partition(") = ")[0]):
        assert not cut, f"the trace has only a part of: {text}"
        if opened or (call in _NO_PATH and base):
            paths.append(_path(opened or base))
        elif call not in _NO_PATH:
            paths.append(Path(os.path.normpath(folder / _path(base) / _path(text))))
    if call in _SECOND_PATH_ONLY:
        paths = paths[1:]
    if call in _FIRST_PATH_ONLY:
        paths = paths[:1]
    # What cannot be read must not pass unseen.
    return paths or [Path(f"/unknown: {arguments}")]


def _path(text: str) -> Path:
    """A path of the trace, where bytes that are not printable have a backslash."""
    decoded: bytes = ast.literal_eval(f'b"{text}"')
    return Path(os.fsdecode(decoded))

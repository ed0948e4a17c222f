"""The way of a cloud through the code: what runs between the command and the arithmetic, as the interpreter reports it.

    PYTHONPATH=tests python -m support.way_of_a_cloud fixtures/hall.bag --min-height -0.3 --deskew

runs ``pc2scan convert`` with these arguments, and prints the way as JSON.
"""

from __future__ import annotations

import gc
import inspect
import json
import os
import subprocess
import sys
import threading
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import pc2scan
from support import ROOT

if TYPE_CHECKING:
    from types import CodeType, FrameType

_PACKAGE = f"{Path(pc2scan.__file__).parent}{os.sep}"


class Way(NamedTuple):
    """What a conversion runs.

    Attributes
    ----------
    frames
        The deepest chain of calls, on one thread, that ends with the projection: name and file of each function.
    functions
        How many functions of pc2scan run. A comprehension or a generator expression is part of its function.
    files
        How many files of pc2scan have functions that run.
    classes
        How many classes of pc2scan have instances whenever a cloud is projected.
    decompressions
        How often each chunk is decompressed, by its offset in the recording.
    """

    frames: list[tuple[str, str]]
    functions: int
    files: int
    classes: int
    decompressions: dict[int, int]


def way_of(*arguments: str) -> Way:
    """Run ``pc2scan convert`` with these arguments in a process of its own, and return what it ran."""
    paths = [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, "-m", "support.way_of_a_cloud", *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    way = Way(**json.loads(done.stdout))
    # JSON has neither tuples nor numbers as keys.
    return way._replace(
        frames=[(name, file) for name, file in way.frames],
        decompressions={int(offset): count for offset, count in way.decompressions.items()},
    )


class _Watcher:
    """Notes what runs; `__call__` is the function that the interpreter calls at each call of a function."""

    def __init__(self, source: bytes) -> None:
        self._source = source
        self._codes: set[CodeType] = set()
        self._deepest: list[tuple[str, str]] = []
        self._decompressed: Counter[int] = Counter()
        self._classes: set[type] = set()

    def __call__(self, frame: FrameType, event: str, called: Any) -> None:
        """Note a call of a function of pc2scan, or of its compiled projection."""
        code = frame.f_code
        if event == "c_call":
            if getattr(called, "__module__", "") == "pc2scan.core._kernel" and called.__name__ == "project":
                self._note_chain(frame, ("project", "core/_kernel"))
        elif event == "call" and code.co_filename.startswith(_PACKAGE):
            self._codes.add(code)
            place = _place(code)
            if place == ("project", "core/plain.py") and frame.f_back is not None:
                self._note_chain(frame.f_back, place)
            elif place == ("decompress", "files/compression.py"):
                self._decompressed[self._source.find(bytes(frame.f_locals["data"]))] += 1

    def _note_chain(self, last: FrameType | None, arithmetic: tuple[str, str]) -> None:
        self._classes |= {type(each) for each in gc.get_objects() if type(each).__module__.startswith("pc2scan")}
        chain = [arithmetic]
        while last is not None:
            if last.f_code.co_filename.startswith(_PACKAGE) and _is_function(last.f_code):
                chain.append(_place(last.f_code))
            last = last.f_back
        self._deepest = max(self._deepest, chain[::-1], key=len)

    def way(self) -> Way:
        """What was noted."""
        return Way(
            self._deepest,
            sum(map(_is_function, self._codes)),
            len({code.co_filename for code in self._codes if _is_function(code)}),
            len(self._classes),
            dict(sorted(self._decompressed.items())),
        )


def _is_function(code: CodeType) -> bool:
    """Whether code is that of a function: not of a module, a class or a comprehension."""
    name = code.co_name
    return bool(code.co_flags & inspect.CO_OPTIMIZED) and (name == "<lambda>" or not name.startswith("<"))


def _place(code: CodeType) -> tuple[str, str]:
    """A function's name, and its file in the package."""
    return code.co_name, code.co_filename.removeprefix(_PACKAGE).replace(os.sep, "/")


def main() -> None:
    """Print what a conversion in this process runs."""
    arguments = sys.argv[1:]
    watcher, said = _Watcher(Path(arguments[0]).read_bytes()), StringIO()
    with TemporaryDirectory() as folder:
        sys.argv = ["pc2scan", "convert", *arguments, "-o", str(Path(folder) / "scans.mcap")]
        threading.setprofile(watcher)
        with redirect_stdout(said), redirect_stderr(said), suppress(SystemExit):
            sys.setprofile(watcher)
            try:
                # Not at the top: it loads the command, which is to be watched.
                from pc2scan.cli import main as command

                command()
            finally:
                sys.setprofile(None)
                threading.setprofile(None)
        made = (Path(folder) / "scans.mcap").is_file()
    assert made, said.getvalue()
    print(json.dumps(watcher.way()._asdict()))  # noqa: T201


if __name__ == "__main__":
    main()

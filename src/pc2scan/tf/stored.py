"""Stores the transforms of a part of a recording in a file, for processes that share the reading of a recording."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING
from uuid import uuid4

from pc2scan.errors import OutputError, RecordingError

from .builder import TransformBuilder
from .reading import begun_with, built, collect_transforms

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from pc2scan.bags.reader import Reader

    from .buffer import TransformBuffer
    from .options import FrameOptions


def store_transforms(
    reader: Reader, options: FrameOptions, path: Path, start_ns: int | None = None, stop_ns: int | None = None
) -> None:
    """Write a recording's transforms of ``start_ns <= log_time_ns < stop_ns`` to a file.

    Raises
    ------
    RecordingError
        If the recording cannot be read.
    OutputError
        If the file cannot be written.
    """
    builder, warnings = TransformBuilder(), dict[str, int]()
    collect_transforms(reader, options, builder, warnings, start_ns, stop_ns)
    pairs, records = builder.dumped()
    head = json.dumps({"pairs": pairs, "warnings": warnings}).encode("ascii") + b"\n"
    # A unique name, because a process that was taken for dead may still write the same file.
    partial = path.with_name(f"{path.name}-{uuid4().hex}")
    try:
        partial.write_bytes(head + records)
        partial.replace(path)
    except OSError as err:
        raise OutputError(f"cannot be written: {err.strerror}", path=path) from err


def stored_transforms(paths: Iterable[Path], options: FrameOptions) -> tuple[TransformBuffer, list[str]]:
    """Return what `pc2scan.tf.reading.read_transforms` returns, from stored files in the order of time.

    Raises
    ------
    RecordingError
        If a file cannot be read.
    """
    builder, warnings = begun_with(options), dict[str, int]()
    for path in paths:
        try:
            head, _, records = path.read_bytes().partition(b"\n")
        except OSError as err:
            raise RecordingError(f"cannot be read: {os.strerror(err.errno or 0)}", path=path) from err
        found = json.loads(head)
        builder.add_dumped(((parent, child) for parent, child in found["pairs"]), records)
        for text, count in found["warnings"].items():
            warnings[text] = warnings.get(text, 0) + count
    return built(builder, warnings)

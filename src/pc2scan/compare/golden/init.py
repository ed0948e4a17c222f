"""Makes a golden case from a few seconds of a recording: cuts out the input, and writes the expected output."""

from __future__ import annotations

import os
import shutil
from contextlib import ExitStack
from typing import TYPE_CHECKING

from pc2scan.bags.opening import open_recordings
from pc2scan.bags.topics import find_topics, types_by_topic
from pc2scan.conversion.run import OutputOptions, run
from pc2scan.errors import DestinationError, OutputError, ResultError
from pc2scan.files.staging import output_folder, staged_output
from pc2scan.messages.clouds import CLOUDS, SCANS
from pc2scan.request.options import ConvertOptions

from .check import check_case

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from pc2scan.bags.reader import Reader
    from pc2scan.conversion.report import Report
    from pc2scan.options.call import Options
    from pc2scan.progress import Progress

    from .check import Command

#: Types that conversions read besides clouds and scans.
_ALSO_READ = {"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage", "sensor_msgs/msg/Imu"}


def make_case(folder: Path, command: Command, options: Options, *, progress: Progress | None = None) -> Report:
    """Make a case, by ``init``, ``start``, ``end``, ``topics`` and ``params_file`` of a call.

    Clouds, scans, transforms and IMU messages of the recording are kept, byte for byte.

    Parameters
    ----------
    folder
        The case; it must not exist. The folder above it is made, if it does not exist.
    command
        Runs ``pc2scan``.

    Returns
    -------
    Report
        That of the cut.

    Raises
    ------
    Pc2ScanError
        If the recording cannot be read, the case cannot be written, or its conversion does not succeed.
    """
    if os.path.lexists(folder):
        raise DestinationError("exists already", path=folder, hint="give a folder that does not exist yet")
    with ExitStack() as stack:
        if folder.parent != folder and not os.path.lexists(folder.parent):
            stack.enter_context(output_folder(folder.parent))
        partial = stack.enter_context(staged_output(folder, overwrite=False))
        partial.mkdir()
        (reader,) = open_recordings([options.init], stack)
        kept = _needed_topics(reader, options.topics)
        name = "input.bag" if any(each.ros_version == 1 for each in reader.connections) else "input.mcap"
        cut = ConvertOptions(repair=True, start=options.start, end=options.end, keep=tuple(kept))
        report = run([options.init], partial / name, cut, OutputOptions(), progress=progress)
        if (params := options.params_file) is not None:
            try:
                shutil.copyfile(params, partial / "params.yaml")
            except OSError as err:
                raise OutputError(f"cannot be copied: {err.strerror}", path=params) from err
        result = check_case(folder.name, partial, command, update=True)
        if result.outcome != "updated":
            raise ResultError(
                "; ".join(result.lines) or "its conversion writes nothing that can be compared",
                path=folder,
                hint="the conversion must succeed: cut out a part with transforms for each cloud (`start`, `end`)",
            )
    return report


def _needed_topics(reader: Reader, topics: Sequence[str]) -> list[str]:
    """The topics of a recording that a case needs."""
    types = types_by_topic(reader.connections)
    kinds = (*CLOUDS, *SCANS)
    candidates = sorted(topic for topic, names in types.items() if names & {*kinds})
    chosen = {name for asked in topics for name in find_topics(asked, types, candidates, *kinds)} or {*candidates}
    return sorted(chosen | {topic for topic, names in types.items() if names & _ALSO_READ})

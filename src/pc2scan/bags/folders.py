"""Finds the recordings in a folder, and the files that are parts of one recording.

A folder with a metadata.yaml is one recording. Without one, its files are one recording if they are parts:

- They are named as ``ros2 bag record`` and ``rosbag record --split`` name parts: ``drive_0.mcap``, ``drive_1.mcap``, or
  ``drive_2020-11-04-18-39-50_0.bag``, ``drive_2020-11-04-18-42-50_1.bag``.
- A topic that several have is of one type in all of them, and two of them share a topic.
- Their log times follow each other in the order of the numbers, with at most a second in common, and at most half of
  the shorter one. Between two whose numbers follow each other lies at most a minute.

All others are several recordings, because two drives are not recorded to become one.
"""

from __future__ import annotations

import re
import shlex
from contextlib import suppress
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import UsageError, name_list

from . import zstd
from .formats import FORMATS, and_list

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from .reader import Reader

#: Maximum overlap of parts, since a recorder's threads may write a message late: at most this, and at most half of
#: the shorter part, although such a part may be shorter than that delay.
_MAX_COMMON_NS = 1_000_000_000
_LATE_NS = 10_000_000
#: A recorder begins a part when the last one is full, not later.
_MAX_GAP_NS = 60_000_000_000

_DATE = re.compile(r"_?\d{4}([-_]\d{2}){5}")
_NUMBERED = re.compile(r"(.+)_(\d+)")

#: Recordings that an error names; topics that a warning names.
_MAX_NAMED = 4


class _PartName(NamedTuple):
    """The name of a part: that of the recording, the number of the part, and the suffix."""

    recording: str
    number: int
    suffix: str


def recordings_in(folder: Path) -> list[Path]:
    """Return the recordings in a folder, by their names: files, and folders with a recording.

    In natural order. Hidden files and folders are ignored.
    """
    recordings = [
        path
        for path in folder.iterdir()
        if not path.name.startswith(".")
        and (_holds_recording(path) if path.is_dir() else is_named_as_recording(path.name))
    ]
    return sorted(recordings, key=natural_order)


def is_named_as_recording(name: str) -> bool:
    """Whether a file has the suffix of a recording."""
    suffixes = tuple(entry.suffix + end for entry in FORMATS.values() if entry.suffix for end in _ENDS)
    return name.lower().endswith(suffixes)


#: What may follow the suffix of a recording's name.
_ENDS = ("", ".active", *zstd.SUFFIXES)


def _holds_recording(folder: Path) -> bool:
    with suppress(OSError):
        return any(entry.holds_recording is not None and entry.holds_recording(folder) for entry in FORMATS.values())
    return False


def natural_order(path: Path) -> list[int | str]:
    """Return the key of a natural order of names: 2 comes before 10."""
    # Text and numbers take turns, so that only like is compared with like.
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name, flags=re.ASCII)]


def several_recordings(folder: Path, recordings: Sequence[Path], why: str = "") -> UsageError:
    """Return the error for a folder that holds several recordings, where one was expected."""
    names = [f"{path.name}/" if path.is_dir() else path.name for path in recordings]
    one, all_of_them = shlex.quote(str(recordings[0])), shlex.quote(str(folder))
    return UsageError(
        f"holds {len(recordings)} recordings, not one: {name_list(names, _MAX_NAMED)}{f' ({why})' if why else ''}",
        path=folder,
        hint=f"name one of them: {one}; pc2scan batch {all_of_them} -o DIR/ converts each by itself",
    )


def are_named_as_parts(paths: Iterable[Path]) -> bool:
    """Whether files are named as the parts of one recording; a single file is one."""
    files = list(paths)
    parts = [part for path in files if (part := _part_name(path)) is not None]
    return len(files) == 1 or (
        len(parts) == len(files)
        and len({(path.parent, part.recording, part.suffix) for path, part in zip(files, parts, strict=True)}) == 1
        and len({part.number for part in parts}) == len(parts)
    )


def groups_of_parts(paths: Iterable[Path]) -> Iterator[list[Path]]:
    """Yield the files of a folder that have the names of parts of one recording, in the order of their numbers.

    Whether they are parts, only their content says: see `continues`.
    """
    groups: dict[tuple[str, str], dict[int, Path]] = {}
    for path in paths:
        part = _part_name(path)
        if part is not None:
            groups.setdefault((part.recording, part.suffix), {}).setdefault(part.number, path)
    yield from ([group[number] for number in sorted(group)] for group in groups.values() if len(group) > 1)


def continues(file: Path, reader: Reader, other: Path, other_reader: Reader) -> bool:
    """Whether a file is the next part of a recording, whose part before it is ``file``."""
    end_ns, start_ns = reader.summary.end_ns, other_reader.summary.start_ns
    if end_ns is None or start_ns is None or start_ns - end_ns > _MAX_GAP_NS or not _follows(file, other):
        return False
    return not _why_unrelated((file, other), (reader, other_reader))


def _part_name(path: Path) -> _PartName | None:
    name = zstd.without_suffix(path.name).removesuffix(".active")
    stem, dot, suffix = name.rpartition(".")
    numbered = _NUMBERED.fullmatch(stem)
    return _PartName(_DATE.sub("", numbered[1]), int(numbered[2]), dot + suffix) if numbered else None


def refuse_unrelated(folder: Path, files: Sequence[Path], readers: Sequence[Reader]) -> None:
    """Raise if the files of a folder, which are named as parts, cannot be those of one recording.

    Parameters
    ----------
    folder
        Where they are, without a metadata.yaml.
    files, readers
        The files in the order of their numbers, and what reads them.

    Raises
    ------
    UsageError
        If they are several recordings.
    """
    if why := _why_unrelated(files, readers):
        raise several_recordings(folder, files, why)


def _why_unrelated(files: Sequence[Path], readers: Sequence[Reader]) -> str:
    """Return why files that are named as parts cannot be parts; empty if they may be."""
    opened = [(file, reader) for file, reader in zip(files, readers, strict=True) if reader.summary.message_count != 0]
    for (file, reader), (other, other_reader) in combinations(opened, 2):
        types, others = _types_by_topic(reader), _types_by_topic(other_reader)
        for topic in types.keys() & others.keys():
            if types[topic] != others[topic]:
                return f"{topic} has other types in {file.name} and {other.name}"
        if not types.keys() & others.keys() and not reader.damage and not other_reader.damage:
            return f"{file.name} and {other.name} have no topic in common"
    for (file, reader), (other, other_reader) in pairwise(opened):
        end_ns, start_ns = reader.summary.end_ns, other_reader.summary.start_ns
        if end_ns is None or start_ns is None:
            continue
        if end_ns - start_ns > _allowed_ns(reader, other_reader):
            return f"{other.name} does not begin where {file.name} ends"
        if start_ns - end_ns > _MAX_GAP_NS and _follows(file, other):
            return f"{other.name} begins {_seconds_text(start_ns - end_ns)} after the end of {file.name}"
    return ""


def _follows(file: Path, other: Path) -> bool:
    part, next_part = _part_name(file), _part_name(other)
    return part is not None and next_part is not None and next_part.number == part.number + 1


def overlap_warnings(readers: Sequence[Reader]) -> list[str]:
    """Warn of recordings that would be merged though they were not made one after the other.

    Parameters
    ----------
    readers
        Of the sources that become one recording.

    Returns
    -------
    list[str]
        One warning for all that overlap in time and have the same topics; none for parts of one recording.
    """
    mixed = []
    for reader, other in combinations(readers, 2):
        common_ns = _common_ns(reader, other)
        is_parted = common_ns and are_named_as_parts((reader.path, other.path))
        shared = _moving_topics(reader) & _moving_topics(other)
        if shared and common_ns > (_allowed_ns(reader, other) if is_parted else 0):
            mixed.append((common_ns, (str(reader.path), str(other.path)), sorted(shared)))
    if not mixed:
        return []
    names = dict.fromkeys(path for _, paths, _ in mixed for path in paths)
    topics = dict.fromkeys(topic for _, _, shared in mixed for topic in shared)
    warning = (
        f"{_some_of(names)} overlap in time, by up to {_seconds_text(max(mixed)[0])}, on {_some_of(topics)}: their "
        "messages are mixed into one recording; pc2scan batch converts each by itself"
    )
    return [warning]


def _some_of(names: Iterable[str]) -> str:
    first, more = list(names)[:_MAX_NAMED], list(names)[_MAX_NAMED:]
    return and_list([*first, f"{len(more)} more"] if more else first)


def _common_ns(reader: Reader, other: Reader) -> int:
    """Return how long two recordings overlap; 0 if they do not, or if their times are unknown."""
    times = [time for each in (reader, other) for time in (each.summary.start_ns, each.summary.end_ns)]
    start_ns, end_ns, other_start_ns, other_end_ns = times
    if start_ns is None or end_ns is None or other_start_ns is None or other_end_ns is None:
        return 0
    return max(0, min(end_ns, other_end_ns) - max(start_ns, other_start_ns))


def _allowed_ns(*readers: Reader) -> int:
    """Return how long parts of one recording may overlap."""
    durations = [(each.summary.end_ns or 0) - (each.summary.start_ns or 0) for each in readers]
    return min(_MAX_COMMON_NS, max(_LATE_NS, min(durations) // 2))


def _moving_topics(reader: Reader) -> set[str]:
    """Return topics with messages, without those that every part of a recording repeats."""
    return {
        connection.topic
        for connection in reader.connections
        if connection.message_count != 0 and not connection.is_latched
    }


def _types_by_topic(reader: Reader) -> dict[str, frozenset[str]]:
    types: dict[str, frozenset[str]] = {}
    for connection in reader.connections:
        types[connection.topic] = types.get(connection.topic, frozenset()) | {connection.ros_type}
    return types


def _seconds_text(duration_ns: int) -> str:
    return f"{duration_ns / 1e9:,.3f} s"

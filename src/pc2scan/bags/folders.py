"""Finds the recordings in a folder, and the files that are parts of one recording.

A folder with a metadata.yaml is one recording. Without one, its files are one recording if they are parts:

- They are named as ``ros2 bag record`` and ``rosbag record --split`` name parts: ``drive_0.mcap``, ``drive_1.mcap``, or
  ``drive_2020-11-04-18-39-50_0.bag``, ``drive_2020-11-04-18-42-50_1.bag``.
- Each has a topic of the part before it, of the same type.
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
from .formats import FORMATS, and_list, storages

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from .reader import Reader

METADATA_NAME = "metadata.yaml"

#: Maximum overlap of parts, since a recorder's threads may write a message late: at most this, and at most half of
#: the shorter part, although such a part may be shorter than that delay.
_MAX_COMMON_NS = 1_000_000_000
_LATE_NS = 10_000_000
#: A recorder begins a part when the last one is full, not later.
_MAX_GAP_NS = 60_000_000_000

_DATE = re.compile(r"_?\d{4}([-_]\d{2}){5}")
_NUMBERED = re.compile(r"(.+)_(\d+)")

#: What may follow the suffix of a recording's name.
_ENDS = ("", ".active", *zstd.SUFFIXES)

#: Recordings that an error names; topics that a warning names.
_MAX_NAMED = 4


class _PartName(NamedTuple):
    """The name of a part: that of the recording, the suffix, and the number of the part."""

    recording: str
    suffix: str
    number: int


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


def is_rosbag2(folder: Path) -> bool:
    """Whether everything in a directory is one recording: it has a metadata.yaml, or all are named as parts of one."""
    if (folder / METADATA_NAME).exists():
        return True
    recordings = recordings_in(folder)
    return are_named_as_parts(recordings) and recordings == storage_files(folder)


def storage_files(folder: Path) -> list[Path]:
    """Return the files of a directory with a storage's suffix, in natural order: 2 comes before 10."""
    files = [path for path in folder.iterdir() if path.is_file() and storage_of(path.name) is not None]
    return sorted(files, key=natural_order)


def storage_of(name: str) -> str | None:
    """Return the format of a file of a rosbag2 directory by its name; None if it is none."""
    _, dot, suffix = zstd.without_suffix(name).rpartition(".")
    return next((storage for storage, entry in storages().items() if entry.suffix == dot + suffix), None)


def _holds_recording(folder: Path) -> bool:
    with suppress(OSError):
        return (folder / METADATA_NAME).exists() or bool(storage_files(folder))
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


# --- Parts ---


def are_named_as_parts(paths: Sequence[Path]) -> bool:
    """Whether files are named as the parts of one recording; a single file is one."""
    return len(paths) == 1 or [len(group) for group in groups_of_parts(paths)] == [len(paths)]


def groups_of_parts(paths: Iterable[Path]) -> Iterator[list[Path]]:
    """Yield the files of a folder that have the names of parts of one recording, in the order of their numbers.

    Whether they are parts, only their content says: see `continues`.
    """
    groups: dict[tuple[Path, str, str], dict[int, Path]] = {}
    for path in paths:
        if part := _part_name(path):
            groups.setdefault((path.parent, part.recording, part.suffix), {}).setdefault(part.number, path)
    yield from ([group[number] for number in sorted(group)] for group in groups.values() if len(group) > 1)


def continues(reader: Reader, other: Reader) -> bool:
    """Whether a recording is the next part of another one, by its name and its content."""
    return _follows(reader, other) and not _why_unrelated(reader, other)


def refuse_unrelated(folder: Path, readers: Sequence[Reader]) -> None:
    """Raise if the files of a folder without a metadata.yaml, in the order of their numbers, are no parts.

    Raises
    ------
    UsageError
        If they are several recordings.
    """
    for reader, other in pairwise(part for part in readers if part.summary.message_count != 0):
        if why := _why_unrelated(reader, other):
            raise several_recordings(folder, [part.path for part in readers], why)


def _part_name(path: Path) -> _PartName | None:
    stem, dot, suffix = zstd.without_suffix(path.name).removesuffix(".active").rpartition(".")
    numbered = _NUMBERED.fullmatch(stem)
    return _PartName(_DATE.sub("", numbered[1]), dot + suffix, int(numbered[2])) if numbered else None


def _follows(reader: Reader, other: Reader) -> bool:
    part, following = _part_name(reader.path), _part_name(other.path)
    return part is not None and following == part._replace(number=part.number + 1)


def _why_unrelated(reader: Reader, other: Reader) -> str:
    """Return why two files that are named as parts are no parts, the second after the first; empty if they may be."""
    topics, others = ({(own.topic, own.ros_type) for own in recording.connections} for recording in (reader, other))
    if not topics & others and not reader.damage and not other.damage:
        return f"{reader.path.name} and {other.path.name} have no topic in common"
    end_ns, start_ns = reader.summary.end_ns, other.summary.start_ns
    if end_ns is None or start_ns is None:
        return ""
    if end_ns - start_ns > _allowed_ns(reader, other):
        return f"{other.path.name} does not begin where {reader.path.name} ends"
    if start_ns - end_ns > _MAX_GAP_NS and _follows(reader, other):
        return f"{other.path.name} begins {_seconds_text(start_ns - end_ns)} after the end of {reader.path.name}"
    return ""


def overlap_warnings(readers: Sequence[Reader]) -> list[str]:
    """Return a warning of the sources of one recording that overlap in time and share topics; none for parts."""
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
    starts, ends = ([getattr(part.summary, name) for part in (reader, other)] for name in ("start_ns", "end_ns"))
    return 0 if None in (*starts, *ends) else max(0, min(ends) - max(starts))


def _allowed_ns(*readers: Reader) -> int:
    """Return how long parts of one recording may overlap."""
    durations = [(part.summary.end_ns or 0) - (part.summary.start_ns or 0) for part in readers]
    return min(_MAX_COMMON_NS, max(_LATE_NS, min(durations) // 2))


def _moving_topics(reader: Reader) -> set[str]:
    """Return topics with messages, without those that every part of a recording repeats."""
    return {own.topic for own in reader.connections if own.message_count != 0 and not own.is_latched}


def _seconds_text(duration_ns: int) -> str:
    return f"{duration_ns / 1e9:,.3f} s"

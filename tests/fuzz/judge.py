"""What becomes of a mutant, compared with the sound recording and with what other readers get, message by message."""

from __future__ import annotations

import io
import tempfile
from collections import Counter
from contextlib import closing, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from mcap.reader import NonSeekingReader, SeekingReader
from rosbags.rosbag1 import Reader as Rosbag1LibraryReader
from rosbags.rosbag2 import Reader as Rosbag2LibraryReader

import pc2scan
from fuzz.records import stretches
from fuzz.seeds import place
from pc2scan.bags.opening import open_recording
from support.bounded import refused, size_of, watched

if TYPE_CHECKING:
    from collections.abc import Iterator

    from fuzz.mutants import Mutant
    from fuzz.seeds import Seed

#: How often there is a message of a topic, a log time and these bytes.
Messages: TypeAlias = Counter[tuple[str, int, bytes]]


#: What may become of a mutant.
OUTCOMES = IDENTICAL, REPORTED, REFUSED, UNDETECTABLE = ("identical", "damage reported", "refused", "not to be known")


class Finding(Exception):  # noqa: N818 - it is what the campaign looks for
    """What must not happen."""


def attempt(made: Mutant, folder: Path, *, repair: bool = True) -> str:
    """Read a mutant, also by `pc2scan.repair`, `pc2scan.info` and `pc2scan.convert`, and compare.

    Raises
    ------
    Finding
        If it is not as it must be.
    """
    sound = _sound(made.seed)
    source = place(made.files, made.seed.opened, folder / "source")
    status, messages = _read(source)
    if repair:
        _repair(source, folder / "output", status, messages)
        _look_into(source, folder / "output")
    left = {path.name: path.read_bytes() for path in (folder / "source").rglob("*") if path.is_file()}
    if left != {name.rpartition("/")[2]: data for name, data in made.files.items()}:
        raise Finding("the source was changed")
    ours = _by_data(messages)
    touched: frozenset[bytes] = frozenset()
    if made.place is not None:
        touched = _compare_untouched(made, made.place, status, ours)
    for words, theirs in _others(made, source):
        # What others make of changed bytes is no message of the recording; nor is what they unpack without a look at
        # a chunk's checksum.
        more = (_by_data(theirs) & _by_data(sound)) - ours
        if made.how.startswith("flipped"):
            more = Counter({data: count for data, count in more.items() if data not in touched})
        if made.name.endswith(".db3") and len(made.data) < len(made.seed.files[made.name]):
            # SQLite takes missing bytes for zeros, which they may have been.
            more = Counter({data: count for data, count in more.items() if not data.endswith(b"\0")})
        if more:
            raise Finding(f"{more.total()} messages are missing, which another reader finds {words}")
    if status == 0 and messages != sound:
        if messages.total() < sound.total() and not _is_unknowable(made):
            raise Finding(f"{sound.total() - messages.total()} messages are missing, and nothing is said")
        return UNDETECTABLE
    return {0: IDENTICAL, 3: REPORTED}.get(status, REFUSED)


def _read(source: Path) -> tuple[int, Messages]:
    """Read, leniently and strictly; returns the exit status that a command would have, and what is read."""
    status, messages, sound = 1, Messages(), False
    with watched(size_of(source)):
        with refused(), closing(open_recording(source)) as reader:
            messages = Messages((m.connection.topic, m.log_time_ns, bytes(m.data)) for m in reader.messages())
            list(reader.attachments())
            list(reader.metadata())
            status = 3 if reader.damage else 0
        with refused(), closing(open_recording(source, strict=True)) as reader:
            for _ in (*reader.messages(), *reader.attachments(), *reader.metadata()):
                pass
            sound = True
    if sound != (status == 0):
        raise Finding(f"strict reading {'finds nothing' if sound else 'fails'}, and otherwise the status is {status}")
    return status, messages


def _repair(source: Path, folder: Path, status: int, messages: Messages) -> None:
    """Repair: what is in the result is what was read."""
    folder.mkdir()
    target = folder / f"out{source.suffix if source.suffix in ('.bag', '.mcap') else ''}"
    repaired = 1
    with watched(size_of(source)):
        repaired = pc2scan.repair(source, target).exit_status
    # Where there is no message, there is nothing to repair.
    if repaired not in (status, 3) and messages:
        raise Finding(f"reading has the status {status}, repairing {repaired}")
    if [path.name for path in folder.iterdir()] != ([target.name] if repaired != 1 else []):
        raise Finding(f"it left {list(folder.iterdir())}")
    if repaired != 1 and _read(target) != (0, messages):
        raise Finding("it is read otherwise than it is repaired")


def _look_into(source: Path, folder: Path) -> None:
    with watched(2 * size_of(source)):
        pc2scan.info(source).as_dict()
    with watched(size_of(source)):
        pc2scan.convert(source, folder / "scans.mcap", min_height=-2.0, start="0.15", jobs=2)


def _others(made: Mutant, source: Path) -> Iterator[tuple[str, Messages]]:
    """What other readers get before they give up."""
    if made.name == source.name and source.suffix == ".mcap":
        for words, kind in (("from end to end", NonSeekingReader), ("by the index", SeekingReader)):
            yield words, _taken(_mcap(kind, made.data))
    else:
        yield "by rosbags", _taken(_rosbags(source))


def _taken(messages: Iterator[tuple[str, int, bytes]]) -> Messages:
    """All messages up to the first error, whatever it is."""
    taken = Messages()
    with suppress(Exception):
        for message in messages:
            taken[message] += 1
    return taken


def _mcap(kind: type[NonSeekingReader | SeekingReader], data: bytes) -> Iterator[tuple[str, int, bytes]]:
    for _, channel, message in kind(io.BytesIO(data)).iter_messages(log_time_order=False):
        yield channel.topic, message.log_time, message.data


def _rosbags(path: Path) -> Iterator[tuple[str, int, bytes]]:
    with (Rosbag1LibraryReader if path.suffix == ".bag" else Rosbag2LibraryReader)(path) as reader:
        for connection, log_time_ns, data in reader.messages():
            yield connection.topic, log_time_ns, bytes(data)


def _compare_untouched(made: Mutant, place: tuple[int, int], status: int, ours: Counter[bytes]) -> frozenset[bytes]:
    """Refuse to lose messages of untouched chunks, and to say nothing of a cut; returns the messages of the others."""
    first, last = place
    others: frozenset[bytes] = frozenset()
    places = stretches(made.seed.files[made.name])
    # Where nothing else declares the channels, nothing can be read without the first declaration.
    declared_once = "without-summary" in made.seed.name and first < places[0].stop
    for start, stop, messages in places:
        untouched = stop <= first or (start > last and not declared_once)
        if start < last and first < stop:
            others |= messages
        if untouched and (gone := messages - ours.keys()):
            raise Finding(f"{len(gone)} messages of bytes {start} to {stop} are missing, which are sound")
    if "cut off" in made.how and status == 0:
        raise Finding("it is cut off, and nothing is said")
    return others


def _is_unknowable(made: Mutant) -> bool:
    """Whether a chunk is now a private record where nothing counts or indexes chunks, or a log is empty."""
    if made.name.endswith("-wal") and not made.data:
        return True
    data = made.seed.files[made.name]
    starts = [start for start, *_ in stretches(data)] if "without-summary" in made.seed.name else []
    return any(made.data[:start] == data[:start] and made.data[start : start + 1] >= b"\x80" for start in starts)


def _by_data(messages: Messages) -> Counter[bytes]:
    counts: Counter[bytes] = Counter()
    for (_, _, data), count in messages.items():
        counts[data] += count
    return counts


@cache
def _sound(seed: Seed) -> Messages:
    with tempfile.TemporaryDirectory(prefix="pc2scan-sound-") as folder:
        status, messages = _read(place(seed.files, seed.opened, Path(folder)))
    assert status == 0, seed.name
    return messages

"""What becomes of a mutant, compared with what becomes of the sound recording, message by message."""

from __future__ import annotations

import random
import subprocess
import tempfile
from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import pc2scan
from fuzz import others
from fuzz.contradictions.recording import contradictions
from fuzz.mutants.mutate import Mutant, mutant, rearranged, stretches
from fuzz.mutants.seeds import Seed, place
from pc2scan import ProjectionParams
from pc2scan.bags.opening import open_recording
from pc2scan.conversion.report import Report
from pc2scan.conversion.run import run
from pc2scan.conversion.run_files import OutputOptions
from pc2scan.options.moment import TimeBound
from pc2scan.request.options import ConvertOptions, ScanSpec
from pc2scan.text import TextEnum
from support.bounded import refused, size_of, watched
from support.command import COMMAND, environment

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pc2scan.bags.reader import Reader

__all__ = [
    "READ",
    "REPAIR",
    "Finding",
    "Operation",
    "Outcome",
    "attempt",
    "by_command",
    "mutant_of",
    "rearranged_of",
]


#: Messages, topics, attachments and metadata.
Content: TypeAlias = "dict[str, Any]"


class Outcome(TextEnum):
    """What became of a mutant."""

    identical = "identical"
    identical_reported = "identical, damage reported"
    reported = "different, damage reported"
    refused = "refused"
    undetectable = "different, nothing in it contradicts"


class Finding(Exception):  # noqa: N818 - it is what the campaign looks for
    """What must not happen."""


class SupportsDict(Protocol):
    """What `pc2scan.info` and the like return."""

    def as_dict(self) -> dict[str, Any]: ...


@dataclass(frozen=True, slots=True)
class Operation:
    """What is done with a mutant; the arguments are those of the command. Without options, it is only read."""

    name: str
    command: tuple[str, ...]
    output: str
    options: ConvertOptions | None


_SCANS = (ScanSpec(params=ProjectionParams(min_height=-2.0, max_height=2.0)),)
_IN_ANOTHER_FRAME = (
    ScanSpec(params=ProjectionParams(min_height=-2.0, max_height=2.0, target_frame="base_link", reduce="median")),
)
_HEIGHTS = ("--min-height", "-2", "--max-height", "2")
_CUT = ("--start", "0.15", "--end", "0.45")

#: Only reads, which is quick: for every byte of a file.
READ = Operation("read", (), "", None)

REPAIR = Operation("repair", ("repair",), "", ConvertOptions(repair=True))

#: Repairs into the same kind of container, and as often everything else.
_OPERATIONS = (
    *(REPAIR,) * 4,
    Operation("repair to MCAP", ("repair",), "out.mcap", ConvertOptions(repair=True)),
    Operation("repair to rosbag2", ("repair",), "out", ConvertOptions(repair=True)),
    Operation("convert", ("convert", *_HEIGHTS), "out.mcap", ConvertOptions(scans=_SCANS)),
    Operation(
        "convert a cut",
        ("convert", *_HEIGHTS, *_CUT),
        "out.mcap",
        ConvertOptions(scans=_SCANS, start=TimeBound.parse(_CUT[1]), end=TimeBound.parse(_CUT[3])),
    ),
    Operation(
        "convert into a bag, with clouds, two at a time",
        ("convert", *_HEIGHTS, "--keep-clouds", "--jobs", "2"),
        "out.bag",
        ConvertOptions(scans=_SCANS, keep_clouds=True, jobs=2),
    ),
    Operation(
        "convert in another frame",
        ("convert", *_HEIGHTS, "--target-frame", "base_link", "--reduce", "median"),
        "out.mcap",
        ConvertOptions(scans=_IN_ANOTHER_FRAME),
    ),
)


def mutant_of(number: int, seeds: Sequence[Seed]) -> tuple[Mutant, Operation]:
    """The mutant of a number, and what is done with it: the same every time."""
    rng = random.Random(number)
    made = mutant(rng.choice(seeds), rng)
    return made, rng.choice(_OPERATIONS)


def rearranged_of(number: int, seeds: Sequence[Seed]) -> tuple[Mutant, Operation]:
    """The mutant of a number with whole records removed, repeated or moved, and its repair."""
    rng = random.Random(number)
    single = [seed for seed in seeds if seed.opened.endswith((".bag", ".mcap")) and len(seed.files) == 1]
    return rearranged(rng.choice(single), rng), REPAIR


def attempt(made: Mutant, operation: Operation, folder: Path) -> Outcome:
    """Read, repair or convert a mutant, and compare.

    Raises
    ------
    Finding
        If it is not as it must be.
    """
    expected = _expected(made.seed, operation, folder.parent)
    source = place(made.files, made.seed.opened, folder / "source")
    if operation.options is None:
        status, found = _read(source)
        told = ""
    else:
        _look_into(made, source, folder)
        status, found, told = _run(operation, operation.options, source, folder)
    top = folder / "source"
    if {str(path.relative_to(top)): path.read_bytes() for path in top.rglob("*") if path.is_file()} != made.files:
        raise Finding("the source was changed")
    _compare_others(made, operation, source, expected, found)
    if made.edit.place is not None:
        _compare_untouched(made, status, expected, found)
    if found is None:
        return Outcome.refused
    if operation == REPAIR and _messages(_read(source)[1] or {"messages": []}) != _messages(found):
        raise Finding("it is read otherwise than it is repaired")
    if made.edit.role == "record":
        _compare_text(made, told, expected, found)
    same = _same(expected, found)
    if status == 3:
        return Outcome.identical_reported if same else Outcome.reported
    if same:
        return Outcome.identical
    if made.edit.role == "record" and not _lost(expected, found):
        # A record that is there twice, or elsewhere, costs nothing.
        return Outcome.undetectable
    if operation.options is None or operation.options.start is not None:
        # Counts of messages are only compared where all are passed on.
        with tempfile.TemporaryDirectory(prefix="repaired-", dir=folder) as name:
            return attempt(made, REPAIR, Path(name))
    if told_twice := contradictions(made.files):
        raise Finding(f"{_difference(expected, found)}, and exit status 0, though: {'; '.join(told_twice)[:400]}")
    return Outcome.undetectable


def _run(operation: Operation, options: ConvertOptions, source: Path, folder: Path) -> tuple[int, Content | None, str]:
    """Repair or convert; returns the exit status, what is in the output, and what is said of damage."""
    destination = _destination(operation, source, folder)
    status, report = 1, Report([], "", ())
    with watched(size_of(source)):
        report = run([source], destination, options, OutputOptions())
        status = report.exit_status
    disagree = Counter(damage.path for damage in report.damage if "the index and the content disagree" in damage.what)
    if disagree.total() > len(disagree):
        raise Finding(f"an index that disagrees is reported {disagree.total()} times, of {len(disagree)} files")
    left = [path.name for path in destination.parent.iterdir()]
    if status == 1:
        if left:
            raise Finding(f"refused, and left {left}")
        return 1, None, ""
    if left != [destination.name]:
        raise Finding(f"it left {left}")
    return (
        status,
        content_of(destination),
        " ".join(each.text for each in report.remarks() if each.label == "recovered"),
    )


def _read(source: Path) -> tuple[int, Content | None]:
    """Read, leniently and strictly; returns the exit status that a command would have, and what is read."""
    status, found, sound = 1, None, False
    # Together within the bounds of one reading.
    with watched(size_of(source)):
        with refused(), closing(open_recording(source)) as reader:
            found = _content(reader)
            status = 3 if reader.damage else 0
        with refused():
            content_of(source)
            sound = True
    if sound != (status == 0):
        raise Finding(f"strict reading {'finds nothing' if sound else 'fails'}, and otherwise the status is {status}")
    return status, found


def _look_into(made: Mutant, source: Path, folder: Path) -> None:
    """Read a mutant as another command does, whatever it finds; which one depends on the mutant's bytes."""
    looks: tuple[Callable[[], SupportsDict], ...] = (
        lambda: pc2scan.info(source),
        lambda: pc2scan.tf(source),
        lambda: pc2scan.check(source),
        lambda: pc2scan.diff(place(made.seed.files, made.seed.opened, folder / "sound"), source, all_topics=True),
    )
    size = size_of(source)
    with watched(2 * size):
        looks[size % len(looks)]().as_dict()


def _compare_others(made: Mutant, operation: Operation, source: Path, expected: Content, found: Content | None) -> None:
    """Refuse to recover fewer messages than any other reader gets."""
    # The rosbags library does not look at all fields.
    if operation not in (READ, REPAIR) or made.edit.kind.endswith("chunk.field_name"):
        return
    # A changed byte of a packed chunk may unpack to anything, which others take for what was written.
    if made.edit.how == "flipped" and made.edit.kind in ("chunk.records", "chunk.data"):
        return
    sound, ours = _messages(expected), _messages(found) if found else Counter()
    in_order, by_index = others.in_order(made.files), others.by_index(made.files, source)
    if made.edit.role != "record":
        # What was changed may be read in another way: a message may get the nearest time of its chunk, and of two
        # declarations of a topic another may be used.
        sound, ours, in_order, by_index = map(_by_data, (sound, ours, in_order, by_index))
        in_order &= sound
    # An index that names a record twice gives its messages twice.
    by_index &= sound
    for words, theirs in (("from end to end", in_order), ("by the index", by_index)):
        if more := theirs - ours:
            counts = f"{theirs.total()} messages {words}, pc2scan {ours.total()}"
            raise Finding(f"another reader finds {counts}; {more.total()} are missing")


def _compare_untouched(made: Mutant, status: int, expected: Content, found: Content | None) -> None:
    """Refuse to lose messages of chunks whose bytes are as they were; and to say nothing of a cut, or to invent."""
    if made.edit.place is None:
        return
    first, last = made.edit.place
    cut = made.edit.how == "cut off"
    there = _by_data(_messages(found)) if found else Counter()
    name, data = made.name, made.seed.files[made.name]
    places = stretches(name, data, within_chunks=cut)
    # Where nothing else declares the channels, nothing can be read without the first declaration.
    declared_once = ("unchunked" in made.seed.name and first < places[0].start) or (
        "no summary" in made.seed.name and first < stretches(name, data)[0].stop
    )
    for start, stop, messages in places:
        untouched = stop <= first or (start > last and not declared_once)
        if untouched and (gone := [message for message in messages if ("", 0, message) not in there]):
            raise Finding(f"{len(gone)} messages of bytes {start} to {stop} are missing, which are sound")
    if cut and status == 0:
        raise Finding("it is cut off, and nothing is said")
    if cut and (come := there - _by_data(_messages(expected))):
        raise Finding(f"{come.total()} messages are new")


def _compare_text(made: Mutant, text: str, expected: Content, found: Content) -> None:
    """Refuse to say that nothing is lost where something is."""
    lost = _lost(expected, found)["messages"]
    # One message in the place of another is like one with a wrong time.
    allowed = 1 if made.edit.how.startswith("replaced") else 0
    if lost > allowed and ("no bytes are known to be lost" in text or "no message is known to be missing" in text):
        raise Finding(f"{lost} messages are missing, and it says: {text}")


def _lost(expected: Content, found: Content) -> Counter[str]:
    """How many messages, attachments and metadata records are missing."""
    lost = {"messages": _messages(expected) - _messages(found)} | {
        key: Counter(map(repr, expected[key])) - Counter(map(repr, found[key])) for key in ("attachments", "metadata")
    }
    return +Counter({key: missing.total() for key, missing in lost.items()})


def _messages(content: Content) -> others.Messages:
    return Counter((topic, log_time_ns, data) for topic, log_time_ns, _, _, data in content["messages"])


def _by_data(messages: others.Messages) -> others.Messages:
    found: others.Messages = Counter()
    for (_, _, data), count in messages.items():
        found["", 0, data] += count
    return found


def by_command(made: Mutant, operation: Operation, folder: Path) -> int:
    """The same through the real command; returns its exit status."""
    source = place(made.files, made.seed.opened, folder / "source")
    destination = _destination(operation, source, folder)
    arguments = [*COMMAND, operation.command[0], str(source), "-o", str(destination), *operation.command[1:]]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=60, env=environment(), check=False)
    if "Traceback" in done.stderr or done.returncode not in (0, 1, 2, 3):
        raise Finding(f"the command ends with {done.returncode}: {done.stderr[-600:]}")
    if done.returncode and not done.stderr.strip():
        raise Finding(f"the command ends with {done.returncode} without a word")
    return done.returncode


def _destination(operation: Operation, source: Path, folder: Path) -> Path:
    (folder / "output").mkdir()
    suffix = source.suffix if source.suffix in (".bag", ".mcap") else ""
    return folder / "output" / (operation.output or f"out{suffix}")


def content_of(path: Path) -> Content:
    """Everything that an output holds, as it counts."""
    with closing(open_recording(path, strict=True)) as reader:
        return _content(reader)


def _content(reader: Reader) -> Content:
    return {
        "messages": [
            (m.connection.topic, m.log_time_ns, m.publish_time_ns, m.sequence, bytes(m.data)) for m in reader.messages()
        ],
        "topics": sorted(
            (c.topic, c.msgtype, c.serialization, c.definition.data, c.digest, c.callerid or "", c.latching, c.qos)
            for c in reader.connections
        ),
        "attachments": list(reader.attachments()),
        "metadata": [(m.name, dict(m.entries)) for m in reader.metadata()],
    }


@lru_cache(maxsize=1)
def _sound_content() -> dict[tuple[str, str], Content]:
    return {}


def _expected(seed: Seed, operation: Operation, folder: Path) -> Content:
    """What the sound recording becomes."""
    known = _sound_content()
    key = (seed.name, operation.name)
    if key not in known:
        with tempfile.TemporaryDirectory(prefix="sound-", dir=folder) as name:
            source = place(seed.files, seed.opened, Path(name, "source"))
            if operation.options is None:
                status, found = _read(source)
            else:
                status, found, _ = _run(operation, operation.options, source, Path(name))
            assert status == 0, seed.name
            assert found is not None
            known[key] = found
    return known[key]


def _same(expected: Content, found: Content) -> bool:
    """Whether nothing is lost or changed; a topic without messages may have come to be declared."""
    used = {message[0] for message in found["messages"]}
    come = [topic for topic in found["topics"] if topic not in expected["topics"] and topic[0] in used]
    gone = [topic for topic in expected["topics"] if topic not in found["topics"]]
    return not come and not gone and all(expected[key] == found[key] for key in expected if key != "topics")


def _difference(expected: Content, found: Content) -> str:
    parts = []
    for key, before in expected.items():
        old, new = Counter(map(repr, before)), Counter(map(repr, found[key]))
        gone, come = (old - new).total(), (new - old).total()
        if gone or come:
            parts.append(f"{gone} {key} are missing and {come} new ({len(before)} before)")
        elif before != found[key]:
            parts.append(f"the order of {key} is another")
    return ", ".join(parts)

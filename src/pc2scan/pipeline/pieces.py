"""Converts a long recording in pieces, in several processes, which may run on several machines.

A rosbag2 recording that is split by time consists of files that do not depend on each other. A piece is some of these
files. The pieces together have the same bytes as one conversion would write, because each process reads the whole
source for decisions that depend on it (the beginning of time, all transforms, measurements). Transforms are read in
parts, too, since nearly every chunk has some.

A file contains its own number. The source's index shows how many files a piece will have, unless nothing is written
for some stretch of time. Files with wrong numbers are converted again.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.bags.opening import as_one, open_recordings
from pc2scan.bags.rosbag2.writer import join_infos, write_info
from pc2scan.bags.zstd import SUFFIXES
from pc2scan.errors import OutputError
from pc2scan.result import MAX_LISTED
from pc2scan.tf.reading import store_transforms

from .conclusion import conclude
from .run import open_plan, span_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.bags.splitting import Cut

    from .conclusion import Tally
    from .options import ConvertOptions
    from .plan import Plan
    from .report import Report
    from .split import Piece, PieceResult
    from .stream import Span
    from .topic_report import TopicReport

#: Maximum number of files that are counted one by one.
_MOST_FILES = 5_000


class Stretch(NamedTuple):
    """Log times ``start_ns <= t < stop_ns`` (None: no limit), and the expected number of files."""

    start_ns: int | None
    stop_ns: int | None
    files: int


class Stretches(NamedTuple):
    """A division of a recording into stretches.

    Attributes
    ----------
    stretches
        In order, without gaps.
    needs_transforms
        Whether the conversion needs transforms.
    """

    stretches: tuple[Stretch, ...]
    needs_transforms: bool


def may_be_cut(cut: Cut | None) -> bool:
    """Return whether time alone decides which file a message is in."""
    return cut is not None and bool(cut.duration_ns) and not cut.size and not cut.repeats


def stretches_of(sources: Sequence[Path], options: ConvertOptions, cut: Cut, *, piece_bytes: int) -> Stretches | None:
    """Decide where a recording is cut; None if it is better converted by one process.

    This is so for short recordings, for damaged ones (each process would have to recover the index), for those that
    are compressed as a whole, and if scans are made of several messages, which may be in two pieces.

    Parameters
    ----------
    cut
        When new files begin.
    piece_bytes
        The minimum number of the source's bytes for a process.

    Raises
    ------
    Pc2ScanError
        If the recording cannot be converted.
    """
    if any(source.name.lower().endswith(SUFFIXES) for source in sources):
        return None
    with ExitStack() as stack:
        reader, _, plan = open_plan(sources, options, stack)
        span = span_of(reader, options)
        end_ns = reader.summary.end_ns
        if reader.damage or plan.combinations or end_ns is None:
            return None
        last_ns = end_ns if span.stop_ns is None else min(end_ns, span.stop_ns - 1)
        edges = _edges(reader, plan, span, last_ns, replace(cut, begin_ns=span.first_ns))
    pieces = min(len(edges), reader.summary.size_bytes // max(1, piece_bytes))
    if pieces < 2:  # not worth it
        return None
    # The first piece also has everything before its first file, and the last one ends with the recording.
    firsts = [len(edges) * number // pieces for number in range(pieces)] + [len(edges)]
    stretches = tuple(
        Stretch(edges[first] if first else None, edges[last] if last < len(edges) else None, last - first)
        for first, last in pairwise(firsts)
    )
    return Stretches(stretches, any(spec.needs_transforms for spec in plan.specs))


def _edges(reader: Reader, plan: Plan, span: Span, last_ns: int, cut: Cut) -> list[int]:
    """Return where the files begin that will have messages, according to the index."""
    count = cut.cell(last_ns) + 1
    if count > _MOST_FILES:
        return []
    written = [route.connection for route in plan.routes if route.passes or route.tasks]
    edges = [cut.begin_ns + number * cut.duration_ns for number in range(count)]
    found = []
    for edge in edges:
        stop_ns = edge + cut.duration_ns
        counts = reader.counts(written, edge, stop_ns if span.stop_ns is None else min(stop_ns, span.stop_ns))
        if len(counts) < len(written) or any(counts.values()):
            found.append(edge)
    return found


def read_stretch(
    sources: Sequence[Path], options: ConvertOptions, file: Path, start_ns: int | None, stop_ns: int | None
) -> list[Damage]:
    """Store the transforms of a stretch of a recording in a file; return the damage that was found."""
    with ExitStack() as stack:
        readers = open_recordings(sources, stack, verify=options.verify, strict=options.strict)
        reader = as_one(readers)
        store_transforms(reader, options.frames, file, start_ns, stop_ns)
        return list(reader.damage)


def join(folder: Path, pieces: Sequence[Piece], made: Sequence[PieceResult]) -> None:
    """Move the files of pieces into one directory, and write its metadata.yaml.

    Parameters
    ----------
    folder
        The directory with the folders of the pieces and the files of transforms. Both are removed.
    pieces, made
        The pieces in their order, and their results.

    Raises
    ------
    OutputError
        If a file cannot be moved or written.
    """
    import shutil  # noqa: PLC0415

    info = join_infos([each.info for each in made])
    try:
        wanted = set(info["relative_file_paths"])
        for piece in pieces:
            for file in piece.folder.iterdir():
                if file.name in wanted:
                    file.rename(folder / file.name)
        for entry in folder.iterdir():
            if entry.name not in wanted:
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
    except OSError as err:
        raise OutputError(f"the parts cannot be joined: {err.strerror}", path=folder) from err
    write_info(folder, info)


def join_reports(made: Sequence[PieceResult], damage: Iterable[Damage], options: ConvertOptions) -> Report:
    """Join the reports of the pieces.

    Parameters
    ----------
    damage
        Damage that was found while transforms were read.

    Raises
    ------
    Pc2ScanError
        If the result is not worth writing.
    """
    report = made[0].report
    topics = _by_key(report)
    for other in (each.report for each in made[1:]):
        for key, entry in _by_key(other).items():
            if key in topics:
                topics[key].add(entry)
            else:
                topics[key] = entry
        report.skipped = [*report.skipped, *other.skipped][:MAX_LISTED]
        report.warnings += (text for text in other.warnings if text not in report.warnings)
        report.notes += (text for text in other.notes if text not in report.notes)
        report.damage += other.damage
        report.messages_read += other.messages_read
    report.topics = list(topics.values())
    # For a place, the damage that a conversion has found replaces what reading the transforms has found.
    places = {(each.path, each.offset) for each in report.damage}
    report.damage += (each for each in damage if each.offset is None or (each.path, each.offset) not in places)
    report.damage = list(dict.fromkeys(report.damage))
    conclude(report, _join_tallies(each.tally for each in made), options)
    return report


def _by_key(report: Report) -> dict[tuple[object, ...], TopicReport]:
    """Return the topics' entries by their source, target and output."""
    # Specs from different processes may compare unequal, because they may have the user's own filters.
    specs = {id(spec): number for number, spec in enumerate(report.scans)}
    return {
        (each.topic, each.msgtype, each.target, each.action, each.note, specs.get(id(each.spec))): each
        for each in report.topics
    }


def _join_tallies(tallies: Iterable[Tally]) -> Tally:
    """Return the tallies of all pieces as one."""
    first, *others = tallies
    counts = list(first.counts)
    refusals = {text: dict.fromkeys(names) for text, names in first.refusals.items()}
    for other in others:
        counts = [
            (topic, declared, read + more)
            for (topic, declared, read), (_, _, more) in zip(counts, other.counts, strict=True)
        ]
        for text, names in other.refusals.items():
            refusals.setdefault(text, {}).update(dict.fromkeys(names))
    return first._replace(counts=counts, refusals={text: list(names) for text, names in refusals.items()})

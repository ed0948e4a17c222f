"""Makes a page that overlays the scans of two recordings, beginning with those that differ in most beams."""

from __future__ import annotations

import heapq
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.compare.diff import open_source, pair_streams
from pc2scan.compare.match import match_messages
from pc2scan.core.compare import differing_elements
from pc2scan.errors import DecodeError, TopicError
from pc2scan.files.ownership import InputPath, OutputPath, refuse_overlap
from pc2scan.files.text_output import text_output
from pc2scan.messages.laserscan import LASERSCAN, LaserScan, decode_laserscan
from pc2scan.text import counted

from .html import BEGINNING, check_page_name, html
from .recording import moment_text
from .scans import layer

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from pc2scan.compare.diff import TopicPair
    from pc2scan.compare.match import TopicStream
    from pc2scan.compare.rules import Rules
    from pc2scan.model import RawMessage

#: Maximum number of moments on a page.
_MOST = 20


def write_comparison(
    a: Path,
    b: Path,
    destination: Path,
    *,
    topics: Sequence[TopicPair],
    rules: Rules,
    summary: str,
) -> None:
    """Write a page of the scans that differ most, with the differing beams marked.

    Parameters
    ----------
    a, b
        The recordings.
    destination
        The page.
    topics
        The topics to compare; empty for all.
    rules
        Which differences are allowed.
    summary
        The result of the comparison, as text.

    Raises
    ------
    UsageError
        If the name is not that of a page.
    TopicError
        If neither recording has scans to show.
    DestinationError, OutputError
        If the page cannot be written.
    """
    check_page_name(destination)
    refuse_overlap([InputPath(a), InputPath(b)], [OutputPath(destination)])
    with text_output(destination, beginning=BEGINNING, overwrite=False) as deliver:
        deliver(_page(a, b, topics, rules, summary))


def _page(a: Path, b: Path, topics: Sequence[TopicPair], rules: Rules, summary: str) -> str:
    with ExitStack() as stack:
        left, right = open_source(a), open_source(b)
        for source in (left, right):
            stack.callback(source.close)
        pairs = (
            (number, differing_beams(one, other, rules), one, other)
            for number, (one, other) in enumerate(_scan_pairs(pair_streams(left, right, topics)))
        )
        # Among scans with equally many differing beams, the first ones are shown.
        worst = heapq.nlargest(_MOST, pairs, key=lambda pair: (len(pair[1]), -pair[0]))
    if not worst:
        raise TopicError("the recordings have no scans in common that can be shown", path=a)
    blobs: dict[str, bytes] = {}
    moments = [
        {
            "moment": f"{moment_text(one.stamp_ns)}, {counted(len(beams), 'beam', 'differ')}",
            "frame": one.frame_id,
            "layers": [
                layer(f"A: {a.name}", 0, one, blobs, differing=beams),
                layer(f"B: {b.name}", 1, other, blobs, differing=beams),
            ],
        }
        for _, beams, one, other in sorted(worst, key=lambda pair: pair[0])
    ]
    lines = [{"text": line.strip(), "wrong": False} for line in summary.splitlines() if line.strip()]
    description: dict[str, Any] = {
        "kind": "diff",
        "title": f"{a.name} and {b.name}",
        "subtitle": f"the {len(moments)} scans in which most beams differ" if len(moments) > 1 else "one scan",
        "notes": [],
        "moments": moments,
        "findings": [{"heading": "pc2scan diff", "lines": lines}],
    }
    return html(description, blobs)


def _scan_pairs(streams: Sequence[tuple[TopicStream, TopicStream]]) -> Iterator[tuple[LaserScan, LaserScan]]:
    """Yield the pairs of scans that match; scans that only one side has, or that cannot be read, are skipped."""
    for one, other in streams:
        if not any(c.ros_type == LASERSCAN for c in one.connections):
            continue
        for pair in match_messages(one, other):
            if pair.a is not None and pair.b is not None:
                scans = [_decode(message) for message in (pair.a, pair.b)]
                if scans[0] is not None and scans[1] is not None:
                    yield scans[0], scans[1]


def _decode(message: RawMessage) -> LaserScan | None:
    if message.connection.ros_type != LASERSCAN:
        return None
    try:
        return decode_laserscan(message.data, message.connection.serialization)
    except DecodeError:
        return None


def differing_beams(one: LaserScan, other: LaserScan, rules: Rules) -> list[int]:
    """Return the beams whose ranges differ beyond the tolerance, or that only one of the scans has."""
    both = min(len(one.ranges), len(other.ranges))
    differ = differing_elements(one.ranges[:both], other.ranges[:both], rules.tolerance("ranges"))
    return [*np.flatnonzero(differ).tolist(), *range(both, max(len(one.ranges), len(other.ranges)))]

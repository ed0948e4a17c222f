"""``pc2scan diff``."""

from __future__ import annotations

from pathlib import Path

from pc2scan.compare.diff import TopicPair
from pc2scan.compare.diff import diff as compare
from pc2scan.compare.rules import Rules
from pc2scan.options.call import Options

from .render import progress_bar, show


def diff(a: Path, b: Path | None, *, options: Options) -> int:
    """Show the differences between two recordings."""
    with progress_bar(options) as progress:
        pairs = [TopicPair.parse(topic) for topic in options.topics]
        rules = Rules.of(options)
        result = compare(a, b, topics=pairs, all_topics=options.all_topics, rules=rules, progress=progress)
    return show(result, options)

"""Requests as they would be typed: the other direction than `pc2scan.cli.options`."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from pc2scan.pipeline.options import ConvertOptions, TimeBound

    from .options import Points

__all__ = ["convert_words"]


def convert_words(sources: Sequence[Path], options: ConvertOptions, points: Points, destination: str) -> list[str]:
    """Return the words of a command that converts the same points of the same topics in the same frames.

    The parameters of the projection are left to the caller.
    """
    words = ["pc2scan", "convert", *map(str, sources), "-o", destination]
    return [*words, *_option_words(options), *_point_words(points)]


def _option_words(options: ConvertOptions) -> Iterator[str]:
    for request in options.topics:
        yield from ("--topic", request.source if request.target is None else f"{request.source}:={request.target}")
    frames = options.frames
    for topic in frames.tf_topics:
        yield from ("--tf-topic", topic)
    for path in frames.tf_from:
        yield from ("--tf-from", str(path))
    for static in frames.static:
        numbers = " ".join(map(repr, static.parent_from_child.pose))
        yield from ("--static-tf", f"{static.parent} {static.child} {numbers}")
    if frames.source_frame:
        yield from ("--source-frame", frames.source_frame)
    if frames.write_static:
        yield "--write-static-tf"
    for name, bound in (("--start", options.start), ("--end", options.end)):
        if bound is not None:
            yield from (name, _time(bound))


def _time(bound: TimeBound) -> str:
    seconds, rest = divmod(bound.nanoseconds, 1_000_000_000)
    return f"{'@' if bound.absolute else ''}{seconds}.{rest:09d}"


def _point_words(points: Points) -> Iterator[str]:
    texts = {
        "--where": points.where,
        "--exclude-box": points.exclude_box,
        "--exclude-polygon": points.exclude_polygon,
    }
    for option, values in texts.items():
        for value in values:
            yield from (option, value)
    if points.min_height_slope is not None:
        yield f"--min-height-slope={points.min_height_slope!r}"

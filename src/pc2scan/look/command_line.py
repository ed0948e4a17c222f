"""Converts options of the library to the command line: the inverse of `pc2scan.cli.options`."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

from pc2scan.options.table import output_options, spelling_of
from pc2scan.options.values import Flag, Text

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from pc2scan.options.moment import TimeBound
    from pc2scan.pipeline.options import ConvertOptions
    from pc2scan.pipeline.stages.filters import Filter


def convert_words(sources: Sequence[Path], options: ConvertOptions, destination: str) -> list[str]:
    """Return the words of a command that converts the same points of the same topics in the same frames.

    Parameters of the projection are not included; the caller adds them. Filters without an option are not included.
    """
    words = ["pc2scan", "convert", *map(str, sources), "-o", destination, *_option_words(options)]
    for chosen in options.scan.filters:
        words += _filter_words(chosen)
    return words


def _option_words(options: ConvertOptions) -> Iterator[str]:
    scan, frames = options.scan, options.frames
    for request in scan.topics:
        yield from ("--topic", request.source if request.target is None else f"{request.source}:={request.target}")
    for topic in frames.tf_topics:
        yield from ("--tf-topic", topic)
    for path in frames.tf_from:
        yield from ("--tf-from", str(path))
    for static in frames.static:
        numbers = " ".join(map(repr, static.parent_from_child.pose))
        yield from ("--static-tf", f"{static.parent} {static.child} {numbers}")
    if frames.source_frame:
        yield from ("--source-frame", frames.source_frame)
    for chosen in scan.remove:
        default = type(chosen)()
        words = (f"{each.name}={getattr(chosen, each.name)}" for each in fields(chosen) if chosen != default)
        yield from ("--remove", " ".join((chosen.name, *words)))
    for name, option in output_options().items():
        value = getattr(scan, name, option.default)
        if isinstance(option.value, Flag | Text) and value != option.default:
            yield from (option.spelling,) if value is True else (option.spelling, str(value))
    asked = scan.combining
    times = (("--window", asked.window_ns), ("--accumulate", asked.span_ns), ("--every", asked.every_ns))
    if asked.lead:
        yield from ("--lead", asked.lead)
    for name, nanoseconds in times:
        if nanoseconds:
            yield from (name, f"{nanoseconds / 1e9!r}s")
    if asked.count:
        yield from ("--accumulate", f"{asked.count}clouds")
    if asked.rebin:
        yield "--rebin"
    for name, bound in (("--start", options.start), ("--end", options.end)):
        if bound is not None:
            yield from (name, _time(bound))


def _time(bound: TimeBound) -> str:
    seconds, rest = divmod(bound.nanoseconds, 1_000_000_000)
    return f"{'@' if bound.absolute else ''}{seconds}.{rest:09d}"


def _filter_words(chosen: Filter) -> list[str]:
    """Return the option that asks for a filter; filters that are made in Python have none."""
    text = getattr(chosen, "text", None)
    spelling = spelling_of(chosen.name)
    return [spelling, text] if text is not None and spelling else []

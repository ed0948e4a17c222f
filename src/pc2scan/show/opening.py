"""What a page opens with, where nothing else is asked for: the frame and the heights that ``info`` proposes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import Pc2ScanError
from pc2scan.transforms.static import added_transforms

from .info import info_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pc2scan.bags.reader import Reader
    from pc2scan.request.options import ConvertOptions

    from .info import Info


_HEIGHTS = ("min_height", "max_height")


class Opening(NamedTuple):
    """What a page opens with.

    Attributes
    ----------
    options
        The options of the conversion, with the frame and the heights of the first topic.
    heights
        The heights of each topic, ``min_height`` and ``max_height`` in metres in this frame, by topic. Topics without
        a proposal are missing.
    notes
        What is said of them.
    """

    options: ConvertOptions
    heights: Mapping[str, Mapping[str, float]]
    notes: tuple[str, ...]


def opening(reader: Reader, options: ConvertOptions) -> Opening:
    """Return options with the frame and the heights that `pc2scan.info` proposes.

    They are as they were if heights are given, or if nothing can be proposed in the frame that is given.

    Parameters
    ----------
    reader
        The recording.
    options
        The options of the conversion.
    """
    params, asked = options.scan.params, [request.source for request in options.scan.topics]
    defaults = ProjectionParams()
    unchanged = Opening(options, {}, ())
    if (params.min_height, params.max_height) != (defaults.min_height, defaults.max_height):
        return unchanged
    try:
        # Heights are of the first clouds, however many are sampled.
        found = info_of([reader], samples=1, described=asked, target_frame=params.target_frame, frames=options.frames)
        proposals = [(call.options, _topics(call.options, found)) for call in found.proposals]
        first = next((each for each, _ in proposals if params.target_frame in ("", _frame(each)[0])), None)
        if first is None or "min_height" not in first:
            return unchanged
        frame, static = _frame(first)
        frames = replace(options.frames, static=(*options.frames.static, *added_transforms(static)))
    except Pc2ScanError:
        # What is wrong may matter for the page, too, which says so then.
        return unchanged
    heights = {
        topic: {name: each[name] for name in _HEIGHTS if name in each}
        for each, topics in proposals
        for topic in topics
        if _frame(each) == (frame, static)
    }
    chosen = {name: first[name] for name in _HEIGHTS if name in first}
    changed = replace(params, target_frame=frame, **chosen)
    where = f"in frame {frame!r}" if frame else "in the frame of the clouds"
    heights_text = f"{changed.min_height:g} to {changed.max_height:g} m {where}"
    note = f"The page opens with the heights that pc2scan info proposes: {heights_text}."
    return Opening(replace(options.with_scan(params=changed), frames=frames), heights, (note,))


def _frame(proposal: Mapping[str, Any]) -> tuple[str, tuple[str, ...]]:
    """Return the target frame of a proposed conversion, and the transforms that it adds."""
    return proposal.get("target_frame", ""), _texts(proposal, "static_tf")


def _topics(proposal: Mapping[str, Any], found: Info) -> list[str]:
    """Return the topics that a proposed conversion reads."""
    named = [text.partition(":=")[0] for text in _texts(proposal, "topics")]
    return named or [each.topic for each in found.clouds]


def _texts(proposal: Mapping[str, Any], name: str) -> tuple[str, ...]:
    """Return the values of an option that may be given once or several times."""
    value = proposal.get(name, ())
    return (value,) if isinstance(value, str) else tuple(value)

"""Describes the page of clouds: points and fields, frames at their stamps, and the parameters that can be changed."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

from pc2scan.core.params import ProjectionParams
from pc2scan.core.presets import PRESETS
from pc2scan.errors import TransformError
from pc2scan.options.call import call_words
from pc2scan.options.table import PARAMETERS, output_options, spelling_of
from pc2scan.result import Call

from .html import compress, decompress, description_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.core.rigid import Rigid
    from pc2scan.options.moment import TimeBound
    from pc2scan.request.options import ConvertOptions
    from pc2scan.transforms.buffer import TransformBuffer

    from .shots import Shot, Shots

#: Maximum size of all compressed clouds of a page, in bytes. As text in the page they take a third more.
MOST_BYTES = 10_500_000

#: The names of the blobs of a cloud, by the keys of its description.
_BLOBS = {"data": "cloud", "filtered": "filtered"}

#: Maximum number of frames that are shown.
_MOST_FRAMES = 60

#: Parameters that do not change the ranges, so the page does not have them.
_NOT_SHOWN = {"target_frame", "transform_tolerance", "scan_time", "queue_size", "time_increment"}
_SHOWN = tuple(spec.name for spec in fields(ProjectionParams) if spec.name not in _NOT_SHOWN)


class Packing:
    """Compresses clouds as they come. If they are too large for a page, only some of their points are kept.

    Attributes
    ----------
    step
        Of how many points one is kept.
    blobs
        The compressed clouds, and which of their points are filtered, by name.
    """

    def __init__(self) -> None:
        self.step = 1
        self.blobs: dict[str, bytes] = {}
        self._descriptions: dict[str, dict[str, Any]] = {}
        self._totals: list[int] = []

    def add(self, shot: Shot) -> Shot:
        """Compress the points of a cloud, and return it without them."""
        number = len(self._totals)
        self._totals.append(len(shot.columns["x"]))
        self._put(f"cloud-{number}", shot.columns, self.step)
        if shot.filtered is not None:
            self._put(f"filtered-{number}", {"filtered": shot.filtered}, self.step)
        while sum(map(len, self.blobs.values())) > MOST_BYTES and self.step < max(self._totals):
            self.step *= 2
            for name, data in self.blobs.items():
                self._put(name, decompress(data, self._descriptions[name]), 2)
        return replace(shot, columns={}, filtered=None)

    def _put(self, name: str, columns: Mapping[str, NDArray[Any]], step: int) -> None:
        thinned = {field: column[::step] for field, column in columns.items()}
        self.blobs[name] = compress(thinned)
        self._descriptions[name] = description_of(name, thinned)

    def described(self, number: int) -> dict[str, Any]:
        """Return what the page knows of the points of a cloud."""
        descriptions = {key: self._descriptions.get(f"{name}-{number}") for key, name in _BLOBS.items()}
        return {**descriptions, "total": self._totals[number]}


def clouds_page(
    sources: Sequence[Path],
    taken: Shots,
    packed: Packing,
    options: ConvertOptions,
    heights: Mapping[str, Mapping[str, float]],
    *,
    preset: str,
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Describe a page of clouds.

    Parameters
    ----------
    sources
        The recordings as they were given, for the command that the page shows.
    taken
        The clouds, without their points.
    packed
        The points.
    options
        The options of the conversion.
    heights
        Those that are proposed for each topic; empty for none.
    preset
        The preset that the parameters come from; empty for none.

    Returns
    -------
    description, blobs
        As `pc2scan.show.html.html` takes them.
    """
    notes = list(taken.notes)
    if heights:
        params = options.scan.params
        where = f"in frame {params.target_frame!r}" if params.target_frame else "in the frame of the clouds"
        text = f"{params.min_height:g} to {params.max_height:g} m {where}"
        notes = [f"The page opens with the heights that pc2scan info proposes: {text}.", *notes]
    if options.scan.deskew:
        notes.append("Clouds are deskewed, as if all points had been measured at the scan's time.")
    if options.scan.level:
        notes.append("Clouds are shown as recorded; only a conversion makes scans level.")
    if packed.step > 1:
        notes.append(f"To keep this page small, only 1 of {packed.step} points is shown and projected.")
    if options.scan.filters:
        notes.append("Filters were applied when this page was made: no slider changes which points they reject.")
    if options.scan.remove:
        notes.append("Beams that `remove` removes from the scans are still shown here.")
    topics: dict[str, list[dict[str, Any]]] = {}
    for number, shot in enumerate(taken.shots):
        entry = _shot_as_dict(shot, taken.transforms) | packed.described(number)
        topics.setdefault(shot.topic, []).append(entry)
    base = ProjectionParams(**PRESETS[preset]) if preset else ProjectionParams()  # type: ignore[arg-type]
    description = {
        "kind": "clouds",
        "notes": notes,
        "warnings": taken.warnings,
        "params": _shown(taken.params),
        "base": _shown(base),
        "defaults": _shown(ProjectionParams()),
        "presets": {name: {k: v for k, v in values.items() if k in _SHOWN} for name, values in PRESETS.items()},
        "preset": preset,
        "parameters": {
            name: {"help": PARAMETERS[name].help.replace("`", ""), "choices": _choices(PARAMETERS[name].value.words)}
            for name in _SHOWN
        },
        "command": call_words(_conversion(sources, options)),
        "targetFrame": options.scan.params.target_frame,
        "topics": [
            {"topic": topic, "heights": heights.get(topic, {}), "clouds": clouds} for topic, clouds in topics.items()
        ],
    }
    return description, packed.blobs


def _choices(words: Sequence[str]) -> list[str]:
    """Return the words that a parameter may be, with some of ``kth=N``."""
    return [word.replace("N", number) for word in words for number in ("23" if word == "kth=N" else "N")]


def _conversion(sources: Sequence[Path], options: ConvertOptions) -> Call:
    """Return the call that converts the same points of the same topics in the same frames.

    Parameters of the projection are not included, because the page adds them. Filters without an option are not
    included.
    """
    scan, frames = options.scan, options.frames
    given: dict[str, Any] = {
        "destination": "scans.mcap",
        "topics": tuple(
            each.source if each.target is None else f"{each.source}:={each.target}" for each in scan.topics
        ),
        "tf_topics": frames.tf_topics,
        "tf_from": frames.tf_from,
        "static_tf": tuple(
            f"{each.parent} {each.child} {' '.join(map(repr, each.parent_from_child.pose))}" for each in frames.static
        ),
        "source_frame": frames.source_frame,
        "cloud_scale": options.cloud_scale if options.cloud_scale != 1 else None,
        "remove": scan.remove,
    }
    for name, option in output_options().items():
        value = getattr(scan, name, option.default)
        if not option.value.repeats and value != option.default:
            given[name] = value
    given |= {name: _time_text(getattr(options, name)) for name in ("start", "end")}
    for chosen in scan.filters:
        text = getattr(chosen, "text", None)
        if text is not None and spelling_of(chosen.name):
            given[chosen.name] = (*given.get(chosen.name, ()), text)
    return Call("convert", tuple(map(str, sources)), {name: value for name, value in given.items() if value})


def _time_text(bound: TimeBound | None) -> str:
    if bound is None:
        return ""
    seconds, rest = divmod(bound.nanoseconds, 1_000_000_000)
    return f"{'@' if bound.absolute else ''}{seconds}.{rest:09d}"


def _shown(params: ProjectionParams) -> dict[str, float | bool | str]:
    """Return the parameters that the page has. Infinity is text, because JSON has no infinite numbers."""
    values = {name: getattr(params, name) for name in _SHOWN}
    if params.beams == "auto":
        values["beams"] = 0
    return {name: str(v) if isinstance(v, float) and math.isinf(v) else v for name, v in values.items()}


def _shot_as_dict(shot: Shot, buffer: TransformBuffer | None) -> dict[str, Any]:
    frame_id, rigid, _ = shot.place
    return {
        "moment": shot.moment,
        "frame": shot.frame,
        "targetFrame": frame_id,
        "transform": None
        if rigid is None
        else {"quaternion": rigid.quaternion.tolist(), "translation": rigid.translation.tolist()},
        "mount": _mount(rigid),
        "frames": [] if buffer is None else list(_origins(buffer, frame_id, shot.stamp_ns)),
    }


def _mount(rigid: Rigid | None) -> dict[str, float]:
    values = (0.0,) * 6 if rigid is None else (*rigid.translation.tolist(), *rigid.rpy)
    return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), values, strict=True))


def _origins(buffer: TransformBuffer, target: str, stamp_ns: int) -> Iterator[dict[str, Any]]:
    """Yield the positions of other frames in the scan's frame."""
    for name in buffer.frames[:_MOST_FRAMES]:
        if name.removeprefix("/") == target.removeprefix("/"):
            continue
        try:
            x, y, z = buffer.lookup(target, name, stamp_ns).translation.tolist()
        except TransformError:
            continue
        if math.isfinite(x + y + z):
            yield {"name": name, "x": x, "y": y, "z": z}

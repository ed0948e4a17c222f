"""Describes the page of clouds: points and fields, frames at their stamps, and the parameters that can be changed."""

from __future__ import annotations

import math
from dataclasses import fields
from functools import partial
from typing import TYPE_CHECKING, Any

from pc2scan.core.params import ProjectionParams
from pc2scan.core.presets import PRESETS
from pc2scan.errors import TransformError, stamp_text
from pc2scan.messages.clouds import CLOUDS
from pc2scan.options.call import call_words
from pc2scan.options.table import PARAMETERS
from pc2scan.result import Call

from .html import compressed
from .shots import take_shots

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from pc2scan.options.call import Options
    from pc2scan.request.options import ConvertOptions
    from pc2scan.transforms.buffer import TransformBuffer

    from .recording import ShownRecording
    from .shots import Shot

#: How many points a page has, in all clouds together: some 10 MB, and as text in the page a third more.
_MOST_POINTS = 1_500_000

#: Maximum number of frames that are shown.
_MOST_FRAMES = 60

#: Parameters that do not change the ranges, so the page does not have them.
_NOT_SHOWN = {"target_frame", "transform_tolerance", "scan_time", "queue_size", "time_increment"}
_SHOWN = tuple(spec.name for spec in fields(ProjectionParams) if spec.name not in _NOT_SHOWN)

#: Options of the call that the page's command does not have as they are: those of pages, objects, and where parameters
#: come from, which the page adds one by one.
_OF_PAGES = {
    *("clouds", "at", "overwrite", "filters", "static_tf", "start", "end", "remap", *PARAMETERS),
    *("preset", "params", "params_file", "node", "launch_args", "param"),
}


def clouds_page(
    sources: Sequence[Path],
    recording: ShownRecording,
    asked: Options,
    options: ConvertOptions,
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Describe a page of clouds.

    Parameters
    ----------
    sources
        The recordings as they were given, for the command that the page shows.
    recording
        The recording.
    asked
        The options of the call.
    options
        The options of the conversion.

    Returns
    -------
    description, blobs
        As `pc2scan.show.html.html` takes them.
    """
    scan, preset = options.scan, asked.preset or ""
    topics: dict[str, list[dict[str, Any]]] = {}
    blobs: dict[str, bytes] = {}
    count = max(1, len({each.topic for each in recording.reader.connections if each.ros_type in CLOUDS}))
    most = _MOST_POINTS // (count * (len(recording.at_ns) or asked.clouds))
    taken = take_shots(recording, options, asked.clouds, level=False, keep=partial(_packed, blobs, max(1, most)))
    for shot in taken.shots:
        topics.setdefault(shot.topic, []).append(_shot_as_dict(shot, taken.transforms))
    notes = {
        "Clouds are deskewed, as if all points had been measured at the scan's time.": scan.deskew,
        "Clouds are shown as recorded; only a conversion makes scans level.": scan.level,
        f"To keep this page small, at most {most:,} points of a cloud are shown and projected.": any(
            shot.page["total"] > shot.page["data"]["length"] for shot in taken.shots
        ),
        "Filters were applied when this page was made: no slider changes which points they reject.": scan.filters,
        "Beams that `remove` removes from the scans are still shown here.": scan.remove,
    }
    told = [*taken.notes, *(text for text, applies in notes.items() if applies)]
    return {
        "kind": "clouds",
        "notes": told,
        "warnings": taken.warnings,
        "params": _shown(taken.params),
        "base": _shown(ProjectionParams(**PRESETS[preset]) if preset else ProjectionParams()),  # type: ignore[arg-type]
        "defaults": _shown(ProjectionParams()),
        "presets": {name: {k: v for k, v in values.items() if k in _SHOWN} for name, values in PRESETS.items()},
        "preset": preset,
        "parameters": {
            name: {"help": PARAMETERS[name].help.replace("`", ""), "choices": _choices(PARAMETERS[name].value.words)}
            for name in _SHOWN
        },
        "command": call_words(Call("convert", tuple(map(str, sources)), _command_options(asked, options))),
        "targetFrame": scan.params.target_frame,
        "topics": [{"topic": topic, "clouds": clouds} for topic, clouds in topics.items()],
    }, blobs


def _choices(words: Sequence[str]) -> list[str]:
    """Return the words that a parameter may be, with some of ``kth=N``."""
    return [word.replace("N", number) for word in words for number in ("23" if word == "kth=N" else "N")]


def _command_options(asked: Options, options: ConvertOptions) -> dict[str, Any]:
    """Return the options that convert the same points of the same topics in the same frames.

    Parameters of the projection are not included, because the page adds them.
    """
    given = {name: value for name, value in asked.given.items() if name not in _OF_PAGES}
    for name in ("start", "end"):
        if (bound := getattr(asked, name)) is not None:
            given[name] = f"{'@' if bound.absolute else ''}{stamp_text(bound.nanoseconds)}"
    # A scans file names its topics.
    named = () if "scans" in given else options.scan.topics
    topics = tuple(each.source + (f":={each.target}" if each.target else "") for each in named)
    static = tuple(
        f"{each.parent} {each.child} {' '.join(map(repr, each.parent_from_child.pose))}"
        for each in options.frames.static
    )
    given = {"destination": "scans.mcap", **given, "topics": topics, "static_tf": static}
    return {name: value for name, value in given.items() if value}


def _packed(blobs: dict[str, bytes], most: int, shot: Shot) -> Shot:
    """Add the points of a cloud, at most so many, to a page; return the cloud with what the page knows of them."""
    total = shot.columns["x"].size
    step = -(-total // most) or 1
    page: dict[str, Any] = {"total": total, "filtered": None}
    page["data"] = compressed(blobs, {name: column[::step] for name, column in shot.columns.items()})
    if shot.filtered is not None:
        page["filtered"] = compressed(blobs, {"filtered": shot.filtered[::step]})
    return shot._replace(columns={}, filtered=None, page=page)


def _shown(params: ProjectionParams) -> dict[str, float | bool | str]:
    """Return the parameters that the page has. Infinity is text, because JSON has no infinite numbers."""
    values = {name: getattr(params, name) for name in _SHOWN}
    if params.beams == "auto":
        values["beams"] = 0
    return {name: str(v) if isinstance(v, float) and math.isinf(v) else v for name, v in values.items()}


def _shot_as_dict(shot: Shot, buffer: TransformBuffer | None) -> dict[str, Any]:
    frame_id, rigid, _ = shot.place
    pose = (0.0,) * 6 if rigid is None else (*rigid.translation.tolist(), *rigid.rpy)
    return {
        "moment": shot.moment,
        "frame": shot.frame,
        "targetFrame": frame_id,
        "transform": None
        if rigid is None
        else {"quaternion": rigid.quaternion.tolist(), "translation": rigid.translation.tolist()},
        "mount": dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), pose, strict=True)),
        "frames": [] if buffer is None else list(_origins(buffer, frame_id, shot.stamp_ns)),
        **shot.page,
    }


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

"""Checks a fixed frame before the conversion: whether it exists, and whether anything moves in it."""

from __future__ import annotations

from contextlib import closing, suppress
from typing import TYPE_CHECKING

from pc2scan.errors import MessageError, ParameterError
from pc2scan.messages.clouds import CLOUDS
from pc2scan.messages.laserscan import LASERSCAN, decode_laserscan
from pc2scan.text import did_you_mean
from pc2scan.tf.lookup_errors import frames_text
from pc2scan.tf.world_frames import WORLDS, find_body_motion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.model import Connection
    from pc2scan.tf.buffer import TransformBuffer

    from .scan_spec import ScanSpec
    from .stream import Span


def check_fixed_frame(
    reader: Reader,
    sources: Sequence[Connection],
    spec: ScanSpec,
    source_frame: str,
    buffer: TransformBuffer,
    span: Span,
) -> list[str]:
    """Return warnings if nothing moves in the fixed frame, or if regions of deskewed clouds move with the sensor.

    Raises
    ------
    ParameterError
        If the frame does not exist.
    """
    fixed = spec.fixed_frame.removeprefix("/")
    if fixed not in buffer.frames:
        near = did_you_mean(fixed, sorted(buffer.frames)) or _offered(buffer, "")
        advice = "`static_tf` or `tf_from` adds a transform"
        raise ParameterError(
            f"`fixed_frame` is {fixed!r}, which is in no transform; {frames_text(buffer.frames)}",
            hint=f"{near}{'' if near.endswith('?') or not near else ';'} {advice}".strip(),
        )
    frame = spec.params.target_frame or source_frame or first_frame(reader, sources, span)
    frame = frame.removeprefix("/")
    if not frame or not buffer.is_rigid(fixed, frame):
        return _moving_regions(reader, sources, spec, source_frame, buffer, span)
    if fixed == frame and find_body_motion(buffer, fixed, source_frame or first_frame(reader, sources, span)):
        return []  # the target frame itself is wrong, which another warning says
    which = "the frame of the scans itself" if fixed == frame else f"and {frame} never moves in it"
    offered = _offered(buffer, fixed)
    advice = offered or "the recording has no transform that moves; `tf_from` adds the odometry of another one"
    return [f"`fixed_frame` is {fixed}, {which}: no point is moved; {advice}"]


def _moving_regions(
    reader: Reader,
    sources: Sequence[Connection],
    spec: ScanSpec,
    source_frame: str,
    buffer: TransformBuffer,
    span: Span,
) -> list[str]:
    """Return warnings about filters in frames that are not fixed to the sensor of clouds that are deskewed."""
    regions = {each.frame: each.name for each in spec.filters if isinstance(each.frame, str)} if spec.deskew else {}
    source = regions and (source_frame or first_frame(reader, sources, span))
    return [
        f"`{name}` is in {frame}, in which {source} moves, but it rejects points where they were recorded, before "
        "`deskew`: its edges are off by as much as the sensor moves within a cloud"
        for frame, name in regions.items()
        if source and frame.removeprefix("/") in buffer.frames and not buffer.is_rigid(frame, source)
    ]


def _offered(buffer: TransformBuffer, fixed: str) -> str:
    """Return a hint that suggests a frame in which something moves; empty if there is none."""
    roots = [root for tree in buffer.trees if not fixed or fixed in tree.frames for root in tree.roots]
    names = dict.fromkeys((*(name for name in WORLDS if name in buffer.frames), *roots))
    moving = {child for child in buffer.frames if (link := buffer.history(child)) is not None and not link.static}
    found = [name for name in names if any(not buffer.is_rigid(name, child) for child in moving if child != name)]
    found = [name for name in found if not fixed or not buffer.is_rigid(name, fixed)]
    return f"`fixed_frame={found[0]}` is a frame that does not move" if found else ""


def first_frame(reader: Reader, sources: Sequence[Connection], span: Span) -> str:
    """Return the frame of the first message; empty if there is none."""
    with suppress(MessageError), closing(reader.messages(sources, span.start_ns, span.stop_ns)) as messages:
        for message in messages:
            kind, serialization = message.connection.ros_type, message.connection.serialization
            if kind == LASERSCAN:
                return decode_laserscan(message.data, serialization).frame_id
            return CLOUDS[kind](serialization)(message.data).frame_id
    return ""

"""Describes the page of the scans of a recording."""

from __future__ import annotations

import math
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from pc2scan.errors import MessageError, RecordingError, TransformError
from pc2scan.messages.clouds import SCANS
from pc2scan.text import counted

from .html import compressed
from .recording import chosen_messages, moment_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pc2scan.messages.laserscan import LaserScan
    from pc2scan.model import Connection, RawMessage
    from pc2scan.request.options import ConvertOptions
    from pc2scan.transforms.buffer import TransformBuffer

    from .check import Check
    from .recording import ShownRecording

#: The pose of a scan that is shown in its own frame.
_HERE = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]


def scans_page(
    recording: ShownRecording,
    topics: Mapping[str, Sequence[Connection]],
    buffer: TransformBuffer,
    options: ConvertOptions,
    count: int,
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Describe a page of scans: the moments of the first topic, each with the next scan of every other topic.

    Scans are shown in the target frame or, without one, in the first topic's frame, as far as transforms connect them.

    Parameters
    ----------
    recording
        The recording, and the moments.
    topics
        The connections of each topic.
    buffer
        The transforms.
    options
        The options of a conversion, of which the target frame, ``start`` and ``end`` are used.
    count
        As for `chosen_messages`.

    Returns
    -------
    description, blobs
        For `pc2scan.show.html.html`; the caller adds the findings.

    Raises
    ------
    RecordingError
        If no scan can be shown.
    """
    taken: dict[str, list[RawMessage]] = {topic: [] for topic in topics}
    for message in chosen_messages(recording, topics, options, count):
        taken[message.connection.topic].append(message)
    blobs: dict[str, bytes] = {}
    moments = []
    failed: list[str] = []
    for together in zip_longest(*taken.values()):
        layers: list[dict[str, Any]] = []
        moment, common = "", options.scan.params.target_frame
        for number, message in enumerate(together):
            if message is None:
                continue
            topic, kind = message.connection.topic, message.connection.ros_type
            try:
                scan = SCANS[kind](message.connection.serialization, "first")(message.data)
            except MessageError as err:
                failed.append(f"{topic} at {moment_text(message.log_time_ns)}: {err.message}")
                continue
            common = common or scan.frame_id
            pose = _pose(buffer, common, scan.frame_id, scan.stamp_ns)
            where = scan.frame_id if pose is not None else f"{scan.frame_id}, not connected to {common}"
            moment = moment or moment_text(scan.stamp_ns or message.log_time_ns)
            layers.append(_layer(f"{topic} ({where})", number, scan, blobs, pose or _HERE))
        if layers:
            moments.append({"moment": moment, "frame": common, "layers": layers})
    if not moments:
        why = f"no scan can be shown; {failed[0]}" if failed else f"no scans on {', '.join(topics)}"
        raise RecordingError(why, path=recording.reader.path)
    warnings = [f"Not shown: {counted(len(failed), 'scan')}; {failed[0]}."] if failed else []
    return {"kind": "scans", "notes": [], "warnings": warnings, "moments": moments}, blobs


def _pose(buffer: TransformBuffer, target: str, source: str, stamp_ns: int) -> list[float] | None:
    """Return the 2 x 3 matrix that maps x, y and 1 in the scan's frame to x and y in another frame, row by row.

    None if there is no transform.
    """
    if target.removeprefix("/") == source.removeprefix("/"):
        return _HERE
    try:
        rigid = buffer.lookup(target, source, stamp_ns)
    except TransformError:
        return None
    (a, b, _), (c, d, _), _ = rigid.matrix.tolist()
    x, y, _ = rigid.translation.tolist()
    return [a, b, x, c, d, y]


def _layer(name: str, colour: int, scan: LaserScan, blobs: dict[str, bytes], pose: Sequence[float]) -> dict[str, Any]:
    """Describe a scan, and add its arrays to the page's blobs."""
    columns = {"ranges": scan.ranges.astype("<f4")}
    if len(scan.intensities) == len(scan.ranges) > 0:
        columns["intensities"] = scan.intensities.astype("<f4")
    return {
        "name": name,
        "colour": colour,
        "angleMin": _finite(scan.angle_min),
        "increment": _finite(scan.angle_increment),
        "pose": list(pose),
        "rangeMin": _finite(scan.range_min),
        "rangeMax": _finite(scan.range_max, math.inf),
        "data": compressed(blobs, columns),
    }


def findings(check: Check) -> list[dict[str, Any]]:
    """Return the results of `pc2scan check` for each topic."""
    sections = []
    for topic in check.topics:
        lines = [
            {"text": f"{consumer.consumer}: {consumer.outcome}", "wrong": consumer.outcome != "accepted"}
            for consumer in topic.consumers
        ]
        lines += [
            {"text": f"{entry.level}: {entry.text}", "wrong": entry.level == "defect"} for entry in topic.findings
        ]
        sections.append({"heading": f"pc2scan check: {topic.topic}", "lines": lines})
    return sections


def _finite(value: float, largest: float = 0.0) -> float:
    """Replace infinity, which JSON does not have, by the largest float64."""
    if math.isfinite(value):
        return float(value)
    return math.copysign(1.7976931348623157e308, value) if largest and not math.isnan(value) else 0.0

"""``pc2scan.view``: shows a recording as one HTML page that needs no network.

A page of clouds has the parameters that can be changed; of a recording without clouds, the scans are shown.

A page that is opened from the disk cannot load modules. So the modules of ``page/`` become one script, in which each
module is a function that returns its exports, called once, after the modules that it imports.

A recording is untrusted. So its data are never part of the markup or the script, only JSON in which ``<`` is escaped,
and base64. The page's content security policy allows this script and this style by their digests, and no requests.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
import zlib
from dataclasses import dataclass, fields, replace
from functools import partial
from html import escape
from importlib.resources import files
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from pc2scan.conversion.corrections import corrected, corrected_transforms
from pc2scan.core.params import ProjectionParams
from pc2scan.core.presets import PRESETS
from pc2scan.core.rigid import Rigid
from pc2scan.errors import MessageError, Pc2ScanError, RecordingError, UsageError, stamp_text, visible
from pc2scan.files.outputs import files_output, inputs_of, refuse_overlap
from pc2scan.files.paths import path_of, path_or_url
from pc2scan.messages.clouds import CLOUDS, SCANS
from pc2scan.model import of_types
from pc2scan.options.call import Options, call_words
from pc2scan.options.table import PARAMETERS, options_of
from pc2scan.parsing import conversion_of, first_output
from pc2scan.result import Call, json_value
from pc2scan.text import counted, moment_text
from pc2scan.transforms.static import added_transforms

from .check import check, scan_connections
from .info import info_of
from .shots import Picture, chosen_messages, damage_of, opened, take_shots, title_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.files.paths import PathText
    from pc2scan.messages.laserscan import LaserScan
    from pc2scan.model import RawMessage
    from pc2scan.parsing import Warn
    from pc2scan.request.spec import Request
    from pc2scan.transforms.buffer import TransformBuffer

    from .check import Check
    from .shots import PictureSource, Shot

#: Clouds and scans of a topic on one page. They share its size.
_MOST_CLOUDS = 1_000

#: The first bytes of every page; a file that begins like this may be replaced by another page.
_BEGINNING = b"<!doctype html>\n<!-- pc2scan view -->\n"

_IMPORT = re.compile(r'^import (?P<names>\{[^}]*\}) from "\./(?P<module>\w+)\.mjs";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|const|let|class) (?P<name>\w+))", re.MULTILINE)

#: The level of compression; higher ones take longer and gain almost nothing for measured values.
_LEVEL = 6

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

#: The pose of a scan that is shown in its own frame.
_HERE = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]

_FOLDER = files("pc2scan.show") / "page"


@dataclass(frozen=True, slots=True, repr=False)
class Page(Picture):
    """A page. Notebooks show it in their cell.

    Attributes
    ----------
    pieces
        The HTML file, in pieces.
    """

    kind: ClassVar[str] = "page"

    pieces: tuple[bytes, ...] = ()

    @property
    def html(self) -> str:
        """The whole HTML file."""
        return b"".join(self.pieces).decode()

    def _repr_html_(self) -> str:
        """Return the page in a sandboxed frame with its own policy, so that it cannot access the notebook."""
        frame = 'sandbox="allow-scripts" style="width: 100%; height: 860px; border: 0"'
        return f'<iframe {frame} srcdoc="{escape(self.html)}"></iframe>'

    def save(self, destination: str | Path, *, overwrite: bool = False) -> Path:
        """Write the page; an older page of this name is replaced, any other file only with ``overwrite``.

        Raises
        ------
        UsageError
            If the name is not that of a page.
        DestinationError
            If another file exists.
        OutputError
            If it cannot be written.
        """
        path = path_of("destination", destination)
        _check_name(path)
        with files_output([path], beginning=_BEGINNING, overwrite=overwrite) as deliver:
            deliver([self.pieces])
        return path


def page_of(sources: Sequence[Path], options: Options) -> Page:
    """Show a recording as a page that is not written; see `pc2scan.view`."""
    return _page(sources, first_output(conversion_of(options), "shown", None), options, None)


def view(sources: Sequence[Path], destination: PathText | None, options: Options, *, warn: Warn | None = None) -> Page:
    """Write a page that shows a recording, by default beside it."""
    # "." and ".." are resolved, because the page has the name of the folder.
    source = sources[0] if sources[0].name.strip(".") else sources[0].resolve()
    name = source.stem if source.is_file() else source.name
    path = source.with_name(f"{name}_view.html") if destination is None else path_or_url(destination)
    _check_name(path)
    request = first_output(conversion_of(options, warn), "shown", warn)
    refuse_overlap(inputs_of(sources, options.tf_from, request.files), [path])
    with files_output([path], beginning=_BEGINNING, overwrite=options.overwrite) as deliver:
        page = _page(sources, request, options, warn)
        deliver([page.pieces])
    return replace(page, path=str(path))


def _page(sources: Sequence[Path], request: Request, options: Options, warn: Warn | None) -> Page:
    """Make a page of a recording: of its clouds and their projection, or of its scans if it has no clouds."""
    with opened(sources, request, options, warn, _MOST_CLOUDS) as recording:
        has_clouds = bool(of_types(recording.reader.connections, CLOUDS))
        describe = _clouds_page if has_clouds and not request.scan.reverse else _scans_page
        blobs: dict[str, bytes] = {}
        description, damage = describe(recording, blobs)
        notes, warnings = description["notes"], [*request.notes, *description.pop("warnings")]
        # The page shows both.
        description["notes"] = [*notes, *warnings]
        description |= {"title": title_of(sources), "subtitle": _subtitle(recording.reader)}
        pieces = html(description, blobs)
        return Page("", sum(map(len, pieces)), tuple(notes), tuple(warnings), damage, pieces)


def _subtitle(reader: Reader) -> str:
    summary = reader.summary
    if summary.start_ns is None or summary.end_ns is None:
        return ""
    return f"{moment_text(summary.start_ns)}, {(summary.end_ns - summary.start_ns) / 1e9:.1f} s"


def _check_name(path: Path) -> None:
    """Raise if browsers would not open a file of this name as a page.

    Raises
    ------
    UsageError
        If the suffix is not that of HTML.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise UsageError("is not the name of a page", path=path, hint="pages are *.html; pc2scan plot draws figures")


def html(description: Mapping[str, Any], blobs: dict[str, bytes]) -> tuple[bytes, ...]:
    """Return the page, in pieces: as one text, it would be in memory twice.

    Parameters
    ----------
    description
        The data that `page/main.mjs` reads as JSON.
    blobs
        Binary data by the ids that the description uses; emptied, because they take as much memory as the page.
    """
    code, css = script(), style()
    own = f"script-src {_digest(code)}; style-src {_digest(css)}"
    policy = f"default-src 'none'; {own}; img-src data:; base-uri 'none'; form-action 'none'"
    parts = {
        'content="policy"': [f'content="{policy}"'],
        "<!-- style -->": [f"<style>{css}</style>"],
        "<!-- script -->": [f"<script>{code}</script>"],
        "<!-- data -->": _data(description, blobs),
    }
    pieces = re.split(f"({'|'.join(map(re.escape, parts))})", (_FOLDER / "index.html").read_text("utf-8"))
    return tuple(text.encode() for piece in pieces for text in parts.get(piece, [piece]))


def script() -> str:
    """Return the modules of the page as one script."""
    modules: dict[str, str] = {}
    _collect("main", modules)
    return '"use strict";\n' + "".join(modules.values())


def style() -> str:
    """Return the style sheet of the page."""
    return (_FOLDER / "style.css").read_text("utf-8")


def _collect(name: str, modules: dict[str, str]) -> None:
    """Add a module after those that it imports."""
    if name in modules:
        return
    text = (_FOLDER / f"{name}.mjs").read_text("utf-8")
    for match in _IMPORT.finditer(text):
        _collect(match["module"], modules)
    exports = ", ".join(match["name"] for match in _EXPORT.finditer(text))
    body = _EXPORT.sub("", _IMPORT.sub(r"const \g<names> = module_\g<module>;", text))
    modules[name] = f"const module_{name} = (() => {{\n{body}return {{ {exports} }};\n}})();\n"


def _data(description: Mapping[str, Any], blobs: dict[str, bytes]) -> Iterator[str]:
    # Browsers obey marks of direction.
    safe = json_value(description, partial(visible, most=None))
    text = json.dumps(safe, allow_nan=False, ensure_ascii=True).replace("<", "\\u003c")
    yield f'<script type="application/json" id="recording">{text}</script>'
    for name in list(blobs):
        yield f'\n<script type="text/plain" id="{name}">{base64.b64encode(blobs.pop(name)).decode()}</script>'


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def compressed(blobs: dict[str, bytes], columns: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Add compressed arrays of one length to the blobs of a page, and return its description of them.

    The first bytes of all values of a field come first, then their second bytes, and so on. Exponents and leading
    digits are similar, so measured floats compress a quarter better like this.
    """
    name, compressor = f"data-{len(blobs)}", zlib.compressobj(_LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
    parts = []
    for column in columns.values():
        values = np.ascontiguousarray(column, column.dtype.newbyteorder("<"))
        parts.append(compressor.compress(values.view(np.uint8).reshape(-1, values.itemsize).T.tobytes()))
    blobs[name] = b"".join((*parts, compressor.flush()))
    fields = [{"name": field, "type": column.dtype.str[1:]} for field, column in columns.items()]
    return {"id": name, "length": len(next(iter(columns.values()))), "fields": fields}


def _clouds_page(recording: PictureSource, blobs: dict[str, bytes]) -> tuple[dict[str, Any], tuple[Damage, ...]]:
    """Describe a page of clouds, which opens with the heights that info proposes if none are given."""
    options = recording.options
    # The node's heights are part of its parameters, also where a file of these does not have them.
    is_given = bool(options.given.keys() & {"params", "params_file", "param", "scans"})
    request = recording.request if is_given else _as_proposed(recording)
    scan, preset = request.scan, options.preset or ""
    topics: dict[str, list[dict[str, Any]]] = {}
    count = max(1, len({cloud.topic for cloud in of_types(recording.reader.connections, CLOUDS)}))
    most = _MOST_POINTS // (count * (len(options.at) or options.clouds))
    taken = take_shots(recording._replace(request=request), level=False, keep=partial(_packed, blobs, max(1, most)))
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
    if request is not recording.request:
        params = scan.params
        where = f"in frame {params.target_frame!r}" if params.target_frame else "in the frame of the clouds"
        heights = f"{params.min_height:g} to {params.max_height:g} m {where}"
        told.insert(0, f"The page opens with the heights that pc2scan info proposes: {heights}.")
    call = Call("convert", tuple(map(str, recording.sources)), _command_options(options, request))
    description = {
        "kind": "clouds",
        "notes": told,
        "warnings": taken.warnings,
        "params": _shown(taken.params),
        "base": _shown(ProjectionParams(**PRESETS.get(preset, {}))),  # type: ignore[arg-type]
        "defaults": _shown(ProjectionParams()),
        "presets": {name: {k: v for k, v in values.items() if k in _SHOWN} for name, values in PRESETS.items()},
        "preset": preset,
        "parameters": {
            name: {"help": PARAMETERS[name].help.replace("`", ""), "choices": _choices(PARAMETERS[name].value.words)}
            for name in _SHOWN
        },
        "command": call_words(call),
        "targetFrame": scan.params.target_frame,
        "topics": [{"topic": topic, "clouds": clouds} for topic, clouds in topics.items()],
    }
    return description, taken.damage


def _as_proposed(recording: PictureSource) -> Request:
    """Return the conversion with the frame and the heights that info proposes first.

    It is as it was if heights are given, or if nothing can be proposed in the given frame.
    """
    request, defaults = recording.request, ProjectionParams()
    params = request.scan.params
    if (params.min_height, params.max_height) != (defaults.min_height, defaults.max_height):
        return request
    try:
        # Heights are of the first clouds, however many are sampled.
        topics = [topic.source for topic in request.scan.topics]
        given = Options("info", {"topics": topics, "target_frame": params.target_frame})
        calls = [call.options for call in info_of([recording.reader], given, request.frames, samples=1).proposals]
        calls = [call for call in calls if "cloud_scale" not in call]
        first = next((call for call in calls if params.target_frame in ("", call.get("target_frame", ""))), {})
        if "min_height" not in first:
            return request
        static = first.get("static_tf", ())
        added = added_transforms((static,) if isinstance(static, str) else static)
    except Pc2ScanError:
        # What is wrong may matter for the page, too, which says so then.
        return request
    chosen = {name: first[name] for name in ("target_frame", "min_height", "max_height") if name in first}
    frames = replace(request.frames, static=(*request.frames.static, *added))
    return replace(request.with_scan(params=replace(params, **chosen)), frames=frames)


def _choices(words: Sequence[str]) -> list[str]:
    """Return the words that a parameter may be, with some of ``kth=N``."""
    return [word.replace("N", number) for word in words for number in ("23" if word == "kth=N" else "N")]


def _command_options(options: Options, request: Request) -> dict[str, Any]:
    """Return the options that convert the same points of the same topics in the same frames.

    Parameters of the projection are not included, because the page adds them.
    """
    given = {name: value for name, value in options.given.items() if name not in _OF_PAGES}
    for name in ("start", "end"):
        if (bound := getattr(options, name)) is not None:
            given[name] = f"{'@' if bound.absolute else ''}{stamp_text(bound.nanoseconds)}"
    # A scans file names its topics.
    topics = () if "scans" in given else request.scan.topics
    given = {
        "destination": "scans.mcap",
        **given,
        "topics": tuple(topic.source + (f":={topic.target}" if topic.target else "") for topic in topics),
        "static_tf": tuple(
            f"{transform.parent} {transform.child} {' '.join(map(repr, transform.parent_from_child.pose))}"
            for transform in request.frames.static
        ),
    }
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
    """Return the parameters that the page has."""
    values = {name: getattr(params, name) for name in _SHOWN}
    return values | {"beams": 0 if params.beams == "auto" else params.beams}


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
        place = buffer.known(target, name, stamp_ns)
        if place is None or name.removeprefix("/") == target.removeprefix("/"):
            continue
        x, y, z = place.translation.tolist()
        if math.isfinite(x + y + z):
            yield {"name": name, "x": x, "y": y, "z": z}


def _scans_page(recording: PictureSource, blobs: dict[str, bytes]) -> tuple[dict[str, Any], tuple[Damage, ...]]:
    """Describe a page of scans: the moments of the first topic, each with the next scan of every other topic.

    Scans are shown in the target frame or, without one, in the first topic's frame, as far as transforms connect them.

    Raises
    ------
    RecordingError
        If no scan can be shown.
    """
    reader, request, options = recording.reader, recording.request, recording.options
    names = [topic.source for topic in request.scan.topics]
    topics = scan_connections(reader, names)
    transforms, others = corrected_transforms(reader, request, recording.stack, ())
    if request.clock:
        own = [connection for connections in topics.values() for connection in connections]
        reader, _ = corrected(reader, own, request.clock, request.frames.tf_topics)
    taken: dict[str, list[RawMessage]] = {topic: [] for topic in topics}
    for message in chosen_messages(recording._replace(reader=reader), topics):
        taken[message.connection.topic].append(message)
    moments = []
    failed: list[str] = []
    for together in zip_longest(*taken.values()):
        layers: list[dict[str, Any]] = []
        moment, common = "", request.scan.params.target_frame
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
            pose = _pose(transforms.buffer, common, scan.frame_id, scan.stamp_ns)
            where = scan.frame_id if pose is not None else f"{scan.frame_id}, not connected to {common}"
            moment = moment or moment_text(scan.stamp_ns or message.log_time_ns)
            layers.append(_layer(f"{topic} ({where})", number, scan, blobs, pose or _HERE))
        if layers:
            moments.append({"moment": moment, "frame": common, "layers": layers})
    if not moments:
        why = f"no scan can be shown; {failed[0]}" if failed else f"no scans on {', '.join(topics)}"
        raise RecordingError(why, path=reader.path)
    warnings = [f"Not shown: {counted(len(failed), 'scan')}; {failed[0]}."] if failed else []
    checked = check(recording.sources, Options("check", {**options.among(options_of("check")), "topics": names}))
    description = {"kind": "scans", "notes": [], "warnings": warnings, "moments": moments}
    return description | {"findings": list(_findings(checked))}, damage_of(reader, *others)


def _pose(buffer: TransformBuffer, target: str, source: str, stamp_ns: int) -> list[float] | None:
    """Return the 2 x 3 matrix that maps x, y and 1 in the scan's frame to x and y in another frame, row by row.

    None if there is no transform.
    """
    rigid = Rigid.identity() if target == source else buffer.known(target, source, stamp_ns)
    if rigid is None:
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


def _findings(checked: Check) -> Iterator[dict[str, Any]]:
    """Yield the results of `pc2scan check` for each topic."""
    for topic in checked.topics:
        told = [(f"{by.consumer}: {by.outcome}", by.outcome != "accepted") for by in topic.consumers]
        told += [(f"{finding.level}: {finding.text}", finding.level == "defect") for finding in topic.findings]
        lines = [{"text": text, "wrong": is_wrong} for text, is_wrong in told]
        yield {"heading": f"pc2scan check: {topic.topic}", "lines": lines}


def _finite(value: float, largest: float = 0.0) -> float:
    """Replace infinity, which JSON does not have, by the largest float64."""
    if math.isfinite(value):
        return float(value)
    return math.copysign(1.7976931348623157e308, value) if largest and not math.isnan(value) else 0.0

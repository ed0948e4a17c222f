"""Reads the keywords of the public functions into the pipeline's options: parameters, frames, filters, times, paths."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from os import PathLike
from typing import TYPE_CHECKING, NamedTuple, cast

from .arguments import names_in, path_of, path_text, paths_in, refuse_unknown, shown
from .core.params import ProjectionParams
from .errors import SeveralNodesError, UsageError
from .names import did_you_mean
from .pipeline.combine.asked import Combining
from .pipeline.options import ConvertOptions, TimeBound, bound_of, destination_and_folder
from .pipeline.param_sources import ResolvedSources, resolve_sources
from .pipeline.parameters import CALL, PARAMETERS, Setting, refuse_degrees
from .pipeline.scan_spec import ScanSpec, TopicRequest
from .tf.options import FrameOptions, StaticTransform

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from typing import Any

    from .arguments import PathText
    from .core.unproject import UnprojectParams
    from .pipeline.options import Time
    from .pipeline.stages.beams import BeamFilter
    from .pipeline.stages.filters import Filter
    from .streams.stream import Selection

__all__ = [
    "KEYWORDS",
    "Conversion",
    "conversion_names",
    "conversion_of",
    "destination_of",
    "first_output",
    "frames_of",
    "given_among",
    "keywords_among",
    "makes_scans",
    "moments_of",
    "parameter_names",
    "params_from_file",
    "selection_of",
]

_PARAMETERS = ("params", "preset", "params_file", "node", "param", "launch_args", "remap")
_FRAMES = ("frames", "static_tf", "static_tf_file", "write_static_tf", "tf_from", "tf_topics", "source_frame")
_TEXTS_OF_FILTERS = ("where", "exclude_box", "exclude_polygon")
_VALUES_OF_FILTERS = ("ground", "min_height_slope")
_FILTERS = (*_TEXTS_OF_FILTERS, *_VALUES_OF_FILTERS, "filters")
_COMBINING = ("lead", "window", "accumulate", "every", "rebin")
_CHANNELS = ("channels", "range_cutoff")

#: Keywords that are attributes of an output, and of a conversion, without any reading.
_OF_A_SCAN = ("deskew", "fixed_frame", "point_time", "stamp", "level", "imu", "keep_used")
_OF_ALL = ("keep_clouds", "only_scans", "on_error", "ros_distro", "jobs", "verify", "strict", "fail_on", "min_used")

#: Keywords that each output in ``scans`` has itself, so they cannot be given besides. ``param`` applies to all outputs.
_BESIDE = (
    *(name for name in _PARAMETERS if name != "param"),
    *("topics", "reverse", "remove", *_FILTERS, *_COMBINING, *_CHANNELS, *_OF_A_SCAN),
)

#: Defaults other than None, False and empty.
_USUAL = {"stamp": "header", "ground": "keep", "on_error": "skip", "verify": True}

#: The keywords of a conversion besides parameters of the projection.
KEYWORDS = frozenset(("scans", "param", "keep", "drop", "start", "end", *_BESIDE, *_FRAMES, *_OF_ALL))


class Conversion(NamedTuple):
    """The options of a conversion, read and checked.

    Attributes
    ----------
    options
        The options of the pipeline.
    files
        The files that were read for them, by option.
    """

    options: ConvertOptions
    files: Mapping[str, Path]


def keywords_among(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keywords in the ``locals()`` of a function that takes the others as ``**parameters``."""
    keywords = {name: value for name, value in arguments.items() if name in KEYWORDS}
    return keywords | dict(arguments["parameters"])


def conversion_names() -> list[str]:
    """Return the names of all keywords of a conversion, with the parameters of the projection."""
    return [*KEYWORDS, *parameter_names()]


def makes_scans(keywords: Mapping[str, Any]) -> bool:
    """Return whether any parameter of the projection is given: by name, by a preset or in a file."""
    return any(keywords.get(name) for name in ("params", "preset", "params_file", "param")) or any(
        name in keywords for name in PARAMETERS
    )


def first_output(options: ConvertOptions, verb: str, note: Callable[[str], None]) -> ConvertOptions:
    """Return a conversion with the first of its outputs only; ``verb`` says in the note what it is used for."""
    if options.scans[1:]:
        note(f"only the first of {len(options.scans)} outputs is {verb}: {options.scan.name}")
    return options.with_scan()


def given_among(keywords: Mapping[str, Any]) -> list[str]:
    """Return the names of keywords whose values differ from their defaults."""

    def is_usual(name: str, value: object) -> bool:
        if isinstance(value, Sequence) and not isinstance(value, str):
            return not value
        return value is None or value is False or value == _USUAL.get(name, "")

    return [name for name, value in keywords.items() if not is_usual(name, value)]


def conversion_of(
    keywords: Mapping[str, Any],
    origins: Mapping[str, str] | None = None,
    note: Callable[[str], None] = lambda _: None,
) -> Conversion:
    """Read the keywords of a conversion, which come from Python, the command line or a dataset file.

    Parameters
    ----------
    keywords
        `KEYWORDS`, and parameters of the projection by name. Missing ones have the defaults of `pc2scan.convert`.
    origins
        Where parameters come from, for errors and reports. Missing ones were given in Python.
    note
        Called with warnings about files, once for each, also if an error follows.

    Raises
    ------
    UsageError
        If a keyword has a wrong value, or contradicts another one.
    """
    keywords = {**keywords, "filters": _filters_in(keywords.get("filters", ()))}
    preset = keywords.get("preset")
    if not (preset is None or isinstance(preset, str)):
        raise TypeError(f"preset is {shown(preset)}, it must be a str")
    settings = [
        Setting(name, _python_value(value), (origins or {}).get(name, CALL))
        for name, value in keywords.items()
        if name in PARAMETERS
    ]
    if keywords.get("scans") is not None:
        return _several_scans(keywords, settings, note)
    noted: dict[str, None] = {}

    def note_once(text: str) -> None:
        if text not in noted:
            noted[text] = None
            note(text)

    try:
        return _of_node(keywords, settings, keywords.get("node"), note_once)
    except SeveralNodesError as err:
        if keywords.get("reverse") or keywords.get("params_file") is None:
            raise
        from .pipeline.several_nodes import options_of_nodes, refuse_topics  # noqa: PLC0415  # few files have several

        file = path_of("params_file", keywords["params_file"])
        refuse_topics(keywords.get("topics"), err.nodes, file)
        each = [_of_node(keywords, settings, node, note_once, one_of_several=True) for node in err.nodes]
        return Conversion(options_of_nodes(err.nodes, [found.options for found in each], file), each[0].files)


def _several_scans(keywords: Mapping[str, Any], settings: list[Setting], note: Callable[[str], None]) -> Conversion:
    """Read the keywords of a conversion with several outputs; parameters besides ``scans`` apply to all of them."""
    from .pipeline.param_assignment import parse_param  # noqa: PLC0415  # few conversions have several outputs
    from .pipeline.scans_file import load_scans, refuse_beside  # noqa: PLC0415

    refuse_beside([name for name in given_among(keywords) if name in _BESIDE])
    scans = keywords["scans"]
    settings = [*settings, *(parse_param(text) for text in reversed(names_in("param", keywords.get("param"))))]
    found = load_scans(path_of("scans", scans) if isinstance(scans, str | PathLike) else scans, settings)
    _note_ignored(found.ignored, note)
    files = {f"{path.name} (from `scans`)": path for path in found.files}
    return Conversion(_options(keywords, found.specs, _frames(keywords)), _named_files(keywords) | files)


def _of_node(
    keywords: Mapping[str, Any],
    settings: list[Setting],
    node: str | None,
    note: Callable[[str], None],
    *,
    one_of_several: bool = False,
) -> Conversion:
    """Read the keywords of a conversion with one output; a parameter file is read for one of its nodes."""
    resolved = _resolved(keywords, settings, node)
    _note_ignored(resolved.ignored, note)
    frames = _frames(keywords)
    topics, typed = names_in("topics", keywords.get("topics")), list(names_in("remap", keywords.get("remap")))
    if typed and topics:
        raise UsageError(
            "`topics` and `remap` both name the topics; give only one of them", hint="such as `topics=/points:=/scan`"
        )
    if typed or resolved.remaps:
        from .pipeline.remaps import meant_for, remapped  # noqa: PLC0415  # few are given any

        if one_of_several and node is not None:
            typed = meant_for(typed, node)
        typed = [text for text in typed if not text.startswith("__")]
        moved = remapped((*resolved.remaps, *typed), reverse=resolved.reverse)
        topics = topics or moved.topics
        if moved.tf_topics and not frames.tf_topics:
            frames = replace(frames, tf_topics=moved.tf_topics)
    scan = ScanSpec(
        topics=tuple(map(TopicRequest.parse, topics)),
        origins=resolved.origin,
        params=resolved.params,
        reverse=resolved.reverse,
        channels=_channels(keywords.get("channels"), keywords.get("range_cutoff")),
        combining=Combining.of(**{name: keywords[name] for name in _COMBINING if name in keywords}),
        filters=_point_filters(keywords, resolved),
        remove=_beam_filters(keywords.get("remove")),
        **{name: keywords[name] for name in _OF_A_SCAN if name in keywords},
    )
    files = _named_files(keywords) | {f"{path.name} (from `params_file`)": path for path in resolved.files}
    return Conversion(_options(keywords, (scan,), frames), files)


def _note_ignored(places: Iterable[str], note: Callable[[str], None]) -> None:
    for place in places:
        note(f"ignored, because it is not a parameter of the projection: {place}")


def _options(keywords: Mapping[str, Any], scans: tuple[ScanSpec, ...], frames: FrameOptions) -> ConvertOptions:
    return ConvertOptions(
        scans=scans,
        frames=frames,
        keep=names_in("keep", keywords.get("keep")),
        drop=names_in("drop", keywords.get("drop")),
        start=bound_of("start", keywords.get("start")),
        end=bound_of("end", keywords.get("end")),
        **{name: keywords[name] for name in _OF_ALL if name in keywords},
    )


def _named_files(keywords: Mapping[str, Any]) -> dict[str, Path]:
    """Return the files that keywords name and that are read, by keyword."""
    named = {name: keywords.get(name) for name in ("params_file", "static_tf_file", "scans")}
    return {f"`{name}`": path_of(name, path) for name, path in named.items() if isinstance(path, str | PathLike)}


def parameter_names() -> list[str]:
    """Return the names of the parameters of the projection."""
    return [field.name for field in fields(ProjectionParams)]


def _resolved(keywords: Mapping[str, Any], settings: list[Setting], node: str | None) -> ResolvedSources:
    """Find the parameters of the projection, and where each comes from."""
    params, file, reverse = keywords.get("params"), keywords.get("params_file"), keywords.get("reverse", False)
    if params is None:
        return resolve_sources(
            settings,
            assignments=names_in("param", keywords.get("param")),
            file=None if file is None else path_of("params_file", file),
            node=node,
            launch_args=names_in("launch_args", keywords.get("launch_args")),
            preset=keywords.get("preset"),
            reverse=reverse,
        )
    if not isinstance(params, ProjectionParams):
        raise TypeError(f"params is {type(params).__name__}, it must be ProjectionParams")
    others = {"preset": keywords.get("preset"), "params_file": file, "node": node}
    if given := [f"`{name}`" for name, value in others.items() if value is not None]:
        raise UsageError(
            f"params has all parameters, so {' and '.join(given)} would have no effect",
            hint="use ProjectionParams.preset() or ProjectionParams.from_file(), which take changes by name",
        )
    changes: dict[str, Any] = {setting.name: keywords[setting.name] for setting in settings}
    angles = {name: getattr(params, name) for name in ("angle_min", "angle_max", "geometry")}
    refuse_degrees(angles | changes, dict.fromkeys(PARAMETERS, CALL))
    origins = {name: CALL if getattr(params, name) != row.default else "default" for name, row in PARAMETERS.items()}
    return ResolvedSources(replace(params, **changes), origins | dict.fromkeys(changes, CALL), reverse)


def params_from_file(path: PathText, node: str | None, changes: Mapping[str, Any]) -> ProjectionParams:
    """See `pc2scan.ProjectionParams.from_file`."""
    refuse_unknown("ProjectionParams.from_file", changes, parameter_names())
    settings = [Setting(name, _python_value(value), CALL) for name, value in changes.items()]
    resolved = resolve_sources(settings, file=path_of("params_file", path), node=node)
    if resolved.reverse:
        raise UsageError("its parameters are for laserscan_to_pointcloud", path=path)
    return resolved.params


def _python_value(value: object) -> object:
    """Return NumPy's scalars as Python's."""
    return value.item() if hasattr(value, "item") and getattr(value, "ndim", None) == 0 else value


def _frames(keywords: Mapping[str, Any]) -> FrameOptions:
    return frames_of(**{name: keywords[name] for name in _FRAMES if name in keywords})


def frames_of(
    frames: FrameOptions | None = None,
    static_tf: str | StaticTransform | Iterable[str | StaticTransform] = (),
    static_tf_file: PathText | None = None,
    write_static_tf: bool = False,
    tf_from: PathText | Iterable[PathText] = (),
    tf_topics: str | Iterable[str] = (),
    source_frame: str = "",
) -> FrameOptions:
    """Combine the arguments about frames into one object."""
    if frames is not None:
        if static_tf or static_tf_file or write_static_tf or tf_from or tf_topics or source_frame:
            raise UsageError("give frames, or the arguments about frames one by one, not both")
        if not isinstance(frames, FrameOptions):
            raise TypeError(f"frames is {type(frames).__name__}, it must be FrameOptions")
        return frames
    static: list[StaticTransform] = []
    if static_tf_file is not None:
        from .tf.static_file import load_static_transforms  # noqa: PLC0415

        static += load_static_transforms(path_of("static_tf_file", static_tf_file))
    given = (static_tf,) if isinstance(static_tf, str | StaticTransform) else tuple(static_tf)
    for transform in given:
        if not isinstance(transform, str | StaticTransform):
            raise TypeError(f"static_tf has {transform!r}, it must be text, 'parent child x y z roll pitch yaw'")
    static += (StaticTransform.parse(each) if isinstance(each, str) else each for each in given)
    return FrameOptions(
        tf_topics=names_in("tf_topics", tf_topics),
        tf_from=tuple(paths_in("tf_from", tf_from)) if tf_from else (),
        static=tuple(static),
        source_frame=source_frame,
        write_static=write_static_tf,
    )


def destination_of(destination: PathText | None) -> tuple[Path | None, Path | None]:
    """Return the path of the destination, or the folder for it; at least one of them is None."""
    # Read as text, because a Path object has lost a slash at the end, which means a folder.
    return destination_and_folder(None if destination is None else path_text("destination", destination))


def _channels(
    channels: str | Iterable[str] | UnprojectParams | None, range_cutoff: float | None
) -> UnprojectParams | None:
    """Combine the arguments about the fields of clouds into one object."""
    if channels is None and range_cutoff is None:
        return None
    from .core.unproject import UnprojectParams  # noqa: PLC0415

    if isinstance(channels, UnprojectParams):
        return channels if range_cutoff is None else replace(channels, range_cutoff=range_cutoff)
    names = names_in("channels", channels)
    known = ("distances", "stamps", "viewpoint")
    for name in names:
        if name not in known:
            hint = did_you_mean(name, known) or None
            raise UsageError(f"`channels` has {name!r}, its values must be among {', '.join(known)}", hint=hint)
    wanted = {name: name in names for name in known}
    return UnprojectParams(**wanted, range_cutoff=-1.0 if range_cutoff is None else range_cutoff)


def selection_of(
    source: PathText | Iterable[PathText],
    topics: tuple[str, ...],
    start: Time | None,
    end: Time | None,
    on_error: str,
    *,
    verify: bool,
    strict: bool,
) -> Selection:
    """Combine the arguments about which messages are read into one object."""
    from .streams.stream import Selection  # noqa: PLC0415

    return Selection(
        paths=tuple(paths_in("source", source)),
        topics=topics,
        start=bound_of("start", start),
        end=bound_of("end", end),
        on_error=on_error,
        verify=verify,
        strict=strict,
    )


def _point_filters(keywords: Mapping[str, Any], resolved: ResolvedSources) -> tuple[Filter, ...]:
    """Combine the arguments about points into filters."""
    given: dict[str, Any] = {name: texts for name in _TEXTS_OF_FILTERS if (texts := names_in(name, keywords.get(name)))}
    given |= {name: keywords[name] for name in _VALUES_OF_FILTERS if keywords.get(name) is not None}
    further: tuple[Filter, ...] = keywords["filters"]
    if not given or given == {"ground": "keep"}:
        return further
    from .pipeline.stages.filter_options import filters_from  # noqa: PLC0415  # few conversions have filters

    return (*filters_from(given, resolved.params.min_height), *further)


def _filters_in(values: object) -> tuple[Filter, ...]:
    """Return the filters of an argument that takes one or several."""
    several = isinstance(values, Iterable) and not isinstance(values, str | bytes)
    found = tuple(cast("Iterable[Any]", values if several else (values,)))
    for value in found:
        if isinstance(value, type) or not hasattr(value, "explanation"):
            text = "; a condition as text is the argument `where`" if isinstance(value, str) else ""
            raise TypeError(f"filters has {shown(value)}, it must be a filter, such as pc2scan.Where('ring < 8'){text}")
    return found


def _beam_filters(remove: object) -> tuple[BeamFilter, ...]:
    """Read the filters of beams."""
    texts = names_in("remove", remove)
    if not texts:
        return ()
    from .pipeline.stages.beams import beam_filter  # noqa: PLC0415  # few scans are filtered

    return tuple(map(beam_filter, texts))


def moments_of(at: Time | Iterable[Time]) -> list[TimeBound]:
    """Read one time, or several."""
    # A NumPy array without dimensions is one time.
    if isinstance(at, Iterable) and not isinstance(at, str) and getattr(at, "shape", True) != ():
        return [TimeBound.of(time) for time in at]
    return [TimeBound.of(cast("Time", at))]

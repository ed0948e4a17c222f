"""Reads the options of a call into those of the pipeline: parameters, frames, filters, the destination."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

from .arguments import refuse_unknown, value_and_type
from .core.params import ProjectionParams
from .errors import SeveralNodesError, UsageError
from .files.urls import path_of, path_text, paths_in
from .options.call import CALL, Options
from .options.frames import frames_of
from .options.option import POINTS
from .options.table import PARAMETERS, options_of
from .pipeline.combine.options import Combining
from .pipeline.options import ConvertOptions, destination_and_folder
from .pipeline.param_sources import ResolvedSources, resolve_sources
from .pipeline.parameters import Setting, refuse_degrees
from .pipeline.scan_spec import ScanSpec, TopicRequest

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from .core.unproject import UnprojectParams
    from .files.urls import PathText
    from .pipeline.run_files import OutputOptions
    from .pipeline.stages.beams import BeamFilter
    from .pipeline.stages.filters import Filter
    from .streams.stream import Selection
    from .tf.options import FrameOptions

#: Options that are attributes of an output or of a conversion, as they are.
_OF_A_SCAN = ScanSpec.__dataclass_fields__.keys() - {"topics", "params", "channels", "filters", "remove", "reverse"}
_OF_ALL = ConvertOptions.__dataclass_fields__.keys() - {"scans", "frames"}


class ConversionRequest(NamedTuple):
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


def _among(options: Options, names: Iterable[str]) -> dict[str, Any]:
    """Return those of some options that were given."""
    return {name: options.given[name] for name in names if name in options.given}


def first_output(options: ConvertOptions, verb: str, note: Callable[[str], None]) -> ConvertOptions:
    """Return a conversion with the first of its outputs only; ``verb`` says in the note what it is used for."""
    if options.scans[1:]:
        note(f"only the first of {len(options.scans)} outputs is {verb}: {options.scan.name}")
    return options.with_scan()


def conversion_of(options: Options, note: Callable[[str], None] = lambda _: None) -> ConversionRequest:
    """Read the options of a conversion.

    Parameters
    ----------
    options
        Missing ones have the defaults of `pc2scan.convert`.
    note
        Called with warnings about files, once for each, also if an error follows.

    Raises
    ------
    UsageError
        If an option has a wrong value, or contradicts another one.
    """
    filters = _filters_in(options.filters)
    settings = [Setting(name, value, options.origin(name)) for name, value in options.parameters.items()]
    if options.scans is not None:
        return _several_scans(options, settings, note)
    noted: dict[str, None] = {}

    def note_once(text: str) -> None:
        if text not in noted:
            noted[text] = None
            note(text)

    try:
        return _of_node(options, settings, options.node, filters, note_once)
    except SeveralNodesError as err:
        if options.reverse or options.params_file is None:
            raise
        from .pipeline.nodes import options_of_nodes, refuse_topics  # noqa: PLC0415  # few files have several

        file = options.params_file
        refuse_topics(options.topics, err.nodes, file)
        each = [_of_node(options, settings, node, filters, note_once, one_of_several=True) for node in err.nodes]
        return ConversionRequest(options_of_nodes(err.nodes, [found.options for found in each], file), each[0].files)


def _several_scans(options: Options, settings: list[Setting], note: Callable[[str], None]) -> ConversionRequest:
    """Read the options of a conversion with several outputs; parameters besides ``scans`` apply to all of them."""
    from .pipeline.scans_file import load_scans, refuse_beside  # noqa: PLC0415
    from .pipeline.yaml_nodes import parse_param  # noqa: PLC0415  # few conversions have several outputs

    refuse_beside(options.of_one_output)
    settings = [*settings, *(parse_param(text) for text in reversed(options.param))]
    found = load_scans(options.scans, settings)
    _note_ignored(found.ignored, note)
    files = {f"{path.name} (from `scans`)": path for path in found.files}
    return ConversionRequest(_options(options, found.specs, frames_of(options)), named_files(options) | files)


def _of_node(
    options: Options,
    settings: list[Setting],
    node: str | None,
    filters: tuple[Filter, ...],
    note: Callable[[str], None],
    *,
    one_of_several: bool = False,
) -> ConversionRequest:
    """Read the options of a conversion with one output; a parameter file is read for one of its nodes."""
    resolved = _resolved(options, settings, node)
    _note_ignored(resolved.ignored, note)
    frames = frames_of(options)
    topics, typed = options.topics, list(options.remap)
    if typed and topics:
        raise UsageError(
            "`topics` and `remap` both name the topics; give only one of them", hint="such as `topics=/points:=/scan`"
        )
    if typed or resolved.remaps:
        from .pipeline.nodes import read_remaps, remaps_of_node  # noqa: PLC0415  # few are given any

        if one_of_several and node is not None:
            typed = remaps_of_node(typed, node)
        typed = [text for text in typed if not text.startswith("__")]
        moved = read_remaps((*resolved.remaps, *typed), reverse=resolved.reverse)
        topics = topics or moved.topics
        if moved.tf_topics and not frames.tf_topics:
            frames = replace(frames, tf_topics=moved.tf_topics)
    scan = ScanSpec(
        topics=tuple(map(TopicRequest.parse, topics)),
        origins=resolved.origin,
        params=resolved.params,
        reverse=resolved.reverse,
        channels=_channels(options.channels, options.range_cutoff),
        combining=Combining.of(**options.given),
        filters=(*_point_filters(options, resolved), *filters),
        remove=_beam_filters(options.remove),
        **_among(options, _OF_A_SCAN),
    )
    files = named_files(options) | {f"{path.name} (from `params_file`)": path for path in resolved.files}
    return ConversionRequest(_options(options, (scan,), frames), files)


def _note_ignored(places: Iterable[str], note: Callable[[str], None]) -> None:
    for place in places:
        note(f"ignored, because it is not a parameter of the projection: {place}")


def _options(options: Options, scans: tuple[ScanSpec, ...], frames: FrameOptions) -> ConvertOptions:
    return ConvertOptions(scans=scans, frames=frames, **_among(options, _OF_ALL))


def named_files(options: Options) -> dict[str, Path]:
    """Return the files that options name and that are read, by option."""
    named = {name: getattr(options, name) for name in ("params_file", "static_tf_file", "scans")}
    return {f"`{name}`": path for name, path in named.items() if isinstance(path, Path)}


def _resolved(options: Options, settings: list[Setting], node: str | None) -> ResolvedSources:
    """Find the parameters of the projection, and where each comes from."""
    params, reverse = options.params, options.reverse
    if params is None:
        return resolve_sources(
            settings,
            assignments=options.param,
            file=options.params_file,
            node=node,
            launch_args=options.launch_args,
            preset=options.preset,
            reverse=reverse,
        )
    if not isinstance(params, ProjectionParams):
        raise TypeError(f"params is {type(params).__name__}, it must be ProjectionParams")
    if given := [f"`{name}`" for name in ("preset", "params_file", "node") if name in options.given]:
        raise UsageError(
            f"params has all parameters, so {' and '.join(given)} would have no effect",
            hint="use ProjectionParams.preset() or ProjectionParams.from_file(), which take changes by name",
        )
    changes: dict[str, Any] = options.parameters
    angles = {name: getattr(params, name) for name in ("angle_min", "angle_max", "geometry")}
    refuse_degrees(angles | changes, dict.fromkeys(PARAMETERS, CALL))
    origins = {name: CALL if getattr(params, name) != row.default else "default" for name, row in PARAMETERS.items()}
    return ResolvedSources(replace(params, **changes), origins | dict.fromkeys(changes, CALL), reverse)


def params_from_file(path: PathText, node: str | None, changes: Mapping[str, Any]) -> ProjectionParams:
    """See `pc2scan.ProjectionParams.from_file`."""
    refuse_unknown("ProjectionParams.from_file", changes, PARAMETERS)
    settings = [Setting(name, value, CALL) for name, value in Options("convert", changes).parameters.items()]
    resolved = resolve_sources(settings, file=path_of("params_file", path), node=node)
    if resolved.reverse:
        raise UsageError("its parameters are for laserscan_to_pointcloud", path=path)
    return resolved.params


def output_of(options: Options, *, folder: Path | None = None, like_source: bool = False) -> OutputOptions:
    """Return the options of the destination."""
    from .pipeline.run_files import OutputOptions  # noqa: PLC0415  # with the rest of the pipeline, which is slow to load

    cut = None
    if options.split is not None or options.repeat_latched:
        from .pipeline.split import cut_of  # noqa: PLC0415  # most recordings are one file

        cut = cut_of(options.split, repeat_latched=options.repeat_latched)
    return OutputOptions(cut=cut, folder=folder, like_source=like_source, **_among(options, OutputOptions._fields))


def destination_of(destination: PathText | None) -> tuple[Path | None, Path | None]:
    """Return the path of the destination, or the folder for it; at least one of them is None."""
    # Read as text, because a Path object has lost a slash at the end, which means a folder.
    return destination_and_folder(None if destination is None else path_text("destination", destination))


def _channels(channels: tuple[str, ...] | UnprojectParams, range_cutoff: float | None) -> UnprojectParams | None:
    """Combine the options about the fields of clouds into one object."""
    if channels == () and range_cutoff is None:
        return None
    from .core.unproject import UnprojectParams  # noqa: PLC0415

    if isinstance(channels, UnprojectParams):
        return channels if range_cutoff is None else replace(channels, range_cutoff=range_cutoff)
    wanted = {name: name in channels for name in ("distances", "stamps", "viewpoint")}
    return UnprojectParams(**wanted, range_cutoff=-1.0 if range_cutoff is None else range_cutoff)


def selection_of(sources: PathText | Iterable[PathText], topics: tuple[str, ...], options: Options) -> Selection:
    """Return which messages are read, as one object."""
    from .streams.stream import Selection  # noqa: PLC0415

    return Selection(
        paths=tuple(paths_in("source", sources)),
        topics=topics,
        start=options.start,
        end=options.end,
        on_error=options.on_error,
        verify=options.verify,
        strict=options.strict,
    )


def _point_filters(options: Options, resolved: ResolvedSources) -> Iterable[Filter]:
    """Return the filters that options ask for."""
    known = options_of("convert")
    if not any(known[name].panel is POINTS for name in options.given if name in known):
        return ()
    from .pipeline.stages.filter_options import filters_from  # noqa: PLC0415  # few conversions have filters

    return filters_from(options.given, resolved.params.min_height)


def _filters_in(values: object) -> tuple[Filter, ...]:
    """Return the filters of an argument that takes one or several."""
    if values is None:
        return ()
    several = isinstance(values, Iterable) and not isinstance(values, str | bytes)
    found = tuple(cast("Iterable[Any]", values if several else (values,)))
    for value in found:
        if isinstance(value, type) or not hasattr(value, "explanation"):
            text = "; a condition as text is the argument `where`" if isinstance(value, str) else ""
            raise TypeError(
                f"filters has {value_and_type(value)}, it must be a filter, such as pc2scan.Where('ring < 8'){text}"
            )
    return found


def _beam_filters(texts: Sequence[str]) -> tuple[BeamFilter, ...]:
    """Read the filters of beams."""
    if not texts:
        return ()
    from .pipeline.stages.beams import beam_filter  # noqa: PLC0415  # few scans are filtered

    return tuple(map(beam_filter, texts))

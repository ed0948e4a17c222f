"""What Python users ask for, as the pipeline takes it: parameters, frames, filters, times and places."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, cast

from .arguments import names_in, path_of, path_text, paths_in, refuse_unknown
from .core.params import ProjectionParams
from .errors import UsageError
from .names import did_you_mean
from .pipeline.options import ConvertOptions, TimeBound, destination_and_folder
from .tf.options import FrameOptions, StaticTransform

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from .arguments import PathText
    from .core.unproject import UnprojectParams
    from .pipeline.options import Time
    from .pipeline.param_sources import ResolvedSources
    from .pipeline.scans_file import ScansFile
    from .pipeline.stages.beams import BeamFilter
    from .pipeline.stages.filters import Filter
    from .streams.stream import Selection

__all__ = [
    "channels_of",
    "destination_of",
    "filters_of",
    "frames_of",
    "moments_of",
    "parameter_names",
    "params_from_file",
    "resolved_parameters",
    "scans_of",
    "selection_of",
]


def parameter_names() -> list[str]:
    """Return the names of the parameters of the projection."""
    return [field.name for field in fields(ProjectionParams)]


def resolved_parameters(
    params: ProjectionParams | None,
    preset: str | None,
    params_file: PathText | None,
    node: str | None,
    parameters: Mapping[str, Any],
    *,
    reverse: bool = False,
) -> ResolvedSources:
    """Find the parameters of the projection, and where each comes from."""
    from .pipeline.param_sources import ResolvedSources, resolve_sources  # noqa: PLC0415
    from .pipeline.parameters import CALL, PARAMETERS, Setting, refuse_degrees  # noqa: PLC0415

    if params is None:
        settings = [Setting(name, _plain(value), CALL) for name, value in parameters.items()]
        file = None if params_file is None else path_of("params_file", params_file)
        return resolve_sources(settings, file=file, node=node, preset=preset, reverse=reverse)
    if not isinstance(params, ProjectionParams):
        raise TypeError(f"params is {type(params).__name__}, it must be ProjectionParams")
    others = {"preset": preset, "params_file": params_file, "node": node}
    if given := [f"`{name}`" for name, value in others.items() if value is not None]:
        raise UsageError(
            f"params has all parameters, {' and '.join(given)} cannot count",
            hint="ProjectionParams.preset() and ProjectionParams.from_file() take changes by name",
        )
    angles = {name: getattr(params, name) for name in ("angle_min", "angle_max", "geometry")}
    refuse_degrees(angles | dict(parameters), dict.fromkeys(PARAMETERS, CALL))
    origins = {name: CALL if getattr(params, name) != row.default else "default" for name, row in PARAMETERS.items()}
    return ResolvedSources(replace(params, **parameters), origins | dict.fromkeys(parameters, CALL), reverse)


def scans_of(
    scans: PathText | Mapping[str, Any] | Sequence[Any], parameters: Mapping[str, Any], others: Mapping[str, object]
) -> ScansFile:
    """Read several outputs.

    Parameters
    ----------
    parameters
        Of the projection; they beat those of the outputs.
    others
        What cannot be given too, by name.
    """
    from .pipeline.parameters import CALL, Setting  # noqa: PLC0415
    from .pipeline.scans_file import load_scans, refuse_beside  # noqa: PLC0415

    refuse_beside(others)
    settings = [Setting(name, _plain(value), CALL) for name, value in parameters.items()]
    if isinstance(scans, Mapping) or (isinstance(scans, Sequence) and not isinstance(scans, str)):
        return load_scans(scans, settings)
    return load_scans(path_of("scans", scans), settings)


def params_from_file(path: PathText, node: str | None, changes: Mapping[str, Any]) -> ProjectionParams:
    """See `pc2scan.ProjectionParams.from_file`."""
    refuse_unknown("ProjectionParams.from_file", changes, parameter_names())
    resolved = resolved_parameters(None, None, path, node, changes)
    if resolved.reverse:
        raise UsageError("its parameters are for laserscan_to_pointcloud", path=path)
    return resolved.params


def _plain(value: object) -> object:
    """Return NumPy's scalars as Python's."""
    return value.item() if hasattr(value, "item") and getattr(value, "ndim", None) == 0 else value


def frames_of(
    frames: FrameOptions | None,
    static_tf: str | StaticTransform | Iterable[str | StaticTransform] = (),
    static_tf_file: PathText | None = None,
    write_static_tf: bool = False,
    tf_from: PathText | Iterable[PathText] = (),
    tf_topics: str | Iterable[str] = (),
    source_frame: str = "",
) -> FrameOptions:
    """Gather what is asked for about frames."""
    if frames is not None:
        if static_tf or static_tf_file or write_static_tf or tf_from or tf_topics or source_frame:
            raise UsageError("frames has all that is asked for about frames; give that, or the arguments one by one")
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
    """Return where to write to, or into which folder."""
    # As text: a path that is an object has lost its slash.
    return destination_and_folder(None if destination is None else path_text("destination", destination))


def channels_of(
    channels: str | Iterable[str] | UnprojectParams | None, range_cutoff: float | None
) -> UnprojectParams | None:
    """Gather which fields clouds are to have."""
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
            raise UsageError(f"`channels` has {name!r}, it must be of {', '.join(known)}", hint=hint)
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
    """Gather which messages are read."""
    from .streams.stream import Selection  # noqa: PLC0415

    cut = ConvertOptions.of(start=start, end=end)
    return Selection(
        paths=tuple(paths_in("source", source)),
        topics=topics,
        start=cut.start,
        end=cut.end,
        on_error=on_error,
        verify=verify,
        strict=strict,
    )


def filters_of(
    resolved: ResolvedSources,
    where: str | Iterable[str],
    exclude_box: str | Iterable[str],
    exclude_polygon: str | Iterable[str],
    min_height_slope: float | None,
    ground: str,
    filters: Iterable[Filter],
) -> tuple[Filter, ...]:
    """Gather which points of clouds are used."""
    conditions, boxes, polygons = (
        names_in("where", where),
        names_in("exclude_box", exclude_box),
        names_in("exclude_polygon", exclude_polygon),
    )
    if not (conditions or boxes or polygons or min_height_slope is not None or ground != "keep"):
        return tuple(filters)
    from .pipeline.stages.texts import filters_from  # noqa: PLC0415

    asked = filters_from(conditions, boxes, polygons, min_height_slope, resolved.params.min_height, ground)
    return (*asked, *filters)


def beam_filters_of(remove: str | Iterable[str]) -> tuple[BeamFilter, ...]:
    """Read which beams are removed."""
    texts = names_in("remove", remove)
    if not texts:
        return ()
    from .pipeline.stages.beams import beam_filter  # noqa: PLC0415  # few scans are filtered

    return tuple(map(beam_filter, texts))


def moments_of(at: Time | Iterable[Time]) -> list[TimeBound]:
    """Read one moment, or several."""
    # An array of no dimensions is one moment.
    if isinstance(at, Iterable) and not isinstance(at, str) and getattr(at, "shape", True) != ():
        return [TimeBound.of(time) for time in at]
    return [TimeBound.of(cast("Time", at))]

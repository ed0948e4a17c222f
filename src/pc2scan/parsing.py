"""Makes a `Request` of the options of a call: parameters, frames, filters; and reads the destination."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .arguments import refuse_unknown
from .errors import UsageError, name_list
from .files.paths import path_or_url, path_text
from .options.call import Options
from .options.effects import refuse_idle
from .options.processing import ConversionFrames
from .options.table import PARAMETERS, options_about_scans
from .request.scans_file import load_scans, parse_params, read_output
from .request.spec import TRAJECTORY, Request, ScanSpec, StampOptions, TopicRequest
from .result import tell_early
from .transforms.placing import FrameOptions
from .transforms.sources import PoseTopic, frames_of_trajectory, load_trajectory
from .transforms.static import added_transforms, model_in_file

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any, TypeAlias

    from .core.params import ProjectionParams
    from .files.paths import PathText

    Warn: TypeAlias = Callable[[str], None]

#: Options that are attributes of a conversion, as they are.
_OF_ALL = Request.__dataclass_fields__.keys() - {"scans", "frames", "clock", "files", "notes"}

#: The options that are attributes of `FrameOptions`.
OF_FRAMES = {*ConversionFrames.__annotations__, "write_static_tf"}

#: The options that name files which are read.
NAMED_FILES = ("params_file", "static_tf", "trajectory", "urdf", "scans")


def frames_of(options: Options) -> FrameOptions:
    """Return the options about transforms and frames.

    Raises
    ------
    UsageError
        If a transform cannot be read.
    """
    refuse_idle(options.given, options.command)
    if not options.given.keys() & OF_FRAMES:
        return FrameOptions()
    trajectory = None
    if options.trajectory is not None:
        frames = frames_of_trajectory(options.trajectory_frames)
        trajectory, clock = load_trajectory(options.trajectory, frames), clock_of(options)
        trajectory = trajectory if clock is None else trajectory.moved(clock.by_topic.get(TRAJECTORY) or 0)
    return FrameOptions(
        tf_topics=options.tf_topics,
        tf_from=options.tf_from,
        static=added_transforms(options.static_tf),
        odometry=tuple(map(PoseTopic.parse, options.odom_topic)),
        trajectory=trajectory,
        model=None if options.urdf is None else model_in_file(options.urdf),
        source_frame=options.source_frame,
        write_static=options.write_static_tf,
    )


def clock_of(options: Options) -> StampOptions | None:
    """Return how stamps are corrected; None if they are not."""
    if not options.given.keys() & {"stamps", "time_offset"}:
        return None
    clock = StampOptions.of(options.stamps, options.time_offset)
    if TRAJECTORY in clock.by_topic and options.trajectory is None:
        raise UsageError(f"`time_offset={TRAJECTORY}=S` has no effect without `trajectory`")
    return clock


def first_output(request: Request, verb: str, warn: Warn | None) -> Request:
    """Return a conversion with the first of its outputs only; ``verb`` says in a note what it is used for."""
    if not request.scans[1:]:
        return request
    only = f"only the first of {len(request.scans)} outputs is {verb}: {request.scan.name}"
    tell_early([], warn, only)
    return replace(request.with_scan(), notes=(*request.notes, only))


def conversion_of(options: Options, warn: Warn | None = None) -> Request:
    """Read the options of a conversion.

    Parameters
    ----------
    options
        Missing ones have the defaults of `pc2scan.convert`.
    warn
        Called with each of the notes.

    Raises
    ------
    UsageError
        If an option has a wrong value, or contradicts another one.
    """
    if options.clouds_as != "recorded" and not options.keep_clouds:
        _refuse_scans(options)
    given = [options, parse_params(options.param)] if options.param else [options]
    if options.scans is not None:
        refuse_idle(options.given, options.command)
        outputs, where = load_scans(options.scans, given), "scans"
    elif options.remap and options.topics:
        raise UsageError(
            "`topics` and `remap` both name the topics; give only one of them", hint="such as `topics=/points:=/scan`"
        )
    else:
        outputs, where = read_output(options, given), "params_file"
    notes: list[str] = []
    reason = "ignored, because no parameter of the projection is read there"
    tell_early(notes, warn, *(f"{reason}: {place}" for place in outputs.ignored))
    frames = frames_of(options)
    if not frames.tf_topics:
        frames = replace(frames, tf_topics=outputs.tf_topics)
    files = named_files(options) if options.given.keys() & {*NAMED_FILES} else {}
    files |= {f"{path.name} (from `{where}`)": path for path in outputs.files}
    how = {"frames": frames, "clock": clock_of(options), **options.among(_OF_ALL)}
    return Request(scans=outputs.specs, **how, files=files, notes=tuple(notes))


def _refuse_scans(options: Options) -> None:
    """Raise if there are options about scans, and no scans are made."""
    about_scans = options_about_scans()
    if idle := [name for name in options.given if name in about_scans]:
        raise UsageError(
            f"{name_list([f'`{name}`' for name in idle])} would have no effect: `clouds_as` makes no scans",
            hint="`keep` and `drop` choose among topics" if "topics" in idle else "`keep_clouds=True` makes scans, too",
        )


def named_files(options: Options) -> dict[str, Path]:
    """Return the files that options name and that are read, by option."""
    files = {}
    for name in NAMED_FILES:
        value = getattr(options, name)
        for number, path in enumerate(value if isinstance(value, tuple) else (value,)):
            if isinstance(path, Path):
                files[f"`{name}`" + (f" ({number + 1})" if number else "")] = path
    return files


def params_from_file(path: PathText, node: str | None, changes: Mapping[str, Any]) -> ProjectionParams:
    """See `pc2scan.ProjectionParams.from_file`."""
    refuse_unknown("ProjectionParams.from_file", changes, PARAMETERS)
    options = Options("convert", {**changes, "params_file": path, "node": node})
    spec = read_output(options, [options]).specs[0]
    if spec.reverse:
        raise UsageError("its parameters are for laserscan_to_pointcloud", path=path)
    return spec.params


def destination_of(destination: PathText | None) -> tuple[Path | None, Path | None]:
    """Return the path of the destination, or the folder to write into if it ends with a slash or is a dot.

    >>> destination_of("scans/"), destination_of("scans")
    ((None, PosixPath('scans')), (PosixPath('scans'), None))
    """
    if destination is None:
        return None, None
    # As text, because a Path object has lost the slash at the end.
    text = path_text("destination", destination)
    if text.endswith(tuple(filter(None, (os.sep, os.altsep)))) or os.path.basename(text) in {".", ".."}:  # noqa: PTH119
        return None, path_or_url(text)
    return path_or_url(text), None


def reading_of(topics: tuple[str, ...], options: Options) -> Request:
    """Return the options of messages that are read as they are."""
    scan = ScanSpec(topics=tuple(map(TopicRequest, topics)))
    return Request(scans=(scan,), clock=clock_of(options), **options.among(_OF_ALL))

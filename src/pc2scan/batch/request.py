"""What a conversion is asked to do, read from the words of `pc2scan.convert`, and as a digest."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from enum import Enum
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pc2scan.arguments import names_in, path_of
from pc2scan.core.params import ProjectionParams
from pc2scan.errors import SeveralNodesError, UsageError
from pc2scan.json_types import json_value
from pc2scan.names import did_you_mean
from pc2scan.pipeline.combine.asked import Combining
from pc2scan.pipeline.options import ConvertOptions
from pc2scan.pipeline.param_sources import ResolvedSources, resolve_sources
from pc2scan.pipeline.parameters import CALL, Setting
from pc2scan.pipeline.run import OutputOptions
from pc2scan.remote.urls import is_url
from pc2scan.requests import beam_filters_of, channels_of, filters_of, frames_of, parameter_names, resolved_parameters

from .identity import Identity, identity_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.bags.splitting import Cut
    from pc2scan.export.run import ExportOptions
    from pc2scan.pipeline.scans_file import ScansFile

__all__ = ["Request", "request_of", "words_known"]

#: Words that are read here; the others are options of the conversion or of the output, as they are.
_PARAMETERS = ("params", "preset", "params_file", "node", "param", "launch_args", "remap")
_FRAMES = ("frames", "static_tf", "static_tf_file", "write_static_tf", "tf_from", "tf_topics", "source_frame")
_FILTERS = ("where", "exclude_box", "exclude_polygon", "min_height_slope", "ground", "filters")
_COMBINING = ("lead", "window", "accumulate", "every", "rebin")
_CHANNELS = ("channels", "range_cutoff")
_OUTPUT = ("storage", "compression", "profile", "metadata_version", "to", "overwrite")
_SPLIT = ("split", "repeat_latched")
_EXPORT = ("export", "pose_frame", "base_frame", "odom_topic")
_TEXTS = ("topics", "keep", "drop")

#: What an output has of its own where there are ``scans``; see `pc2scan.pipeline.scans_file.refuse_beside`.
_BESIDE = (
    *(
        "topics",
        "remap",
        "preset",
        "params",
        "params_file",
        "node",
        "launch_args",
        "reverse",
        "channels",
        "range_cutoff",
    ),
    *("where", "exclude_box", "exclude_polygon", "min_height_slope", "ground", "filters"),
    *("deskew", "fixed_frame", "point_time", "stamp", "level", "imu"),
    *_COMBINING,
)

#: Options of a conversion that are no words of `pc2scan.convert`, and the number of threads, which `batch` decides.
_NO_WORDS = {"output_type", "repair", "jobs", "origins", "combining"}

#: Attributes of options that do not decide what is written: where they come from.
_PLACES = frozenset({"origins", "place"})


@dataclass(frozen=True, slots=True)
class Request:
    """A conversion, asked for and checked; the recording and its destination are not part of it.

    Attributes
    ----------
    options, output
        As `pc2scan.pipeline.run.run` takes them.
    origins
        Where each parameter comes from.
    files
        The files that were read for it, by option.
    notes
        What the user should know of it.
    export
        How scans or clouds are exported, instead of being written to a recording; None if they are not.
    """

    options: ConvertOptions
    output: OutputOptions
    origins: Mapping[str, str]
    files: Mapping[str, Path]
    notes: tuple[str, ...] = ()
    export: ExportOptions | None = None

    def digest(self) -> str:
        """Return a digest of all that decides what is written: the same for requests that write the same.

        Recordings that transforms are taken from count with their size and time of modification.
        """
        import hashlib  # noqa: PLC0415  # only batches need it
        import json  # noqa: PLC0415

        options = replace(self.options, jobs=0)
        output = {
            name: getattr(self.output, name) for name in ("storage", "compression", "profile", "metadata_version")
        }
        if self.output.cut is not None:
            output["cut"] = asdict(self.output.cut)
        others = [_identity(path).as_json() for path in options.frames.tf_from]
        if self.export is not None:
            output["export"] = _canonical(replace(self.export, overwrite=False))
        whole = json_value({"options": _canonical(options), "output": output, "tf_from": others})
        return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:32]


def _identity(path: Path) -> Identity:
    """Of a recording that transforms are taken from."""
    if not is_url(path):
        return identity_of([path])
    from pc2scan.remote.store import Place  # noqa: PLC0415  # loads fsspec

    place = Place(path)
    files = place.files()
    return Identity(
        tuple((name, *each.stated()) for name, each in ({place.name: place} if files is None else files).items())
    )


def words_known() -> frozenset[str]:
    """Return all words that `request_of` reads."""
    plain = {field.name for field in fields(ConvertOptions)} - {"params", "frames", "filters", "channels"} - _NO_WORDS
    groups = (_PARAMETERS, _FRAMES, _FILTERS, _COMBINING, _CHANNELS, _OUTPUT, _SPLIT, _EXPORT)
    return frozenset(chain(*groups, plain, parameter_names()))


def request_of(words: Mapping[str, Any], origins: Mapping[str, str] | None = None) -> Request:
    """Read the words of `pc2scan.convert`, all of them but those of one run: sources, destination, report, jobs.

    Parameters
    ----------
    words
        Keywords of `pc2scan.convert`, and what only the command line has: ``param``, ``launch_args`` and ``remap``.
    origins
        Where words come from, for errors and reports.

    Raises
    ------
    UsageError
        If a word is not known, has a wrong value, or contradicts another one.
    """
    if unknown := words.keys() - words_known():
        raise UsageError(f"`{min(unknown)}` is not an option of a conversion")
    try:
        return _of_node(words, origins or {})
    except SeveralNodesError as err:
        if words.get("reverse") or words.get("params_file") is None:
            raise
        from pc2scan.pipeline.several_nodes import options_of_nodes, refuse_topics  # noqa: PLC0415  # few files have

        file = path_of("params_file", words["params_file"])
        refuse_topics(words.get("topics"), err.nodes, file)
        each = [_of_node({**words, "node": node}, origins or {}, one_of=err.nodes) for node in err.nodes]
        return replace(
            each[0],
            options=options_of_nodes(err.nodes, [found.options for found in each], file),
            origins={},
            notes=tuple(dict.fromkeys(note for found in each for note in found.notes)),
        )


def _of_node(words: Mapping[str, Any], origins: Mapping[str, str], one_of: tuple[str, ...] = ()) -> Request:
    """Read words that are known, of one node of a parameter file if there is one."""
    given = dict(words)

    def take(names: tuple[str, ...]) -> dict[str, Any]:
        return {name: given.pop(name) for name in names if name in given}

    export = _export(take(_EXPORT), given)
    parameters = take(tuple(parameter_names()))
    several = None
    if (scans := given.pop("scans", None)) is not None:
        beside = {name: words[name] for name in _BESIDE if name in words and words[name] != "header"}
        several = _several(scans, parameters, names_in("param", given.pop("param", ())), beside, origins)
        parameters = {}
    reverse = given.pop("reverse", False)
    asked = take(_PARAMETERS)
    resolved = _parameters(asked, parameters, origins, reverse=reverse)
    framed = take(_FRAMES)
    frames = frames_of(framed.pop("frames", None), **framed)
    # Another process may be in another folder.
    frames = replace(frames, tf_from=tuple(map(_absolute, frames.tf_from)))
    texts: dict[str, Any] = {name: names_in(name, given.pop(name)) for name in _TEXTS if name in given}
    remaps: Sequence[str] = names_in("remap", asked.get("remap"))
    if one_of and remaps:
        from pc2scan.pipeline.remaps import meant_for  # noqa: PLC0415  # few files have several nodes

        remaps = meant_for(list(remaps), words["node"])
    remaps = (*resolved.remaps, *remaps)
    if asked.get("remap") and texts.get("topics"):
        raise UsageError(
            "`topics` and `remap` say the same in two ways; give one of them", hint="`topics=/points:=/scan` is both"
        )
    if remaps:
        from pc2scan.pipeline.remaps import remapped  # noqa: PLC0415  # few are given any

        moved = remapped([text for text in remaps if not text.startswith("__")], reverse=resolved.reverse)
        texts["topics"] = texts.get("topics") or moved.topics
        if moved.tf_topics and not frames.tf_topics:
            frames = replace(frames, tf_topics=moved.tf_topics)
    chosen = take(_FILTERS)
    filters = filters_of(
        resolved,
        chosen.get("where", ()),
        chosen.get("exclude_box", ()),
        chosen.get("exclude_polygon", ()),
        chosen.get("min_height_slope"),
        chosen.get("ground", "keep"),
        chosen.get("filters", ()),
    )
    combining = take(_COMBINING)
    channels = take(_CHANNELS)
    cut = _cut(take(_SPLIT), given.get("to"))
    output = OutputOptions(**take(_OUTPUT), like_source=True, cut=cut)
    options = ConvertOptions.of(
        scans=() if several is None else several.specs,
        origins=resolved.origin,
        params=resolved.params,
        reverse=resolved.reverse,
        channels=channels_of(channels.get("channels"), channels.get("range_cutoff")),
        combining=Combining.of(**combining),
        filters=filters,
        remove=beam_filters_of(given.pop("remove", ())),
        frames=frames,
        **texts,
        **given,
    )
    files = {name: asked.get(name, framed.get(name)) for name in ("params_file", "static_tf_file")}
    return Request(
        options,
        output,
        resolved.origin,
        {f"`{name}`": _absolute(path_of(name, path)) for name, path in files.items() if path is not None}
        | {f"{path.name} (from `params_file`)": _absolute(path) for path in resolved.files}
        | {f"{path.name} (from `scans`)": _absolute(path) for path in (several.files if several is not None else ())},
        tuple(
            f"not a parameter of the projection, ignored: {origin}"
            for origin in (resolved.ignored if several is None else several.ignored)
        ),
        export,
    )


def _export(asked: Mapping[str, Any], others: Mapping[str, Any]) -> ExportOptions | None:
    """Read how messages are exported; ``others`` are all other words."""
    if not asked:
        return None
    name = asked.get("export")
    if name is None:
        raise UsageError(f"`{min(asked)}` goes with `export`", hint="such as `export=npz`")
    if idle := [f"`{word}`" for word in (*_OUTPUT, *_SPLIT) if word != "overwrite" and others.get(word) is not None]:
        raise UsageError(f"{', '.join(idle)} would have no effect: `export` writes no recordings")
    from pc2scan.export.formats import FORMATS  # noqa: PLC0415  # most batches write recordings
    from pc2scan.export.poses import PoseOptions  # noqa: PLC0415
    from pc2scan.export.run import ExportOptions  # noqa: PLC0415

    if name not in FORMATS:
        hint = did_you_mean(name, FORMATS) or None
        raise UsageError(f"`export={name}` is not a format; there are {', '.join(FORMATS)}", hint=hint)
    poses = PoseOptions(**{word: value for word, value in asked.items() if word != "export"})
    if FORMATS[name].needs_poses and not poses.wanted:
        raise UsageError(f"`export={name}` needs poses", hint="give `pose_frame=odom`, or `odom_topic=/odom`")
    making = others.keys() & {*parameter_names(), "params", "preset", "params_file", "param"}
    return ExportOptions(format=name, poses=poses, converting=bool(making))


def _absolute(path: Path) -> Path:
    return path if is_url(path) else Path(os.path.abspath(path))  # noqa: PTH100  # links keep their names


def _cut(asked: Mapping[str, Any], to: object) -> Cut | None:
    """Read where outputs are split; a batch keeps one output for each recording, so that this is a directory."""
    if not asked:
        return None
    from pc2scan.pipeline.parts import cut_of  # noqa: PLC0415  # most outputs are one file

    cut = cut_of(asked.get("split"), repeat_latched=asked.get("repeat_latched", False))
    if cut is not None and to != "rosbag2":
        raise UsageError(
            "`split` of a batch writes rosbag2 directories, each with several files", hint="give `to=rosbag2`"
        )
    return cut


def _several(
    scans: Any,
    parameters: Mapping[str, Any],
    param: Sequence[str],
    beside: Mapping[str, object],
    origins: Mapping[str, str],
) -> ScansFile:
    """Read several outputs; parameters that are given beside them count for all."""
    from pc2scan.pipeline.param_assignment import parse_param  # noqa: PLC0415  # few have several outputs
    from pc2scan.pipeline.scans_file import load_scans, refuse_beside  # noqa: PLC0415

    refuse_beside(beside)
    settings = [*_settings(parameters, origins), *(parse_param(text) for text in reversed(param))]
    is_path = isinstance(scans, str | PathLike)
    return load_scans(path_of("scans", scans) if is_path else scans, settings)


def _settings(parameters: Mapping[str, Any], origins: Mapping[str, str]) -> list[Setting]:
    plain = {name: value.item() if type(value).__module__ == "numpy" else value for name, value in parameters.items()}
    return [Setting(name, value, origins.get(name, CALL)) for name, value in plain.items()]


def _parameters(
    asked: Mapping[str, Any], parameters: Mapping[str, Any], origins: Mapping[str, str], *, reverse: bool
) -> ResolvedSources:
    """Find the parameters of the projection, and where each comes from."""
    if asked.get("params") is not None:
        return resolved_parameters(
            asked["params"],
            asked.get("preset"),
            asked.get("params_file"),
            asked.get("node"),
            parameters,
            reverse=reverse,
        )
    file = asked.get("params_file")
    return resolve_sources(
        _settings(parameters, origins),
        assignments=names_in("param", asked.get("param")),
        file=None if file is None else path_of("params_file", file),
        node=asked.get("node"),
        launch_args=names_in("launch_args", asked.get("launch_args")),
        preset=asked.get("preset"),
        reverse=reverse,
    )


def _canonical(value: Any) -> Any:
    """Return options as JSON's types: equal for equal options, whatever the process."""
    if isinstance(value, ProjectionParams):
        # It decides how much is in flight, not what is written.
        value = replace(value, queue_size=0)
    if is_dataclass(value) and not isinstance(value, type):
        # What a class computes from its attributes is not shown.
        shown = {
            each.name: _canonical(getattr(value, each.name))
            for each in fields(value)
            if each.repr and each.name not in _PLACES
        }
        return {"": type(value).__name__, **shown}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(key): _canonical(part) for key, part in value.items()}
    if isinstance(value, tuple | list | set | frozenset):
        return [_canonical(part) for part in value]
    if hasattr(value, "tolist"):
        return value.tolist()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value) if isinstance(value, Path) else repr(value)

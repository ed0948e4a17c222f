"""Reads the outputs of a conversion from a call, a file (``scans.yaml``) or a dict.

The parameters of an output are collected from every place where a user can give them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.topics import new_topic
from pc2scan.core.params import ProjectionParams
from pc2scan.core.presets import PRESETS
from pc2scan.core.unproject import UnprojectParams
from pc2scan.errors import ParameterError, UsageError
from pc2scan.options.call import Options
from pc2scan.options.effects import refuse_idle
from pc2scan.options.processing import CloudCombination, PointSelection
from pc2scan.options.table import PARAMETERS, output_options
from pc2scan.options.values import texts
from pc2scan.text import did_you_mean
from pc2scan.transforms.attitude import ImuRequest

from .entries import Entry, compose, entries_in, entries_of, naming_place, read_text, scalar_value
from .filters import filters_of
from .params_file import ParamsFile, load_params_file
from .point_time import PointTime
from .precedence import ALIASES, TOPICS, is_every_nodes, resolve, unknown_parameter
from .spec import Combining, ScanSpec, TopicRequest

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

_TOP = ("defaults", "scans")

_EXAMPLE = "write scans: {/scan: {min_height: 0.1}, /scan_low: {max_height: 0.1}}"

#: The nodes' names for the topic that they read and the topic that they write, by whether scans become clouds.
_NAMES = {False: ("cloud_in", "scan"), True: ("scan_in", "cloud")}

#: The topics of transforms, which may be remapped.
_TF = ("tf", "tf_static")

#: Attributes of an output that are options as they are given.
_AS_GIVEN = ScanSpec.__dataclass_fields__.keys() - {"topics", "params", "reverse", "channels", "filters"}


class Outputs(NamedTuple):
    """The outputs of a call.

    Attributes
    ----------
    specs
        The outputs, in order.
    files
        All files that were read.
    ignored
        Places of entries in parameter files that are not parameters of the projection.
    tf_topics
        The topics of transforms that remappings name.
    """

    specs: tuple[ScanSpec, ...]
    files: tuple[Path, ...] = ()
    ignored: tuple[str, ...] = ()
    tf_topics: tuple[str, ...] = ()


def read_output(options: Options, given: Sequence[Options], *, name: str = "", place: str = "") -> Outputs:
    """Read and check one output.

    Parameters
    ----------
    options
        The options of a call, or of an output in a scans file.
    given
        What gives parameters of the projection, the highest precedence first; all override the parameter file, which
        overrides the preset.
    name, place
        See `ScanSpec`; the scans of a named output are on the topic of this name.

    Raises
    ------
    UsageError
        If a parameter, the file or the preset is not valid, or the file is for the other direction.
    """
    sources, remaps = [*given], _remaps_of(options.remap) if options.remap else {}
    names = {key for source in given for key in source.among(PARAMETERS)}
    file = ParamsFile(options)
    if options.params is not None:
        sources.append(_all_params(options))
    if options.params_file is not None:
        file = _read_file(options, names.union(remaps))
        sources.append(file.options)
    if options.preset is not None:
        places = dict.fromkeys(PARAMETERS, f"--preset {options.preset}")
        sources.append(Options("convert", PRESETS[options.preset], places))
    reverse = options.reverse or bool(file.reverse)
    refuse_idle({*options.given, *names, *(["reverse"] * reverse)})
    params, origins = resolve(sources)
    renamed = {**file.remaps, **remaps}
    topics, tf_topics = _moved(renamed, reverse=reverse) if renamed else ((), ())
    requests = tuple(map(TopicRequest.parse, options.topics or topics))
    more = options.among(_AS_GIVEN)
    if name:
        requests = tuple(request._replace(target=name) for request in requests)
    if options.point_time:
        more["point_time"] = PointTime.parse(options.point_time)
    if options.imu:
        more["imu"] = ImuRequest.parse(options.imu)
    if options.keep_used:
        more["keep_used"] = new_topic(options.keep_used, "`keep_used`")
    if isinstance(channels := options.channels, tuple) and channels:
        channels = UnprojectParams(**{name: name in channels for name in ("distances", "stamps", "viewpoint")})
    more["channels"] = channels or None
    if options.given.keys() & CloudCombination.__annotations__.keys():
        more["combining"] = Combining.of(options.given)
    if options.given.keys() & PointSelection.__annotations__.keys():
        more["filters"] = (*filters_of(options.given, params.min_height), *options.given.get("filters", ()))
    spec = ScanSpec(topics=requests, name=name, place=place, params=params, origins=origins, reverse=reverse, **more)
    return Outputs((spec,), file.files, file.ignored, tf_topics)


def _all_params(options: Options) -> Options:
    """Return the parameters of the argument ``params``, without those that have no effect beside others."""
    params = options.params
    if not isinstance(params, ProjectionParams):
        raise TypeError(f"params is {type(params).__name__}, it must be ProjectionParams")
    values = {name: getattr(params, name) for name, row in PARAMETERS.items() if getattr(params, name) != row.default}
    idle = {"angle_increment": params.beams, "use_inf": params.no_return}
    return Options("convert", {name: value for name, value in values.items() if not idle.get(name)})


def _read_file(options: Options, overridden: Collection[str]) -> ParamsFile:
    """Read the parameter file or the launch file of a call, but not what is given elsewhere."""
    arguments = {}
    for text in options.launch_args:
        name, assigned, value = text.partition(":=")
        if not assigned or not name:
            raise UsageError(f"`launch_args`: {text!r} is not an argument", hint="write `launch_args=name:=value`")
        arguments[name] = value
    path, topics = options.params_file, TOPICS if options.topics else ()
    file = load_params_file(path, node=options.node, arguments=arguments, overridden={*overridden, *topics})
    if options.reverse and file.reverse is False:
        raise UsageError(f"{file.node} is for pointcloud_to_laserscan, `reverse=True` is not", path=path)
    return file


def _remaps_of(texts: Sequence[str]) -> dict[str, str]:
    """Read ``cloud_in:=/points``, ``/tf:=/robot/tf``; names of nodes, with two underscores or in front, are ignored."""
    remaps = {}
    for text in texts:
        left, assigned, right = text.partition(":=")
        name, topic = left.rpartition(":")[2].strip().lstrip("~/"), right.strip()
        if not assigned or not name or not topic:
            raise UsageError(f"{text!r} is not a remapping", hint="write cloud_in:=/points or scan:=/scan")
        if not text.startswith("__"):
            remaps[name] = topic
    return remaps


def _moved(remaps: Mapping[str, str], *, reverse: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the topics to convert and the topics of transforms that remappings name.

    A remapping of ``scan`` alone is for the only PointCloud2 topic. If only one of the two topics of transforms is
    remapped, the other one keeps its name.
    """
    source, target = _NAMES[reverse]
    known = (source, target, *_TF)
    for name, topic in remaps.items():
        if name not in known:
            hint = f"{did_you_mean(name, known)} its topics are {', '.join(known)}".strip()
            if name in PARAMETERS:
                hint = f"it is a parameter: `param={name}:={topic}`"
            node = "laserscan_to_pointcloud" if reverse else "pointcloud_to_laserscan"
            raise UsageError(f"'{name}:={topic}': {node} has no topic {name!r}", hint=hint)
    moved = {name: topic if topic.startswith(("/", "~")) else f"/{topic}" for name, topic in remaps.items()}
    topics: tuple[str, ...] = ()
    if moved.keys() & {source, target}:
        topics = (":=".join(filter(None, (moved.get(source, "*"), moved.get(target)))),)
    return topics, tuple(moved.get(name, f"/{name}") for name in _TF) if moved.keys() & {*_TF} else ()


def parse_params(texts: Sequence[str]) -> Options:
    """Read ROS's notation for parameters, ``name:=value``; a later one overrides an earlier one.

    Parameters
    ----------
    texts
        ROS 2's form after ``--ros-args -p``, which may begin with a node's name (``node:name:=value``; the name is
        ignored), or ROS 1's form (``_name:=value``). The value is a YAML
        scalar: ``1``, ``1.0``, ``.inf``, ``true``, ``"text"``; also ROS 1's ``deg(90)`` and
        ``rad(pi/2)``. No text after ``:=`` means the empty text.

    Returns
    -------
    Options
        Without parameters that every node has. Values are not checked here; `resolve` does.

    Raises
    ------
    ParameterError
        If there is no ``:=`` or no parameter of this name, or the value is not a YAML scalar.
    """
    values, origins = dict[str, object](), dict[str, str]()
    for text in texts:
        rule, assigned, written = text.partition(":=")
        name, origin = rule.rpartition(":")[2].strip().lstrip("_~"), f"--param {text}"
        name = ALIASES.get(name, name)
        if not assigned or not name:
            raise ParameterError(f"`param` {text!r} is not NAME:=VALUE", hint="write `param=range_min:=0.5`")
        if is_every_nodes(name):
            continue
        if name not in PARAMETERS:
            raise unknown_parameter(name, origin)
        values[name], origins[name] = _scalar(written, name, origin), origin
    return Options("convert", values, origins)


def _scalar(written: str, name: str, origin: str) -> object:
    if not written.strip():
        return ""
    try:
        node = compose(written, origin)
    except ParameterError as err:
        err.name = name
        raise
    if node is not None and node.id != "scalar":
        return {} if node.id == "mapping" else []
    return None if node is None else scalar_value(node, name, origin, ros1=True)


def load_scans(content: Path | Mapping[str, Any], given: Sequence[Options] = ()) -> Outputs:
    """Read and check outputs.

    Parameters
    ----------
    content
        A YAML or JSON file, or the same as Python objects: a mapping with ``scans`` and optionally ``defaults``.
        ``scans`` is a mapping from topics to outputs. A mapping without these keys is read as ``scans``.
    given
        Parameters of all outputs, which override those of the file; the highest precedence first.

    Returns
    -------
    Outputs
        Checked, except for what depends on the recording.

    Raises
    ------
    UsageError
        If something is not valid; the error has its place.
    """
    if isinstance(content, Path):
        root, folder, files = entries_in(read_text(content, _EXAMPLE), content, _EXAMPLE), content.parent, [content]
    else:
        root, folder, files = entries_of(content, "scans"), Path(), []
        if isinstance(root.value, dict) and not root.value.keys() & set(_TOP):
            root = Entry({"scans": root}, root.place)
    top = root.mapping("scans", _TOP, _EXAMPLE)
    defaults = top.get("defaults", Entry({}, root.place))
    outputs = _outputs(top.get("scans", Entry(None, root.place)))
    read = [_output(topic, entry, defaults, folder, given) for topic, entry in outputs]
    files += [file for output in read for file in output.files]
    ignored = dict.fromkeys(place for output in read for place in output.ignored)
    return Outputs(tuple(output.specs[0] for output in read), tuple(dict.fromkeys(files)), tuple(ignored))


def _outputs(scans: Entry) -> Iterator[tuple[str, Entry]]:
    """Yield the topic and the entry of each output."""
    if not isinstance(scans.value, dict) or not scans.value:
        problem = f"got {scans.shown}" if scans.value else "there are none"
        raise UsageError(f"{scans.place}: expected outputs under 'scans', {problem}", hint=_EXAMPLE)
    places: dict[str, str] = {}
    for topic, entry in scans.value.items():
        full = new_topic(topic, entry.place)
        if full in places:
            raise UsageError(f"{entry.place}: {full} is given twice, first in {places[full]}")
        places[full] = entry.place
        yield full, entry


def _output(topic: str, entry: Entry, defaults: Entry, folder: Path, given: Sequence[Options]) -> Outputs:
    """Return an output, and what was read for it. Keys that it does not have are read from the defaults."""
    kinds = {"sources": texts(), **{name: option.value for name, option in output_options().items()}}
    known = (*PARAMETERS, *ALIASES, *kinds)
    hint = f"an output has {', '.join(kinds)}, and the parameters of pointcloud_to_laserscan"
    sources = [*given]
    values, places = dict[str, Any](), dict[str, str]()
    for section, what in ((entry, topic), (defaults, "'defaults'")):
        params, origins = dict[str, Any](), dict[str, str]()
        for key, item in section.mapping(what, known, hint).items():
            name = ALIASES.get(key, key)
            if name in PARAMETERS:
                params[name] = item.read(key, PARAMETERS[name].value, folder)
                origins[name] = f"{item.place}, {key}"
            elif key not in values:
                values[key] = item.read(key, kinds[key], folder)
                places[key] = f"{item.place}, {topic}"
        sources.append(Options("convert", params, origins))
    for source in (topics := values.pop("sources", ())):
        if ":=" in source or not source:
            message = f"'sources' has {source!r}, which is not a topic (from {places['sources']})"
            raise ParameterError(message, name="sources", hint="an output's topic is its key")
    options = Options("convert", {**values, "topics": topics})
    file, place = options.params_file, f"{entry.place}, {topic}"
    with naming_place(places, place, [(file, place, "params_file")] if file else ()):
        output = read_output(options, sources, name=topic, place=entry.place)
        if output.specs[0].reverse:
            raise UsageError(f"{file} is for laserscan_to_pointcloud, scans are made of clouds")
    return output._replace(files=(file, *output.files) if file else ())

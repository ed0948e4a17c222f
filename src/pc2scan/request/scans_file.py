"""Reads the outputs of one conversion from a file (``scans.yaml``), or from Python's dicts and lists."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.topics import new_topic
from pc2scan.errors import ParameterError, UsageError
from pc2scan.options.call import Options
from pc2scan.options.table import PARAMETERS, output_options
from pc2scan.options.values import texts

from .entries import Entry, entries_in, entries_of, naming_place, not_quoting, read_text
from .options import ScanSpec, TopicRequest
from .param_sources import read_remaps, resolve_sources
from .parameters import ALIASES, Setting, names_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

_TOP = ("defaults", "scans")

_EXAMPLE = "write scans: {/scan: {min_height: 0.1}, /scan_low: {max_height: 0.1}}"


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


def load_scans(asked: Path | Mapping[str, Any], overriding: Sequence[Setting] = ()) -> Outputs:
    """Read and check outputs.

    Parameters
    ----------
    asked
        A YAML or JSON file, or the same as Python objects: a mapping with ``scans`` and optionally ``defaults``.
        ``scans`` is a mapping from topics to outputs. A mapping without these keys is read as ``scans``.
    overriding
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
    if isinstance(asked, Path):
        root, folder, files = entries_in(read_text(asked, _EXAMPLE), asked, _EXAMPLE), asked.parent, [asked]
    else:
        root, folder, files = entries_of(asked, "scans"), Path(), []
        if isinstance(root.value, dict) and not root.value.keys() & set(_TOP):
            root = Entry({"scans": root}, root.place)
    top = root.mapping("scans", _TOP, _EXAMPLE)
    specs: list[ScanSpec] = []
    ignored: list[str] = []
    defaults = top.get("defaults", Entry({}, root.place))
    for topic, entry in _outputs(top.get("scans", Entry(None, root.place))):
        spec, read, told = _output(topic, entry, defaults, folder, overriding)
        specs.append(spec)
        files += read
        ignored += told
    return Outputs(tuple(specs), tuple(dict.fromkeys(files)), tuple(dict.fromkeys(ignored)))


def _outputs(scans: Entry) -> Iterator[tuple[str, Entry]]:
    """Yield the topic and the entry of each output."""
    if not isinstance(scans.value, dict) or not scans.value:
        problem = f"got {scans.shown}" if scans.value else "there are none"
        raise UsageError(f"{scans.place}: expected outputs under 'scans', {problem}", hint=_EXAMPLE)
    seen: dict[str, str] = {}
    for topic, entry in scans.value.items():
        full = new_topic(topic, entry.place)
        if full in seen:
            raise UsageError(f"{entry.place}: {full} is given twice, first in {seen[full]}")
        seen[full] = entry.place
        yield full, entry


def _output(
    topic: str, entry: Entry, defaults: Entry, folder: Path, overriding: Sequence[Setting]
) -> tuple[ScanSpec, list[Path], Sequence[str]]:
    """Return an output, the files that were read for it, and what was ignored in them.

    Keys that it does not have are read from the defaults.
    """
    known_options = output_options()
    kinds = {"sources": texts(), **{name: option.value for name, option in known_options.items()}}
    known = (*names_of("pointcloud_to_laserscan"), *ALIASES, *kinds)
    hint = f"an output has {', '.join(kinds)}, and the parameters of pointcloud_to_laserscan"
    settings: list[Setting] = []
    values: dict[str, Any] = {}
    places: dict[str, str] = {}
    for section, source in ((entry, topic), (defaults, "'defaults'")):
        for key, item in section.mapping(source, known, hint).items():
            name = ALIASES.get(key, key)
            if name in PARAMETERS:
                value = item.read(key, PARAMETERS[name].value, folder)
                settings.append(Setting(name, value, f"{item.place}, {key}", source))
            elif key not in values:
                values[key] = item.read(key, kinds[key], folder)
                places[key] = f"{item.place}, {topic}"
    sources = values.pop("sources", None)
    options = Options("convert", values, known=known_options)
    file, place = options.params_file, f"{entry.place}, {topic}"
    with naming_place(places, place), not_quoting([(file, place, "params_file")] if file else ()):
        resolved = resolve_sources([*overriding, *settings], file=file, node=options.node, preset=options.preset)
        if resolved.reverse:
            raise UsageError(f"{file} is for laserscan_to_pointcloud, scans are made of clouds")
        if sources is None:
            sources = [name.partition(":=")[0] for name in read_remaps(resolved.file.remaps)[0]]
        for source in sources:
            if ":=" in source or not source:
                message = f"'sources' has {source!r}, which is not a topic"
                raise ParameterError(message, name="sources", hint="an output's topic is its key")
        topics = tuple(TopicRequest(source, topic) for source in sources)
        spec = ScanSpec.of(options.given, resolved, name=topic, place=entry.place, topics=topics)
    return spec, [file, *resolved.file.files] if file else [], resolved.file.ignored


def refuse_beside(names: Sequence[str]) -> None:
    """Raise if arguments are given together with ``scans`` that only the file may have.

    Raises
    ------
    UsageError
        If there are any.
    """
    if names:
        given = ", ".join(f"`{name}`" for name in names)
        raise UsageError(
            f"{given} cannot be combined with `scans`, which has it for each output",
            hint="write it under 'defaults' there, to have it for all; only parameters of the projection may be given",
        )

"""Reads the outputs of one conversion from a file (``scans.yaml``), or from Python's dicts and lists."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import ParameterError, UsageError
from pc2scan.options.table import PARAMETERS, output_options
from pc2scan.options.values import Texts
from pc2scan.text import did_you_mean

from .nodes import read_remaps
from .options import ScanSpec, TopicRequest
from .param_sources import resolve_sources
from .parameters import ALIASES, Setting, names_of, value_text
from .params_file import read_text
from .redaction import may_quote, redact_file
from .yaml_nodes import compose, is_empty, is_mapping, is_scalar, scalar_value

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

#: Maximum number of levels of nesting.
_MAX_DEPTH = 20


_TOP = ("defaults", "scans")

#: The keys of an output that are no parameters of the projection.
_KEYS = {"sources": Texts(), **{name: option.value for name, option in output_options().items()}}


@dataclass(frozen=True, slots=True)
class ScansFile:
    """The result of `load_scans`.

    Attributes
    ----------
    specs
        The outputs, in order.
    files
        All files that were read.
    ignored
        Places of entries in parameter files that are not parameters of the projection.
    """

    specs: tuple[ScanSpec, ...]
    files: tuple[Path, ...] = ()
    ignored: tuple[str, ...] = ()


class _Entry(NamedTuple):
    """A value (a dict or a list of entries, or a scalar), and its place as text."""

    value: Any
    place: str


def load_scans(asked: Path | Mapping[str, Any] | Sequence[Any], overriding: Sequence[Setting] = ()) -> ScansFile:
    """Read and check outputs.

    Parameters
    ----------
    asked
        A YAML or JSON file, or the same as Python objects: a mapping with ``scans`` and optionally ``defaults``.
        ``scans`` is a mapping from topics to outputs, or a list of mappings with a ``topic`` each. A mapping or a list
        without these keys is read as ``scans``.
    overriding
        Parameters of all outputs, which override those of the file; the highest precedence first.

    Returns
    -------
    ScansFile
        Checked, except for what depends on the recording.

    Raises
    ------
    UsageError
        If something is not valid; the error has its place.
    """
    if isinstance(asked, Path):
        root, base = _read_file(asked), asked.parent
    else:
        root, base = _entry_of(asked, "scans", 0), Path()
        if isinstance(root.value, list) or (isinstance(root.value, dict) and not root.value.keys() & set(_TOP)):
            root = _Entry({"scans": root}, root.place)
    if not isinstance(root.value, dict):
        found = "a list" if isinstance(root.value, list) else "only a text"
        raise UsageError(f"{root.place}: expected scans, got {found}", hint=_EXAMPLE)
    for key, entry in root.value.items():
        if key not in _TOP:
            raise UsageError(f"{entry.place}: unknown key {key!r}", hint=did_you_mean(key, _TOP) or _EXAMPLE)
    defaults = root.value.get("defaults", _Entry({}, root.place))
    if not isinstance(defaults.value, dict):
        raise UsageError(f"{defaults.place}: 'defaults' must be a mapping, got {_found(defaults)}", hint=_EXAMPLE)
    files = [asked] if isinstance(asked, Path) else []
    ignored: list[str] = []
    specs: list[ScanSpec] = []
    for topic, entry in _outputs(root):
        made, read, left = _spec(topic, entry, defaults, overriding, base)
        specs.append(made)
        files += (file for file in read if file not in files)
        ignored += (origin for origin in left if origin not in ignored)
    return ScansFile(tuple(specs), tuple(files), tuple(ignored))


_EXAMPLE = "write scans: {/scan: {min_height: 0.1}, /scan_low: {max_height: 0.1}}"


def _read_file(path: Path) -> _Entry:
    text = read_text(path, example=_EXAMPLE)
    root = compose(text, str(path))
    if root is None:
        raise UsageError(f"{path}: the file is empty", hint=_EXAMPLE)
    return _EntryReader(path, len(text)).entry(root, "", 0)


class _EntryReader:
    """Converts the nodes of a file to entries; there are at most as many as the file has characters."""

    def __init__(self, path: Path, most: int) -> None:
        self._path = path
        self._left = most + 1

    def entry(self, node: Any, name: str, depth: int, line: int = 1) -> _Entry:
        """Read a node; its place is ``line``, the line of its key."""
        place = f"{self._path}, line {line}"
        self._left -= 1
        if self._left < 0:
            raise UsageError(f"{self._path}: its aliases multiply to more values than the file has characters")
        if depth > _MAX_DEPTH:
            raise UsageError(f"{place}: nested more than {_MAX_DEPTH} levels deep")
        if is_empty(node):
            return _Entry({} if depth < 3 else None, place)
        if is_scalar(node):
            return _Entry(scalar_value(node, name, place, ros1=False), place)
        if not is_mapping(node):
            items = [self.entry(each, name, depth + 1, each.start_mark.line + 1) for each in node.value]
            return _Entry(items, place)
        found: dict[str, _Entry] = {}
        for key, value in node.value:
            at = key.start_mark.line + 1
            if not is_scalar(key):
                raise UsageError(f"{self._path}, line {at}: a key must be plain text")
            text = str(key.value)
            if text in found:
                raise UsageError(f"{self._path}, line {at}: {text!r} is given twice, first in {found[text].place}")
            found[text] = self.entry(value, text, depth + 1, at)
        return _Entry(found, place)


def _entry_of(value: Any, place: str, depth: int) -> _Entry:
    if depth > _MAX_DEPTH:
        raise UsageError(f"{place}: nested more than {_MAX_DEPTH} levels deep")
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"{place} has the key {key!r}, it must be text")
        return _Entry({key: _entry_of(each, f"{place}[{key!r}]", depth + 1) for key, each in value.items()}, place)
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return _Entry([_entry_of(each, f"{place}[{n}]", depth + 1) for n, each in enumerate(value)], place)
    return _Entry(value.item() if getattr(value, "ndim", None) == 0 else value, place)


def _outputs(root: _Entry) -> Iterator[tuple[str, _Entry]]:
    """Yield the topic and the entry of each output."""
    scans = root.value.get("scans")
    if scans is None or not isinstance(scans.value, dict | list) or not scans.value:
        found = "there are none" if scans is None or scans.value in ({}, [], None) else f"got {_found(scans)}"
        raise UsageError(f"{(scans or root).place}: expected outputs under 'scans', {found}", hint=_EXAMPLE)
    seen: dict[str, str] = {}
    for topic, given in _listed_outputs(scans):
        entry = _Entry({}, given.place) if given.value is None else given
        if not isinstance(entry.value, dict):
            raise UsageError(f"{entry.place}: {topic} must be a mapping, got {_found(entry)}", hint=_EXAMPLE)
        full = topic if topic.startswith(("/", "~")) else f"/{topic}"
        if not topic.strip() or any(character.isspace() for character in topic) or ":=" in topic:
            raise UsageError(f"{entry.place}: {topic!r} is not a topic", hint=_EXAMPLE)
        if full in seen:
            raise UsageError(f"{entry.place}: {full} is given twice, first in {seen[full]}")
        seen[full] = entry.place
        yield full, entry


def _listed_outputs(scans: _Entry) -> Iterator[tuple[str, _Entry]]:
    if isinstance(scans.value, dict):
        yield from scans.value.items()
        return
    for entry in scans.value:
        topic = entry.value.get("topic") if isinstance(entry.value, dict) else None
        if topic is None or not isinstance(topic.value, str):
            raise UsageError(f"{entry.place}: an output in a list needs a 'topic'", hint="write - topic: /scan")
        yield topic.value, _Entry({key: each for key, each in entry.value.items() if key != "topic"}, entry.place)


def _spec(
    topic: str, entry: _Entry, defaults: _Entry, overriding: Sequence[Setting], base: Path
) -> tuple[ScanSpec, Iterable[Path], Iterable[str]]:
    """Return one output; keys that it does not have are read from the defaults."""
    settings = list(overriding)
    chosen: dict[str, _Entry] = {}
    for each, source in ((entry, "output"), (defaults, "defaults")):
        for key, found in each.value.items():
            name = ALIASES.get(key, key)
            if name in PARAMETERS:
                settings.append(Setting(name, _scalar(found, key), f"{found.place}, {key}", source))
            elif key in _KEYS:
                chosen.setdefault(key, found)
            else:
                known = (*names_of("pointcloud_to_laserscan"), *_KEYS)
                near = did_you_mean(key, known)
                raise UsageError(
                    f"{found.place}: unknown key {key!r}",
                    hint=near or f"an output has {', '.join(_KEYS)}, and the parameters of pointcloud_to_laserscan",
                )
    values = {key: _check_value(key, found) for key, found in chosen.items()}
    file = Path(base, values["params_file"]) if "params_file" in values else None
    with _naming_place(entry, topic, chosen, file):
        resolved = resolve_sources(settings, file=file, node=values.get("node"), preset=values.get("preset"))
        if resolved.reverse:
            raise UsageError(f"{file} is for laserscan_to_pointcloud, scans are made of clouds")
        if "sources" not in values and resolved.remaps:
            values["sources"] = [request.partition(":=")[0] for request in read_remaps(resolved.remaps).topics]
        topics = tuple(TopicRequest(_check_topic(source), topic) for source in values.get("sources", ()))
        spec = ScanSpec.of(values, resolved, name=topic, place=entry.place, topics=topics)
    return spec, (() if file is None else (file, *resolved.files)), resolved.ignored


def _check_topic(source: str) -> str:
    if ":=" in source or not source:
        raise UsageError(f"'sources' has {source!r}, which is not a topic", hint="an output's topic is its key")
    return source


@contextmanager
def _naming_place(entry: _Entry, topic: str, chosen: Mapping[str, _Entry], file: Path | None) -> Iterator[None]:
    """Add an output's topic and place to errors; those about its parameter file do not quote it."""
    try:
        yield
    except UsageError as err:
        if file is not None and may_quote(err, file):
            raise redact_file(err, file, f"{entry.place}, {topic}") from None
        # If the error names a key, the line of this key is shown.
        named_keys = ((f"`{key}`", f"'{key}'", found) for key, found in chosen.items())
        named = next((found for *names, found in named_keys if any(name in err.message for name in names)), entry)
        if not err.message.startswith(named.place):
            err.message = f"{named.place}, {topic}: {err.message}"
        raise


def _scalar(entry: _Entry, key: str) -> Any:
    if isinstance(entry.value, dict | list):
        raise ParameterError(f"{entry.place}: {key} must be a single value, got {_found(entry)}", name=key)
    return entry.value


def _check_value(key: str, entry: _Entry) -> Any:
    """Return the value of a key; raise if it is not of the key's type."""
    kind, value = _KEYS[key], entry.value
    each = value if isinstance(value, list) and kind.repeats else [entry]
    if each and all(kind.admits(one.value) for one in each):
        found = [one.value for one in each]
        return kind.read(key, found if kind.repeats else found[0])
    near = did_you_mean(value, kind.words) if isinstance(value, str) else ""
    if kind.repeats and isinstance(value, list) and value:
        near = 'in a list, a text with a comma needs quotes: ["ring in (6, 7, 8)", x > 0]'
    raise UsageError(f"{entry.place}: {key} must be {kind.expected}, got {_found(entry)}", hint=near or None)


def _found(entry: _Entry) -> str:
    return "a mapping" if isinstance(entry.value, dict) else value_text(entry.value)


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

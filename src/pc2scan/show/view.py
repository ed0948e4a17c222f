"""``pc2scan.view``: shows a recording as one HTML page that needs no network."""

from __future__ import annotations

from dataclasses import dataclass, replace
from html import escape
from typing import TYPE_CHECKING, ClassVar

from pc2scan.core.params import ProjectionParams
from pc2scan.errors import Pc2ScanError, UsageError, leading
from pc2scan.files.ownership import inputs_of, refuse_overlap
from pc2scan.files.staging import files_output
from pc2scan.files.urls import path_of
from pc2scan.messages.clouds import CLOUDS
from pc2scan.options.call import Options
from pc2scan.requests import conversion_of, first_output
from pc2scan.result import Part, Result
from pc2scan.text import size
from pc2scan.transforms.static import added_transforms

from .info import info_of
from .pages import BEGINNING, check_page_name, clouds_page, html, scans_page
from .shots import moment_text, open_as_one, title_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.bags.reader import Reader
    from pc2scan.request.options import ConvertOptions
    from pc2scan.requests import Warn


#: Clouds and scans of a topic on one page. They share its size.
_MOST_CLOUDS = 1_000


@dataclass(frozen=True, slots=True, repr=False)
class Page(Result):
    """A page. Notebooks show it in their cell.

    Attributes
    ----------
    pieces
        The HTML file, in pieces.
    notes
        What the page says above the pictures.
    warnings
        What is not as the options ask.
    damage
        The damage in the parts of the recording that were read.
    path
        Its file; empty if it is not written.
    """

    kind: ClassVar[str] = "page"
    json_names: ClassVar[tuple[str, ...]] = ("path", "bytes")

    pieces: tuple[bytes, ...]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    damage: tuple[Damage, ...] = ()
    path: str = ""

    @property
    def bytes(self) -> int:
        """The size of the file."""
        return sum(map(len, self.pieces))

    @property
    def html(self) -> str:
        """The whole HTML file."""
        return b"".join(self.pieces).decode()

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield the file and its size."""
        yield f"{leading(self.path) or 'a page'}: {size(self.bytes)}"

    def __repr__(self) -> str:
        return f"<pc2scan.Page of {len(self.html):,} characters>"

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
        check_page_name(path)
        with files_output([path], beginning=BEGINNING, overwrite=overwrite) as deliver:
            deliver([self.pieces])
        return path


def view(sources: Sequence[Path], destination: Path | None, options: Options, *, warn: Warn | None = None) -> Page:
    """Show a recording as a page, which is written if there is a destination; see `pc2scan.view`."""
    request = first_output(conversion_of(options, warn), "shown", warn)
    if destination is None:
        return _page(sources, request, options, warn)
    check_page_name(destination)
    refuse_overlap(inputs_of(sources, options.tf_from, request.files), [destination])
    with files_output([destination], beginning=BEGINNING, overwrite=options.overwrite) as deliver:
        page = _page(sources, request, options, warn)
        deliver([page.pieces])
    return replace(page, path=str(destination))


def _page(sources: Sequence[Path], options: ConvertOptions, asked: Options, warn: Warn | None) -> Page:
    """Make a page of a recording: of its clouds and their projection, or of its scans if it has no clouds."""
    if not 1 <= asked.clouds <= _MOST_CLOUDS:
        raise UsageError(f"`clouds` is {asked.clouds:,}, it must be from 1 to {_MOST_CLOUDS:,}")
    with open_as_one(sources, options) as (reader, stack):
        if any(connection.ros_type in CLOUDS for connection in reader.connections) and not options.scan.reverse:
            # The node's heights are part of its parameters, also where a file of these does not have them.
            is_given = bool(asked.given.keys() & {"params", "params_file", "param", "scans"})
            shown = options if is_given else _as_proposed(reader, options)
            described, blobs, damage = clouds_page(sources, reader, asked, shown, stack, warn)
            if shown is not options:
                params = shown.scan.params
                where = f"in frame {params.target_frame!r}" if params.target_frame else "in the frame of the clouds"
                heights = f"{params.min_height:g} to {params.max_height:g} m {where}"
                described["notes"].insert(0, f"The page opens with the heights that pc2scan info proposes: {heights}.")
        else:
            described, blobs, damage = scans_page(sources, reader, asked, options, stack)
        notes, warnings = described["notes"], [*options.notes, *described.pop("warnings")]
        # The page shows both.
        described["notes"] = [*notes, *warnings]
        described |= {"title": title_of(sources), "subtitle": _subtitle(reader)}
        return Page(html(described, blobs), tuple(notes), tuple(warnings), damage)


def _as_proposed(reader: Reader, options: ConvertOptions) -> ConvertOptions:
    """Return options with the frame and the heights that info proposes first.

    They are as they were if heights are given, or if nothing can be proposed in the given frame.
    """
    params, defaults = options.scan.params, ProjectionParams()
    if (params.min_height, params.max_height) != (defaults.min_height, defaults.max_height):
        return options
    try:
        # Heights are of the first clouds, however many are sampled.
        topics = [request.source for request in options.scan.topics]
        given = Options("info", {"topics": topics, "target_frame": params.target_frame})
        info = info_of([reader], given, options.frames, samples=1)
        calls = [call.options for call in info.proposals]
        first = next((call for call in calls if params.target_frame in ("", call.get("target_frame", ""))), {})
        if "min_height" not in first:
            return options
        static = first.get("static_tf", ())
        added = added_transforms((static,) if isinstance(static, str) else static)
    except Pc2ScanError:
        # What is wrong may matter for the page, too, which says so then.
        return options
    chosen = {name: first[name] for name in ("target_frame", "min_height", "max_height") if name in first}
    frames = replace(options.frames, static=(*options.frames.static, *added))
    return replace(options.with_scan(params=replace(params, **chosen)), frames=frames)


def _subtitle(reader: Reader) -> str:
    summary = reader.summary
    if summary.start_ns is None or summary.end_ns is None:
        return ""
    return f"{moment_text(summary.start_ns)}, {(summary.end_ns - summary.start_ns) / 1e9:.1f} s"

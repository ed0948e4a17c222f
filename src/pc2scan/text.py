"""Text for users: tables and lines, names that were probably meant, values for JSON, words as enumerations."""

from __future__ import annotations

import math
from abc import abstractmethod
from enum import Enum
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

from .errors import leading, stamp_text, visible

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

#: Maximum number of names that are compared, and their maximum length: recordings may have any number of names.
_MOST_NAMES = 2_000
_LONGEST_NAME = 255

#: Maximum number of characters of a table's cell, because one long name would widen every line. Names in ROS have at
#: most 255.
_MAX_CELL = 255

#: Stamps between these, in seconds since 1970 (years 1980 to 2100), are shown as dates.
_FIRST_DATE, _LAST_DATE = 315_532_800, 4_102_444_800


def nearest(asked: str, known: Iterable[str]) -> str | None:
    """Return the name that is most similar to the requested one, or None if none is similar.

    Case, slashes at the ends, and hyphens instead of underscores are ignored. A part of a name matches, too.

    >>> nearest("Base-Link", ["odom", "base_link"]), nearest("points", ["/lidar/points", "/imu"])
    ('base_link', '/lidar/points')
    >>> nearest("x", ["odom"])
    """
    import difflib  # noqa: PLC0415  # few commands are wrong, and all start quickly

    names = {
        _normalized(name): name for name in reversed(list(islice(known, _MOST_NAMES))) if len(name) <= _LONGEST_NAME
    }
    wanted = _normalized(asked[:_LONGEST_NAME])
    if not wanted:
        return None
    close = difflib.get_close_matches(wanted, names, n=1)
    # Then names that contain it as a part, or are a part of it, the shortest first.
    close += sorted((name for name in names if _is_part(wanted, name) or _is_part(name, wanted)), key=len)
    if not close:
        ends = {name.rpartition("/")[2]: name for name in names}
        close = [ends[end] for end in difflib.get_close_matches(wanted.rpartition("/")[2], ends, n=1)]
    return names[close[0]] if close else None


def did_you_mean(asked: str, known: Iterable[str]) -> str:
    """Return ``did you mean base_link?``, or empty text if no name is similar to the requested one."""
    name = nearest(asked, known)
    return f"did you mean {name}?" if name else ""


def _normalized(name: str) -> str:
    return name.casefold().replace("-", "_").strip("/ ")


def _is_part(short: str, long: str) -> bool:
    return len(short) >= 3 and (long.endswith(f"/{short}") or long.startswith(f"{short}/") or f"/{short}/" in long)


class Table(NamedTuple):
    """A table: headings, cells as text, and the headings of columns that are aligned to the left."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: Sequence[str] = ()


class Shown:
    """A result that ``print`` shows as text, notebooks as HTML, and ``repr`` in one line."""

    __slots__ = ()

    @abstractmethod
    def _shown(self) -> Iterator[str | Table]:
        """Yield tables and lines of text; an empty line separates them."""

    def __str__(self) -> str:
        lines: list[str] = []
        for part in self._shown():
            lines += _table_text(part) if isinstance(part, Table) else [visible(part)]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Return the HTML that notebooks show."""
        parts: list[str] = []
        lines: list[str] = []
        for part in [*self._shown(), Table((), ())]:
            if not isinstance(part, Table):
                lines.append(_escaped(part))
                continue
            # Without empty lines at the ends: HTML has space around tables anyway.
            if text := "\n".join(lines).strip("\n"):
                parts.append(f"<pre>{text}</pre>")
            lines.clear()
            parts += _table_html(part) if part.columns else []
        return f"<div>{''.join(parts)}</div>"


def cells(table: Table, *, ascii_only: bool = False) -> list[list[str]]:
    """Return the headings and the cells of a table, which have names of untrusted recordings, as safe text."""
    rows = ([visible(cell, _MAX_CELL, ascii_only=ascii_only) for cell in row] for row in table.rows)
    return [list(table.columns), *([leading(cell) for cell in row[:1]] + row[1:] for row in rows)]


def csv_cell(text: str) -> str:
    r"""Return text as a cell of a CSV file: visible, in quotes if necessary, and never a formula.

    Spreadsheets compute a cell that begins with ``=``, ``+``, ``-`` or ``@``, and names come from untrusted recordings.
    No frame or topic of ROS begins with one of these, so the character is escaped like a control character.

    >>> print(csv_cell("base_link"), csv_cell("a,b"), csv_cell("=cmd|' /C calc'!A0"))
    base_link "a,b" \x3dcmd|' /C calc'!A0
    """
    if text[:1] in ("=", "+", "-", "@"):
        text = f"\\x{ord(text[0]):02x}{text[1:]}"
    text = visible(text, None)
    return '"' + text.replace('"', '""') + '"' if "," in text or '"' in text else text


def count(number: int) -> str:
    """Format a count; zero is a dash."""
    return f"{number:,}" if number else "-"


def counted(number: int, noun: str, verb: str = "") -> str:
    """Render a number of things, optionally with a verb, which is given in the plural.

    >>> counted(1, "scan"), counted(2_000, "other topic"), counted(1, "scan", "have")
    ('1 scan', '2,000 other topics', '1 scan has')
    """
    things = f"{number:,} {noun}{'' if number == 1 else 's'}"
    return f"{things} {agreeing(number, verb)}" if verb else things


def agreeing(number: int, verb: str) -> str:
    """Return the form of a verb for a number of things, given the plural: are, were, have, differ.

    >>> agreeing(1, "have"), agreeing(0, "were"), agreeing(1, "differ")
    ('has', 'were', 'differs')
    """
    return {"are": "is", "were": "was", "have": "has"}.get(verb, f"{verb}s") if number == 1 else verb


def size(number: float) -> str:
    """Format a number of bytes: ``680.5 kB``."""
    for unit in ("B", "kB", "MB", "GB"):
        if number < 1000:
            return f"{number:.0f} {unit}" if unit == "B" else f"{number:.1f} {unit}"
        number /= 1000
    return f"{number:.1f} TB"


def duration(seconds: float) -> str:
    """Render a duration.

    >>> duration(0.0004), duration(0.0354), duration(9.96), duration(75), duration(7384)
    ('under 1 ms', '35 ms', '10.0 s', '1 min 15 s', '2 h 3 min')
    """
    if seconds < 0.001:
        return "under 1 ms"
    if seconds < 0.9995:
        return f"{seconds * 1000:.0f} ms"
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def stamp(stamp_ns: int) -> str:
    """Render a stamp, with its date if it is one: simulated time begins at 0.

    >>> stamp(1604515190231374463), stamp(5_000_000_000)
    ('1604515190.231374463 (2020-11-04 18:39:50 UTC)', '5.000000000')
    """
    seconds = stamp_ns // 1_000_000_000
    if not _FIRST_DATE <= seconds <= _LAST_DATE:
        return stamp_text(stamp_ns)
    from datetime import datetime, timezone  # noqa: PLC0415  # few results have dates

    return f"{stamp_text(stamp_ns)} ({datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S} UTC)"


def listed(entries: Sequence[str], label: str, most: int) -> Iterator[str]:
    """Yield at most ``most`` lines that begin with a label, and a line with the number of further entries."""
    yield from (f"{label}: {entry}" for entry in entries[:most])
    if len(entries) > most:
        yield f"{label}: {len(entries) - most:,} more"


def _table_text(table: Table) -> Iterator[str]:
    lines = cells(table)
    widths = [max(len(line[i]) for line in lines) for i in range(len(table.columns))]
    for number, line in enumerate(lines):
        aligned = (
            cell.ljust(width) if heading in table.left else cell.rjust(width)
            for heading, cell, width in zip(table.columns, line, widths, strict=True)
        )
        yield "   ".join(aligned).rstrip()
        if number == 0:
            yield "-" * (sum(widths) + 3 * (len(widths) - 1))


def _table_html(table: Table) -> Iterator[str]:
    styles = [f' style="text-align: {"left" if name in table.left else "right"}"' for name in table.columns]

    def row(tag: str, cells: Sequence[str]) -> str:
        made = (f"<{tag}{style}>{_escaped(cell)}</{tag}>" for style, cell in zip(styles, cells, strict=True))
        return f"<tr>{''.join(made)}</tr>"

    yield f"<table><thead>{row('th', table.columns)}</thead><tbody>"
    yield from (row("td", cells) for cells in table.rows)
    yield "</tbody></table>"


def _escaped(text: str) -> str:
    from html import escape  # noqa: PLC0415  # only notebooks need it

    return escape(visible(text))


def json_value(value: Any) -> Any:
    """Return a value with infinities and NaNs as text, in lists and dictionaries too.

    Tuples become lists, named tuples dictionaries.

    >>> json_value({"range_max": float("inf"), "angles": (0.5, float("nan"))})
    {'range_max': 'inf', 'angles': [0.5, 'nan']}
    """
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {key: json_value(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(part) for part in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


class TextEnum(str, Enum):
    """`enum.StrEnum`, which Python 3.10 does not have: ``str()`` and format strings give the value."""

    def __str__(self) -> str:
        return str.__str__(self)

    def __format__(self, format_spec: str) -> str:
        return str.__format__(self, format_spec)

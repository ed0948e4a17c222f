"""Text for users: names that were probably meant, numbers, sizes, times, and tables that fit a terminal."""

from __future__ import annotations

import difflib
import shlex
from datetime import datetime, timezone
from itertools import islice, zip_longest
from textwrap import wrap
from typing import TYPE_CHECKING, NamedTuple

from .errors import leading, stamp_text, visible

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence


#: Maximum number of names that are compared, and their maximum length: recordings may have any number of names.
_MOST_NAMES = 2_000
_LONGEST_NAME = 255

#: Stamps between these, in seconds since 1970 (years 1980 to 2100), are shown as dates.
_FIRST_DATE, _LAST_DATE = 315_532_800, 4_102_444_800

#: Moments before this are shown in seconds: stamps of simulations begin at 0.
_EARLIEST_NS = 100_000_000 * 1_000_000_000


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the name that is most similar to the requested one, or None if none is similar.

    Case, slashes at the ends, and hyphens instead of underscores are ignored. A part of a name matches, too.

    >>> nearest("Base-Link", ["odom", "base_link"]), nearest("points", ["/lidar/points", "/imu"])
    ('base_link', '/lidar/points')
    >>> nearest("x", ["odom"])
    """
    names: dict[str, str] = {}
    parts: dict[str, str] = {}
    for candidate in islice(known, _MOST_NAMES):
        if len(candidate) <= _LONGEST_NAME:
            normalized = _normalized(candidate)
            names.setdefault(normalized, candidate)
            parts |= dict.fromkeys(normalized.split("/"), candidate)
    wanted = _normalized(name[:_LONGEST_NAME])
    for text, candidates in ((wanted, names), (wanted.rpartition("/")[2], parts)):
        for close in difflib.get_close_matches(text, candidates, n=1):
            return candidates[close]
    return None


def shell_word(word: str) -> str:
    """Return a word as a shell reads it: in double quotes where these serve, because cmd.exe knows no others.

    >>> print(shell_word("scan.bag"), shell_word("base_link lidar 0 0 1 0 0 0"), shell_word("$HOME a"))
    scan.bag "base_link lidar 0 0 1 0 0 0" '$HOME a'
    """
    quoted = shlex.quote(word)
    return quoted if quoted == word or set(word) & set('"$`\\!%\n\r') else f'"{word}"'


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ``did you mean base_link?``, or empty text if no name is similar to the requested one."""
    near = nearest(name, known)
    return f"did you mean {near}?" if near else ""


def _normalized(name: str) -> str:
    return name.casefold().replace("-", "_").strip("/ ")


def height_text(value: float) -> str:
    """Return a height in metres, to a centimetre.

    >>> height_text(-0.003), height_text(2.5)
    ('0.00', '2.50')
    """
    return f"{round(value, 2) + 0.0:.2f}"


def count(number: int) -> str:
    """Format a count; zero is a dash."""
    return f"{number:,}" if number else "-"


def count_range(least: int, most: int) -> str:
    """Return the smallest and the largest of some counts as text; one number if they are equal."""
    return f"{least:,}" if least == most else f"{least:,} to {most:,}"


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
    return f"{stamp_text(stamp_ns)} ({datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S} UTC)"


def moment_text(stamp_ns: int) -> str:
    """Return a stamp as a date and time in UTC, to the millisecond; stamps of simulations in seconds."""
    if stamp_ns < _EARLIEST_NS:
        return f"{stamp_ns / 1e9:.3f} s"
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S}.{rest // 1_000_000:03d} UTC"


#: Maximum number of characters of a cell, because one long name would widen every line. Names in ROS have at most 255.
_MAX_CELL = 255

#: The space between columns, and the smallest width of a column of wrapped text.
_GAP, _NARROWEST = 2, 12

_NOTHING = frozenset({"", "-"})


class Table(NamedTuple):
    """A table: headings, cells as text, and the headings of columns that are aligned to the left."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: Sequence[str] = ()

    def lines(self, width: int | None = None) -> Iterator[str]:
        """Yield the lines of the table, ``width`` columns wide if its numbers fit; cells may have untrusted names."""
        rows = ([visible(cell, _MAX_CELL) for cell in row] for row in self.rows)
        columns = [*zip(self.columns, *([leading(name), *cells] for name, *cells in rows), strict=True)]
        widths = [max(map(len, column)) for column in columns]

        def needed() -> int:
            return sum(widths) + _GAP * (len(widths) - 1)

        most = width or needed()
        for number in reversed(range(1, len(columns))):
            if needed() > most and _NOTHING.issuperset(columns[number][1:]):
                del columns[number], widths[number]
        texts = [number for number, column in enumerate(columns) if column[0] in self.left]
        while needed() > most and (wide := [number for number in texts if widths[number] > _NARROWEST]):
            # Narrow the widest column by one at a time, so that all columns share the space.
            widths[max(wide, key=widths.__getitem__)] -= 1
        for number, cells in enumerate(zip(*columns, strict=True)):
            # Text that is too wide continues on the next line.
            pieces = [wrap(cell, room or 1) for cell, room in zip(cells, widths, strict=True)]
            for parts in zip_longest(*pieces, fillvalue=""):
                aligned = (
                    part.ljust(widths[i]) if i in texts else part.rjust(widths[i]) for i, part in enumerate(parts)
                )
                yield (" " * _GAP).join(aligned).rstrip()
            if number == 0:
                yield "-" * needed()

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


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the name that is most similar to the requested one, or None if none is similar.

    Case, slashes at the ends, and hyphens instead of underscores are ignored. A part of a name matches, too.

    >>> nearest("Base-Link", ["odom", "base_link"]), nearest("points", ["/lidar/points", "/imu"])
    ('base_link', '/lidar/points')
    >>> nearest("x", ["odom"])
    """
    names = {
        _normalized(name): name for name in reversed(list(islice(known, _MOST_NAMES))) if len(name) <= _LONGEST_NAME
    }
    normalized = _normalized(name[:_LONGEST_NAME])
    if not normalized:
        return None
    close = difflib.get_close_matches(normalized, names, n=1)
    # Then names that contain it as a part, or are a part of it, the shortest first.
    close += sorted((name for name in names if _is_part(normalized, name) or _is_part(name, normalized)), key=len)
    if not close:
        ends = {name.rpartition("/")[2]: name for name in names}
        close = [ends[end] for end in difflib.get_close_matches(normalized.rpartition("/")[2], ends, n=1)]
    return names[close[0]] if close else None


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


def _is_part(short: str, long: str) -> bool:
    return len(short) >= 3 and (long.endswith(f"/{short}") or long.startswith(f"{short}/") or f"/{short}/" in long)


def height_text(value: float) -> str:
    """Return a height in metres, to a centimetre.

    >>> height_text(-0.003), height_text(2.5)
    ('0.00', '2.50')
    """
    return f"{round(value, 2) + 0.0:.2f}"


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
    return f"{stamp_text(stamp_ns)} ({datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S} UTC)"


#: Maximum number of characters of a cell, because one long name would widen every line. Names in ROS have at most 255.
_MAX_CELL = 255

#: The space between columns, and the smaller one for tables that do not fit otherwise.
_GAP, _NARROW_GAP = 3, 2

#: The smallest width of a column of wrapped text is that of its longest word, but at most this.
_NARROWEST, _LONGEST_WORD = 12, 24

_NOTHING = frozenset({"", "-"})


class Table(NamedTuple):
    """A table: headings, cells as text, and the headings of columns that are aligned to the left."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: Sequence[str] = ()

    def lines(self, width: int | None = None, *, ascii_only: bool = False) -> Iterator[str]:
        """Yield the lines of the table, at most ``width`` columns wide; cells have names of untrusted recordings."""
        rows = ([visible(cell, _MAX_CELL, ascii_only=ascii_only) for cell in row] for row in self.rows)
        cells = [self.columns, *([leading(cell) for cell in row[:1]] + row[1:] for row in rows)]
        headings, left, kept = self.columns, self.left, list(range(len(self.columns)))
        gap = _GAP
        dropped: list[str] = []

        def needed() -> int:
            return sum(widths[i] for i in kept) + gap * (len(kept) - 1)

        widths = [max(len(line[i]) for line in cells) for i in range(len(headings))]
        if width is not None and needed() > width:
            kept = [i for i in kept if i == 0 or not self.rows or any(row[i] not in _NOTHING for row in cells[1:])]
            gap = _GAP if needed() <= width else _NARROW_GAP
            texts = [i for i in kept if headings[i] in left]
            least = {i: max(_NARROWEST, *(_longest_word(line[i]) for line in cells)) for i in texts}
            while needed() > width and (wide := [i for i in texts if widths[i] > least[i]]):
                # Narrow the widest column by one at a time, so that all columns share the space.
                widths[max(wide, key=widths.__getitem__)] -= 1
            while needed() > width and len(kept) > 1:
                numbers = [i for i in kept[1:] if headings[i] not in left] or kept[1:]
                dropped.insert(0, headings[numbers[-1]])
                kept.remove(numbers[-1])
        for number, line in enumerate(cells):
            # Text that is too wide continues on the next line.
            pieces = [[line[i]] if len(line[i]) <= widths[i] else _broken(line[i], widths[i]) for i in kept]
            for parts in zip_longest(*pieces, fillvalue=""):
                aligned = (
                    part.ljust(widths[i]) if headings[i] in left else part.rjust(widths[i])
                    for i, part in zip(kept, parts, strict=True)
                )
                yield (" " * gap).join(aligned).rstrip()
            if number == 0:
                yield "-" * needed()
        if dropped:
            yield f"(no room for: {', '.join(dropped)})"


def _longest_word(text: str) -> int:
    words = text.split() if " " in text else text.replace("/", "/ ").split()
    return min(_LONGEST_WORD, max(map(len, words), default=0))


def _broken(text: str, width: int) -> list[str]:
    # Names of topics and types may be broken after a slash.
    spaced = text if " " in text else text.replace("/", "/ ")
    lines = wrap(spaced, width, break_on_hyphens=False) or [""]
    return lines if " " in text else [part.replace(" ", "") for part in lines]

"""Tables as lines that fit a terminal, and cells of CSV files.

To fit a width, empty columns are dropped, then text is wrapped, then columns on the right are dropped.
"""

from __future__ import annotations

from itertools import zip_longest
from textwrap import wrap
from typing import TYPE_CHECKING, NamedTuple

from .errors import leading, visible

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

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
        safe = ([leading(cell) for cell in row[:1]] + row[1:] for row in rows)
        return fitted([self.columns, *safe], self.left, width)


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


def fitted(cells: Sequence[Sequence[str]], left: Collection[str], width: int | None) -> Iterator[str]:
    """Yield the lines of a table.

    Parameters
    ----------
    cells
        The headings, then the rows.
    left
        Headings of the columns of text, which are aligned to the left; the others are numbers.
    width
        Columns of the screen; None for no limit.
    """
    headings, *rows = cells
    kept = list(range(len(headings)))
    gap = _GAP
    dropped: list[str] = []

    def needed() -> int:
        return sum(widths[i] for i in kept) + gap * (len(kept) - 1)

    widths = [max(len(line[i]) for line in cells) for i in range(len(headings))]
    if width is not None and needed() > width:
        kept = [i for i in kept if i == 0 or not rows or any(row[i] not in _NOTHING for row in rows)]
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

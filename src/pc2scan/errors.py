"""The errors that pc2scan raises.

::

    Pc2ScanError                   exit status 1
    ├── UsageError                 exit status 2: the call is wrong, nothing was read or written
    │   ├── ParameterError         a projection parameter's name, type or value
    │   ├── TopicError             a topic that is missing, of another type or taken
    │   └── DestinationError       DST cannot be written as requested
    ├── RecordingError             a source cannot be read
    │   ├── MissingError           exit status 2: it does not exist
    │   └── DamageError            bytes of it are missing or wrong; without ``strict``, the rest is recovered
    ├── ResultError                nothing was converted, or less than required; nothing is written
    ├── OutputError                the destination cannot be written
    │   └── DiskFullError          exit status 5: a batch ended early, because its disk has no room
    └── MessageError               one message cannot be converted (skipped, or fatal with ``fail``)
        ├── DecodeError            its bytes contradict its type
        ├── TransformError         no transform for its frame and stamp
        │   └── UnconnectedError   no transform for its frame, at any stamp
        └── UnwritableError        the destination's format cannot hold its log time or its size

`RecordingWarning` is the category of Python's warnings about recordings.

Any other exception is a bug and keeps its traceback. This module imports no other module of pc2scan.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

#: The beginning of a hint in a traceback.
_HINT = "hint: "

#: Maximum number of characters of a line. Names in ROS have at most 255.
_MAX_LINE = 4_000


def visible(text: str, most: int | None = _MAX_LINE) -> str:
    r"""Return one line that terminals, logs and CI systems show and do not obey; all text for users passes through it.

    Names, types and frames come from untrusted recordings. Characters that cannot be printed (controls, ends of lines,
    marks of direction, characters without width, surrogates) are escaped, and so are the commands that CI systems
    find in logs: ``::`` at the beginning of a line (GitHub), ``##[`` and ``##vso[`` (Azure), ``##teamcity[``.

    Parameters
    ----------
    text
        One line.
    most
        Longer text is cut; None for any length.

    Examples
    --------
    >>> print(visible("/scan\x1b[2J\n"), visible("::error::no"), visible("a" * 5000)[-20:])
    /scan\x1b[2J\n \x3a:error::no aaaa... (5000 chars)
    """
    if most is not None and len(text) > most:
        return f"{visible(text[:most], None)}... ({len(text)} chars)"
    if not text.isprintable():
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    if "##" in text and "[" in text:
        text = re.sub(r"##(?=\w*\[)", r"\\x23\\x23", text)
    begin = text.lstrip()
    return f"{text[: -len(begin)]}\\x3a{begin[1:]}" if begin.startswith("::") else text


def leading(name: str) -> str:
    """Return a name for the beginning of a line: visible, and in quotes if the line could be taken for another one.

    >>> leading("/scan"), leading("same: 1 topic")
    ('/scan', "'same: 1 topic'")
    """
    text = visible(name)
    return f"'{text}'" if ": " in text or text.endswith(":") else text


def stamp_text(stamp_ns: int) -> str:
    """Return nanoseconds as seconds with all nine decimals; a float would lose the last ones.

    >>> stamp_text(1604515190231374463), stamp_text(-1)
    ('1604515190.231374463', '-0.000000001')
    """
    seconds, nanoseconds = divmod(abs(stamp_ns), 1_000_000_000)
    return f"{'-' if stamp_ns < 0 else ''}{seconds}.{nanoseconds:09d}"


def name_list(names: Sequence[str], limit: int = 20) -> str:
    """Return names as a list for an error message: all of them, or the first ones and the number of the others.

    >>> name_list(["/a", "/b", "/c"], limit=2), name_list([])
    ('/a, /b and 1 more', 'none')
    """
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return (", ".join(names[:limit]) or "none") + more


class Pc2ScanError(Exception):
    """The base class: what was wrong, where, and what to do.

    Parameters
    ----------
    message
        What was wrong: observed and allowed, in one sentence.
    path, topic, stamp_ns
        The place of the error, as far as known. ``stamp_ns`` is the header's stamp in nanoseconds.
    hint
        What the user can do; tracebacks show it too. Message and hint name options as Python does, in backticks:
        ```overwrite=True` replaces it``.
    """

    exit_status: ClassVar[int] = 1

    def __init__(
        self,
        message: str,
        *,
        path: str | PathLike[str] | None = None,
        topic: str | None = None,
        stamp_ns: int | None = None,
        hint: str | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.path = path
        self.topic = topic
        self.stamp_ns = stamp_ns
        self.hint = hint

    @property
    def hint(self) -> str | None:
        """What the user can do about it; None if there is no advice."""
        return self._hint

    @hint.setter
    def hint(self, text: str | None) -> None:
        notes = [note for note in getattr(self, "__notes__", ()) if not note.startswith(_HINT)]
        self.__notes__ = [*notes, f"{_HINT}{visible(text)}"] if text else notes
        self._hint = text

    @property
    def where(self) -> str:
        """The place as ``path, topic, stamp``; empty if unknown."""
        parts = []
        if self.path is not None:
            parts.append(str(self.path))
        if self.topic is not None:
            parts.append(self.topic)
        if self.stamp_ns is not None:
            parts.append(f"stamp {stamp_text(self.stamp_ns)}")
        return ", ".join(parts)

    def as_dict(self) -> dict[str, str | int | None]:
        """Return the error as JSON's types."""
        return {
            "kind": type(self).__name__,
            "message": self.message,
            "path": None if self.path is None else str(self.path),
            "topic": self.topic,
            "stamp_ns": self.stamp_ns,
            "hint": self.hint,
            "exit_status": self.exit_status,
        }

    def __str__(self) -> str:
        return visible(f"{self.where}: {self.message}" if self.where else self.message, None)


class UsageError(Pc2ScanError):
    """The call is wrong; nothing was read or written."""

    exit_status = 2


class ParameterError(UsageError):
    """A parameter is unknown, has the wrong type, or has an impossible value.

    Parameters
    ----------
    message
        What was wrong, with the value.
    name
        The parameter's ROS name.
    hint
        What the user can do about it.
    """

    def __init__(self, message: str, *, name: str = "", hint: str | None = None) -> None:
        super().__init__(message, hint=hint)
        self.name = name


class TopicError(UsageError):
    """A topic is missing, has another type, or its name is taken."""


class NothingToConvertError(TopicError):
    """The recording has no topic of a type that can be converted: no clouds, or no scans."""


class DestinationError(UsageError):
    """The destination exists, is a source, or cannot be written as requested."""


class RecordingError(Pc2ScanError):
    """A source cannot be read, or is not a recording."""


class MissingError(RecordingError):
    """A source does not exist."""

    exit_status = 2


class DamageError(RecordingError):
    """Bytes of a source are missing or contradict its format; the rest can be recovered."""


class ResultError(Pc2ScanError):
    """No message was converted, or the result does not meet the requirements; nothing is written."""


class OutputError(Pc2ScanError):
    """The destination cannot be written (no space, no permission, gone)."""


class DiskFullError(OutputError):
    """A batch ended early, because the disk of its results has no room, or its quota is used up."""

    exit_status = 5


class MessageError(Pc2ScanError):
    """One message cannot be converted; the others can.

    Attributes
    ----------
    reason
        The text without its times: errors with the same reason are counted together. Empty if the text has no times.
    """

    reason: str = ""


class DecodeError(MessageError):
    """A message's bytes contradict its type, or lack what the conversion needs."""


class TransformError(MessageError):
    """There is no transform between two frames at a stamp.

    Attributes
    ----------
    gap_ns
        How far the nearest transform is away, nanoseconds; 0 if that is not why there is none.
    """

    gap_ns: int = 0


class UnconnectedError(TransformError):
    """No transforms connect two frames, at any stamp."""


class UnwritableError(MessageError):
    """The destination's format cannot hold a message's log time or size."""


class RecordingWarning(UserWarning):
    """A recording is damaged, a message cannot be used, or the scans are probably not as intended."""

    def __str__(self) -> str:
        return visible(super().__str__())

"""The table of formats: the properties of each container, and its reader and writer.

A new container is an entry here and a package with its reader and its writer.
"""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.model import MAX_ROSBAG2_NS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from pc2scan.model import Writer

    from .reader import Reader


class Format(NamedTuple):
    """A kind of container.

    Attributes
    ----------
    name
        The name in `Summary.container` and in reports.
    readable
        The name of such a recording in errors.
    open_reader
        Opens a recording: takes its path, and ``strict``, whether damage is an error, which otherwise is in `damage` of
        the reader.
    open_writer
        Starts a recording: takes its path and ``compression``, with `storages` also ``name`` and ``storage``, with
        `profiles` also ``profile``. None if it cannot be a destination by itself.
    magic
        The first bytes of every such file; empty for a directory.
    suffix
        The suffix of such files, in lower case. With ``open_writer``, a destination of such a name gets this format;
        the format with the empty suffix gets all other names.
    to
        The name of the format in the option `to`; empty if it cannot be a destination by itself.
    play
        The command that plays a recording of the format's ``ros_version``, with ``{}`` for its path; empty for none.
    open_storage
        Starts a file of a directory with a compression; returns its writer, and a function that takes the directory's
        metadata as text. None if it is not a storage of a directory.
    storages
        For a directory: the formats that its files may have, the default first.
    written_as
        The format of the destination for a source in this format; empty for the same format.
    compressions
        Its compressions.
    default_compression
        One of these.
    packs_messages
        Whether it compresses every message by itself.
    has_chunks
        Whether messages are in chunks that can be copied as a whole to another file of this format.
    has_extras
        Whether it has attachments and metadata records.
    ros_version
        The ROS version of its messages: 1 or 2.
    profiles
        The names of its profiles, ROS 1's and ROS 2's; empty if it has none. A format that has them holds messages of
        every encoding.
    times_ns
        The first and the last log time that it can store.
    """

    name: str
    readable: str
    open_reader: Callable[..., Reader]
    open_writer: Callable[..., Writer] | None = None
    magic: bytes = b""
    suffix: str = ""
    to: str = ""
    play: str = ""
    open_storage: Callable[[Path, str], tuple[Writer, Callable[[str], None]]] | None = None
    storages: tuple[str, ...] = ()
    written_as: str = ""
    compressions: tuple[str, ...] = ("none",)
    default_compression: str = "none"
    packs_messages: bool = False
    has_chunks: bool = False
    has_extras: bool = False
    ros_version: int = 2
    profiles: tuple[str, ...] = ()
    times_ns: tuple[int, int] = (0, (1 << 64) - 1)

    @property
    def is_directory(self) -> bool:
        """Whether such a recording is a directory, not a file."""
        return not self.magic


def _late(module: str, name: str, /, *args: object, **options: object) -> Any:
    """Call a function of a module, which is imported by the first call, because each format imports its libraries."""
    return getattr(import_module(module, __package__), name)(*args, **options)


_ENTRIES = (
    Format(
        name="rosbag1",
        readable="ROS 1 bag",
        open_reader=partial(_late, ".rosbag1.read", "Rosbag1Reader"),
        open_writer=partial(_late, ".rosbag1.write", "Rosbag1Writer"),
        magic=b"#ROSBAG V2.0\n",
        suffix=".bag",
        to="bag",
        play="rosbag play --clock {}",
        compressions=("none", "bz2", "lz4"),
        default_compression="lz4",
        has_chunks=True,
        ros_version=1,
        times_ns=(0, (1 << 32) * 1_000_000_000 - 1),
    ),
    Format(
        name="rosbag2",
        readable="rosbag2 directory",
        open_reader=partial(_late, ".rosbag2.read", "Rosbag2Reader"),
        open_writer=partial(_late, ".rosbag2.write", "Rosbag2Writer"),
        to="rosbag2",
        play="ros2 bag play {} --clock",
        storages=("mcap", "sqlite3"),
        times_ns=(-MAX_ROSBAG2_NS - 1, MAX_ROSBAG2_NS),
    ),
    Format(
        name="sqlite3",
        readable=".db3 file",
        open_reader=partial(_late, ".rosbag2.sqlite3.read", "Sqlite3Reader"),
        magic=b"SQLite format 3\0",
        suffix=".db3",
        open_storage=partial(_late, ".rosbag2.sqlite3.write", "open_storage"),
        written_as="rosbag2",
        compressions=("none", "zstd"),
        packs_messages=True,
        times_ns=(-MAX_ROSBAG2_NS - 1, MAX_ROSBAG2_NS),
    ),
    Format(
        name="mcap",
        readable="MCAP file",
        open_reader=partial(_late, ".mcap.read", "McapReader"),
        open_writer=partial(_late, ".mcap.write", "McapWriter"),
        magic=b"\x89MCAP0\r\n",
        suffix=".mcap",
        to="mcap",
        play="ros2 bag play -s mcap {} --clock",
        open_storage=partial(_late, ".rosbag2.write", "open_mcap_storage"),
        compressions=("none", "lz4", "zstd"),
        default_compression="zstd",
        has_chunks=True,
        has_extras=True,
        profiles=("ros1", "ros2"),
    ),
)

#: Every format, by its name.
FORMATS = {entry.name: entry for entry in _ENTRIES}


def destinations() -> dict[str, Format]:
    """Return the formats of destinations by their names in the option `to`, in the order of these."""
    named = {entry.to: entry for entry in FORMATS.values() if entry.to}
    return {name: named[name] for name in sorted(named)}


def storages() -> dict[str, Format]:
    """Return the formats of a directory's files, by name."""
    return {name: entry for name, entry in FORMATS.items() if entry.open_storage is not None}


def and_list(names: Sequence[str], word: str = "and") -> str:
    """Return names as a list in a sentence: ``none, lz4 and zstd``."""
    return f" {word} ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))

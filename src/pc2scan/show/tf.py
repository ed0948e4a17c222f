"""The frames of a recording: their parents, times and rates. Their names, and those of topics, for the shell."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from numbers import Integral
from typing import TYPE_CHECKING, ClassVar

from pc2scan.arguments import value_and_type
from pc2scan.bags.opening import open_recordings
from pc2scan.errors import TransformError, leading, stamp_text
from pc2scan.messages.tfmessage import decode_transforms
from pc2scan.result import Part, Result
from pc2scan.text import Table, count
from pc2scan.transforms.placing import FrameOptions
from pc2scan.transforms.reading import read_transforms, tf_connections

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from pc2scan.bags.damage import Damage
    from pc2scan.core.rigid import Rigid
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.frames import FrameInfo, Tree

#: Maximum indentation of the drawing, because a chain may have a million frames, and maximum number of its lines.
_MAX_DEPTH = 60
_MAX_LINES = 500


@dataclass(frozen=True, slots=True, repr=False)
class FrameTree(Result):
    """The frames of a recording.

    Attributes
    ----------
    frames
        Statistics of each child frame.
    trees
        Connected frames; more than one tree means that some frames are disconnected.
    buffer
        For lookups.
    warnings
        Which transforms cannot be used, and why.
    damage
        The damage in the parts of the recordings that were read.
    """

    kind: ClassVar[str] = "frames"
    json_names: ClassVar[tuple[str, ...]] = ("frames", "trees")

    frames: tuple[FrameInfo, ...]
    trees: tuple[Tree, ...]
    buffer: TransformBuffer
    warnings: tuple[str, ...] = ()
    damage: tuple[Damage, ...] = ()

    def lookup(self, target: str, source: str, stamp_ns: int = 0) -> Rigid:
        """Return the transform that takes points in the frame ``source`` to the frame ``target``.

        Parameters
        ----------
        target, source
            Frame names.
        stamp_ns
            The time, nanoseconds since 1970. Default: the latest time that all frames on the way have.

        Returns
        -------
        Rigid
            Its ``translation`` (metres), ``quaternion`` (x, y, z, w), ``rpy`` (radians), and ``apply`` for points.

        Raises
        ------
        TransformError
            If a frame is unknown, the two are not connected, or the stamp is outside of what is recorded.
        TypeError
            If the stamp is no whole number.
        """
        if not isinstance(stamp_ns, Integral):
            raise TypeError(f"stamp_ns is {value_and_type(stamp_ns)}, it must be a whole number of nanoseconds")
        try:
            return self.buffer.lookup(target, source, int(stamp_ns))
        except TransformError as err:
            # None means the latest time.
            err.stamp_ns = stamp_ns or None
            raise

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield a drawing of each tree, and the table of frames."""
        if not self.frames:
            yield "no transforms"
            return
        for number, tree in enumerate(self.trees, 1):
            if number > 1:
                yield ""
            if len(self.trees) > 1:
                yield f"part {number} of {len(self.trees)}, not connected with the others:"
            yield from _drawing(tree.roots or tree.frames[:1], self.frames)
        yield ""
        columns = ("child", "parent", "kind", "transforms", "Hz", "first", "last", "largest gap")
        yield Table(columns, list(map(_row, self.frames)), left=("child", "parent", "kind", "largest gap"))


def _row(frame: FrameInfo) -> tuple[str, ...]:
    """Return the row of a frame that has a parent."""
    gap_ns, at_ns = frame.largest_gap_ns, frame.largest_gap_at_ns
    kind, rate = "static" if frame.static else "dynamic", "-" if frame.rate_hz is None else f"{frame.rate_hz:.2f}"
    gap = "-" if gap_ns is None or at_ns is None else f"{gap_ns / 1e9:.3f} s after {stamp_text(at_ns)}"
    times = stamp_text(frame.first_ns), stamp_text(frame.last_ns)
    return (frame.child, ", ".join(frame.parents), kind, count(frame.transforms), rate, *times, gap)


@dataclass(frozen=True, slots=True, repr=False)
class Lookup(Result):
    """The transform that takes points in the frame ``source`` to the frame ``target``.

    Attributes
    ----------
    target, source
        The frames.
    stamp_ns
        The time; None for the latest that all frames on the way have.
    translation
        x, y and z, metres.
    rotation
        The quaternion: x, y, z, w.
    rpy
        Roll, pitch and yaw, radians.
    """

    kind: ClassVar[str] = "transform"
    json_names: ClassVar[tuple[str, ...]] = ("target", "source", "stamp_ns", "translation", "rotation", "rpy")

    target: str
    source: str
    stamp_ns: int | None
    translation: list[float]
    rotation: list[float]
    rpy: tuple[float, float, float]
    damage: tuple[Damage, ...] = ()

    def body(self, *, verbose: bool = False) -> Iterator[Part]:
        """Yield translation and rotation."""
        when = "at the latest common time" if self.stamp_ns is None else f"at {stamp_text(self.stamp_ns)}"
        roll, pitch, yaw = (angle + 0.0 for angle in self.rpy)
        yield f"{leading(self.target)} from {self.source} {when}"
        yield "  translation  x {:.6f}  y {:.6f}  z {:.6f} m".format(*self.translation)
        yield "  quaternion   x {:.9f}  y {:.9f}  z {:.9f}  w {:.9f}".format(*self.rotation)
        yield f"  rotation     roll {roll:.6f}  pitch {pitch:.6f}  yaw {yaw:.6f} rad"


def _drawing(roots: Sequence[str], frames: Sequence[FrameInfo]) -> Iterator[str]:
    """Yield a tree as indented lines. It uses a stack, because a hostile tree may be very deep, and ends loops."""
    children: dict[str, list[FrameInfo]] = {}
    for frame in reversed(frames):
        for parent in frame.parents:
            children.setdefault(parent, []).append(frame)
    seen: set[str] = set()
    stack = [(root, 0, "") for root in reversed(roots)]
    for _ in range(_MAX_LINES):
        if not stack:
            return
        name, depth, kind = stack.pop()
        again = name in seen
        yield f"{'  ' * min(depth, _MAX_DEPTH)}{leading(name)}{kind}{' (see above)' if again else ''}"
        if not again:
            seen.add(name)
            below = children.get(name, ())
            stack += [(frame.child, depth + 1, " (static)" if frame.static else "") for frame in below]
    if stack:
        yield "... and more"


def frame_tree(sources: Sequence[Path], options: FrameOptions | None = None) -> FrameTree:
    """Read the transforms of recordings.

    Parameters
    ----------
    sources
        Recordings; their transforms are merged.
    options
        Topics, further recordings and added transforms.

    Raises
    ------
    RecordingError
        If a source cannot be read.
    UsageError
        If several namespaces have transforms and none was given.
    """
    options = options or FrameOptions()
    with ExitStack() as stack:
        readers = open_recordings([*sources, *options.tf_from], stack)
        transforms = read_transforms(readers, options)
        damage = tuple(damage for reader in readers for damage in reader.damage)
    buffer, warnings = transforms.buffer, (*transforms.warnings, *transforms.notes)
    return FrameTree(buffer.infos, buffer.trees, buffer, warnings, damage)


def names_in(path: Path, endings: tuple[str, ...], *, frames: bool) -> Iterator[str]:
    """Yield the topics of a recording, of types with these endings; or its frames, as often as they occur."""
    with ExitStack() as stack:
        (reader,) = open_recordings([path], stack)
        if not frames:
            yield from (own.topic for own in reader.connections if own.ros_type.endswith(endings))
            return
        for message in reader.messages(tf_connections(reader.connections)):
            for parent, child, *_ in decode_transforms(message.data, message.connection.serialization):
                yield from (parent, child)

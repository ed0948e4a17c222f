"""Which frame a message is converted in, and the transforms that take it there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.errors import DecodeError, ParameterError, Pc2ScanError, RecordingError, UsageError
from pc2scan.files.source import opened_text
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from pc2scan.bags.reader import Reader
    from pc2scan.core.rigid import Rigid, TransformRow
    from pc2scan.model import Connection
    from pc2scan.tf.buffer import TransformBuffer

__all__ = [
    "FrameOptions",
    "Frames",
    "Place",
    "StaticTransform",
    "load_static_transforms",
    "read_transforms",
    "recorded_transforms",
    "tf_connections",
]

#: A file of static transforms is a page of text.
_MAX_FILE_BYTES = 1_000_000


@dataclass(frozen=True, slots=True)
class StaticTransform:
    """A transform that holds at any time, added by the user.

    Attributes
    ----------
    parent, child
        Frame names.
    parent_from_child
        Where the child is in the parent.
    """

    parent: str
    child: str
    parent_from_child: Rigid

    @classmethod
    def parse(cls, text: str) -> StaticTransform:
        """Read ``parent child x y z qx qy qz qw`` or ``parent child x y z roll pitch yaw`` (metres, radians).

        Raises
        ------
        UsageError
            If it is neither, or the quaternion is zero.
        """
        words = text.replace(",", " ").split()
        usage = "write 'parent child x y z qx qy qz qw' or 'parent child x y z roll pitch yaw' (metres, radians)"
        if len(words) not in (8, 9):
            raise UsageError(f"{text!r} has {len(words)} words, a static transform has 8 or 9", hint=usage)
        try:
            numbers = [float(word) for word in words[2:]]
        except ValueError as err:
            raise UsageError(f"{text!r} is not a static transform: {err}", hint=usage) from err
        return cls.of(words[0], words[1], numbers[:3], numbers[3:])

    @classmethod
    def of(cls, parent: str, child: str, translation: Sequence[float], rotation: Sequence[float]) -> StaticTransform:
        """Take a translation, and a rotation as x, y, z, w or as roll, pitch, yaw.

        Raises
        ------
        UsageError
            If a name is empty, both are the same, or the numbers are no rotation.
        """
        if not parent or not child or parent.removeprefix("/") == child.removeprefix("/"):
            raise UsageError(f"a static transform needs two frames, not {parent!r} and {child!r}")
        from pc2scan.core.rigid import Rigid  # noqa: PLC0415  # only conversions with transforms pay for it

        try:
            rigid = (
                Rigid.from_rpy(rotation[0], rotation[1], rotation[2], translation)
                if len(rotation) == 3
                else Rigid(rotation, translation)  # type: ignore[arg-type]
            )
        except ParameterError as err:
            raise UsageError(f"static transform from {parent} to {child}: {err.message}") from err
        return cls(parent, child, rigid)

    def row(self, stamp_ns: int) -> TransformRow:
        """As the transform of a TFMessage."""
        return (self.parent, self.child, stamp_ns, *self.parent_from_child.pose)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameOptions:
    """What a conversion is told about frames.

    Attributes
    ----------
    tf_topics
        Where the transforms are; empty means ``/tf`` and ``/tf_static``, or those of the only namespace that has them.
    tf_from
        Further recordings whose transforms count.
    static
        Transforms that the recording lacks.
    source_frame
        Overrides the ``frame_id`` of the messages to convert, where that is wrong or empty.
    write_static
        Whether ``static`` is written to the destination's ``/tf_static``.
    """

    tf_topics: tuple[str, ...] = ()
    tf_from: tuple[Path, ...] = ()
    static: tuple[StaticTransform, ...] = ()
    source_frame: str = ""
    write_static: bool = False

    def __post_init__(self) -> None:
        if self.write_static and not self.static:
            raise UsageError("there is no added transform to write", hint="give one with `static`")


class Place(NamedTuple):
    """Where a message goes: the output's ``frame_id``, and the transform to it (None where it stays)."""

    frame_id: str
    target_from_source: Rigid | None


@dataclass(frozen=True, slots=True)
class Frames:
    """The transforms of a conversion.

    Attributes
    ----------
    target_frame
        Empty where every message stays in its own frame.
    source_frame
        See `FrameOptions`.
    buffer
        None where there is no target frame.
    tolerance_ns
        How far a stamp may lie outside the known transforms.
    """

    target_frame: str = ""
    source_frame: str = ""
    buffer: TransformBuffer | None = None
    tolerance_ns: int = 0

    def place(self, frame_id: str, stamp_ns: int) -> Place:
        """Where a message of this frame and stamp goes.

        Raises
        ------
        TransformError
            If there is no transform to the target frame at the stamp.
        """
        source = self.source_frame or frame_id
        target = self.target_frame
        # Source of the rule: upstream transforms only if the names differ; tf2 strips one leading slash.
        if self.buffer is None or target.removeprefix("/") == source.removeprefix("/"):
            return Place(target or source, None)
        return Place(target, self.buffer.lookup(target, source, stamp_ns, self.tolerance_ns))

    def transform_stamp(self, frame_id: str, stamp_ns: int) -> int:
        """The stamp of the transform that `place` gives, in nanoseconds.

        That is the message's; for a message with the stamp 0, the time that this was looked up for.

        Raises
        ------
        TransformError
            As `place` does.
        """
        if stamp_ns or self.buffer is None:
            return stamp_ns
        return self.buffer.latest_common_ns(self.target_frame, self.source_frame or frame_id)


def tf_connections(connections: Sequence[Connection], topics: Sequence[str] = ()) -> list[Connection]:
    """The connections that carry transforms.

    Parameters
    ----------
    topics
        Names to take; empty means ``/tf`` and ``/tf_static``, or those of the only namespace that has them.

    Raises
    ------
    UsageError
        If a name is not there, or several namespaces have transforms and none was named.
    """
    candidates = [c for c in connections if c.ros_type in TF_TYPES and c.generation is not None]
    names = {c.topic.strip("/") for c in candidates}
    if topics:
        missing = [topic for topic in topics if topic.strip("/") not in names]
        if missing:
            known = ", ".join(f"/{name}" for name in sorted(names)) or "none"
            raise UsageError(f"no transforms on {missing[0]}", hint=f"topics with transforms: {known}")
        wanted = {topic.strip("/") for topic in topics}
        return [c for c in candidates if c.topic.strip("/") in wanted]
    spaces: dict[str, list[Connection]] = {}
    for c in candidates:
        namespace, _, name = c.topic.strip("/").rpartition("/")
        if name in ("tf", "tf_static"):
            spaces.setdefault(namespace, []).append(c)
    if "" in spaces or len(spaces) <= 1:
        return spaces.get("", next(iter(spaces.values()), []))
    raise UsageError(
        f"several robots have transforms: {', '.join(f'/{space}' for space in sorted(spaces))}",
        hint=f"choose one: `tf_topics=/{min(spaces)}/tf` `tf_topics=/{min(spaces)}/tf_static`",
    )


def is_static(topic: str) -> bool:
    """Whether transforms on this topic hold at any time."""
    return topic.rsplit("/", 1)[-1] == "tf_static"


def read_transforms(readers: Iterable[Reader], options: FrameOptions) -> tuple[TransformBuffer, list[str]]:
    """Read every transform of recordings, whatever their place in the file, and the user's own.

    Parameters
    ----------
    readers
        The sources first, then those of ``tf_from``.

    Returns
    -------
    TransformBuffer, list of str
        The transforms, and warnings: transforms that cannot be used, and messages that cannot be decoded.
    """
    from pc2scan.tf.buffer import TransformBuilder  # noqa: PLC0415  # only conversions with transforms pay for it

    builder = TransformBuilder()
    # The user's word comes first: whoever adds a transform does so because the recording's is wrong or lacking.
    builder.add((static.row(0) for static in options.static), static=True)
    overridden = {static.child.removeprefix("/") for static in options.static}
    warnings: dict[str, int] = {}
    for reader in readers:
        connections = tf_connections(reader.connections, options.tf_topics)
        if not connections:
            continue
        for message in reader.messages(connections):
            connection = message.connection
            try:
                rows = decode_transforms(message.data, connection.serialization)
            except DecodeError as err:
                text = f"{connection.topic}: a transform message cannot be decoded: {err.message}"
                warnings[text] = warnings.get(text, 0) + 1
                continue
            if overridden:
                rows = [row for row in rows if row[1].removeprefix("/") not in overridden]
            try:
                builder.add(rows, static=is_static(connection.topic))
            except RecordingError as err:
                err.path, err.topic = reader.path, connection.topic
                raise
    buffer = builder.build()
    told = [f"{text} ({count} times)" if count > 1 else text for text, count in warnings.items()]
    told += [
        f"{r.count} transforms from {r.parent!r} to {r.child!r} are not usable: {r.reason}" for r in buffer.rejections
    ]
    return buffer, told


def recorded_transforms(path: Path) -> Callable[[str, str, int], Rigid]:
    """Read a recording's transforms as a conversion without options does; return the lookup of one at a stamp.

    Returns
    -------
    callable
        ``lookup(target, source, stamp_ns)``; raises TransformError if there is no transform.
    """
    from pc2scan.bags.registry import open_recording  # noqa: PLC0415  # only who has no reader yet pays for it
    from pc2scan.core.params import ProjectionParams  # noqa: PLC0415

    reader = open_recording(path)
    try:
        buffer, _ = read_transforms([reader], FrameOptions())
    finally:
        reader.close()
    tolerance_ns = round(ProjectionParams().transform_tolerance * 1e9)
    return lambda target, source, stamp_ns: buffer.lookup(target, source, stamp_ns, tolerance_ns)


def load_static_transforms(path: Path) -> tuple[StaticTransform, ...]:
    """Read a YAML list of static transforms.

    Each entry is a text as `StaticTransform.parse` reads it, or a mapping of ``parent`` (or ``frame_id``), ``child``
    (or ``child_frame_id``), ``translation: [x, y, z]`` and ``rotation: [qx, qy, qz, qw]`` or
    ``rpy: [roll, pitch, yaw]``.

    Raises
    ------
    UsageError
        If the file cannot be read as that.
    """
    from ruamel.yaml import YAML  # noqa: PLC0415  # heavy
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415

    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise UsageError(f"{path.stat().st_size} bytes are no list of transforms", path=path)
        with opened_text(path) as file:
            document = YAML(typ="safe", pure=True).load(file.read(_MAX_FILE_BYTES))
    except OSError as err:
        raise UsageError(f"cannot be read: {err.strerror}", path=path) from err
    except (YAMLError, UnicodeDecodeError, RecursionError) as err:
        raise UsageError(f"is not YAML: {str(err).splitlines()[0]}", path=path) from err
    if not isinstance(document, list):
        raise UsageError("is not a YAML list of static transforms", path=path)
    transforms = []
    for number, entry in enumerate(document, 1):
        try:
            transforms.append(_static_transform(entry))
        except Pc2ScanError as err:
            raise UsageError(f"entry {number}: {err.message}", path=path, hint=err.hint) from err
    return tuple(transforms)


def _static_transform(entry: Any) -> StaticTransform:
    if isinstance(entry, str):
        return StaticTransform.parse(entry)
    if not isinstance(entry, dict):
        raise UsageError(f"{entry!r} is not a transform")
    known = {"parent", "frame_id", "child", "child_frame_id", "translation", "rotation", "rpy"}
    if unknown := entry.keys() - known:
        raise UsageError(f"unknown key {min(map(str, unknown))!r}", hint=f"known: {', '.join(sorted(known))}")

    def numbers(key: str, count: int) -> list[float]:
        values = entry.get(key, [0.0] * (count - 1) + [float(count == 4)])
        if (
            not isinstance(values, list)
            or len(values) != count
            or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
        ):
            raise UsageError(f"{key} is {values!r}, expected {count} numbers")
        return [float(v) for v in values]

    return StaticTransform.of(
        str(entry.get("parent", entry.get("frame_id", ""))),
        str(entry.get("child", entry.get("child_frame_id", ""))),
        numbers("translation", 3),
        numbers("rpy", 3) if "rpy" in entry else numbers("rotation", 4),
    )

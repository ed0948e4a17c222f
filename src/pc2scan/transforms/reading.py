"""Reads the transforms of recordings, and stores them for processes that share the reading of a recording."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, NamedTuple

from pc2scan.bags.observers import Observer, observe
from pc2scan.bags.topics import by_topic
from pc2scan.core.rigid import difference
from pc2scan.errors import DecodeError, RecordingError, UsageError, name_list
from pc2scan.messages.poses import POSES
from pc2scan.messages.tfmessage import TF_TYPES, decode_transforms
from pc2scan.messages.wire import Cursor
from pc2scan.model import copied_message
from pc2scan.text import counted, did_you_mean

from .builder import TransformBuilder
from .sources import AddedPoses, PoseReading, PoseTopic, add_trajectory, attach, joints_to_add
from .static import StaticTransform, parse_model

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence

    from pc2scan.bags.reader import Reader
    from pc2scan.core.rigid import TransformRow
    from pc2scan.model import Connection, RawMessage
    from pc2scan.progress import Meter

    from .buffer import TransformBuffer
    from .placing import FrameOptions
    from .sources import Trajectory
    from .static import RobotModel

#: Duration, and number of messages, of moving transforms that are read to find the transforms between a robot's frames.
_SOME_NS = 1_000_000_000
_SOME_MESSAGES = 1_000

#: A transform is another one if it differs by this much, metres or radians.
_MOVES = 0.05


def tf_connections(connections: Sequence[Connection], topics: Sequence[str] = ()) -> list[Connection]:
    """Return the connections with transforms.

    Parameters
    ----------
    topics
        Their topics; empty means ``/tf`` and ``/tf_static``, or those of the only namespace that has them.

    Raises
    ------
    UsageError
        If a topic has no transforms, or several namespaces have transforms and no topic is given.
    """
    candidates = [c for c in connections if c.ros_type in TF_TYPES and c.ros_version is not None]
    names = {c.topic.strip("/") for c in candidates}
    if topics:
        missing = [topic for topic in topics if topic.strip("/") not in names]
        if missing:
            known = [f"/{name}" for name in sorted(names)]
            near = did_you_mean(missing[0], known)
            hint = f"{near} topics with transforms: {name_list(known)}".strip()
            raise UsageError(f"no transforms on {missing[0]}", hint=hint)
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


class RecordedTransforms(NamedTuple):
    """The transforms of recordings, with all that a user adds.

    Attributes
    ----------
    buffer
        For lookups.
    warnings
        Transforms that cannot be used, and messages that cannot be decoded.
    notes
        Which transforms come from elsewhere than topics of transforms.
    poses
        Poses of topics and of a file that are among them.
    static
        Static transforms that were added: the user's, and joints of robots' models.
    replaced
        Which recorded transforms the user's replace, and how far they are apart.
    """

    buffer: TransformBuffer
    warnings: list[str]
    notes: list[str]
    poses: tuple[AddedPoses, ...] = ()
    static: tuple[StaticTransform, ...] = ()
    replaced: tuple[str, ...] = ()


class TransformReading:
    """The transforms of recordings, with those that a user adds; while the recordings are read.

    Transforms of one frame may have several sources. Those of `static_tf` replace all others; then come a trajectory
    and topics with poses, which replace the recording's own; a robot's model only adds what is missing.

    Parameters
    ----------
    options
        Their topics, and the transforms to add.

    Attributes
    ----------
    poses
        Those of topics, while they are read.
    """

    def __init__(self, options: FrameOptions) -> None:
        self._options = options
        self._builder = TransformBuilder()
        self._warnings: dict[str, int] = {}
        self._notes: list[str] = []
        self._replaced: dict[str, str] = {}
        self.poses: list[PoseReading] = []
        self._models: list[RobotModel] = [] if options.model is None else [options.model]
        # Added first, so that they replace the recording's: users add transforms because those are wrong or missing.
        self._builder.add((static.row(0) for static in options.static), static=True)
        self._overridden = {static.child.removeprefix("/"): static.row(0) for static in options.static}

    def observers(self, reader: Reader, *, own: bool = True) -> list[Observer[Any]]:
        """Return the observers of all transforms of a recording, anywhere in the files; none if it has none.

        Parameters
        ----------
        own
            Whether it is the recording itself, and not one of ``tf_from``: then it has the requested topics with poses.

        Raises
        ------
        UsageError
            If it is not clear which topics to use.
        TopicError
            If a requested topic does not exist, or has no poses.
        """
        connections = tf_connections(reader.connections, self._options.tf_topics)
        first: dict[str, TransformRow] = {}
        observers: list[Observer[Any]] = []
        if connections:
            observers.append(Observer(connections, copied_message, keep=partial(self.add, reader, first)))
        if own:
            observers += (self._pose_observer(topic, reader) for topic in self._options.odometry)
        if models := _model_connections(reader.connections, self._options):
            observers.append(Observer(models, copied_message, 1, keep=self.add_model))
        return observers

    def _pose_observer(self, request: PoseTopic, reader: Reader) -> Observer[Any]:
        connections = request.connections(reader.connections)
        reading = PoseReading(request, connections)
        self.poses.append(reading)
        return Observer(connections, copied_message, keep=reading.add)

    def supply(self, reader: Reader, needed: Collection[str], *, use: bool = True) -> None:
        """Use topics with poses, unrequested, if they have a needed frame that no transform has.

        Parameters
        ----------
        reader
            The source.
        needed
            Names of frames; empty ones are ignored.
        use
            Whether the poses are used; otherwise a note names the topics.

        Raises
        ------
        RecordingError
            If a recording cannot be read.
        """
        missing = {frame.removeprefix("/") for frame in needed if frame}
        candidates = by_topic(c for c in reader.connections if c.ros_type in POSES and c.ros_version is not None)
        missing -= {frame for pair in self._pairs() for frame in pair}
        if not missing or not candidates:
            return
        trials = {topic: PoseReading(PoseTopic(topic), own) for topic, own in candidates.items()}
        firsts = [Observer(trial.connections, copied_message, 1, keep=trial.add) for trial in trials.values()]
        observe((reader, firsts))
        fitting = []
        for topic, trial in trials.items():
            pairs = ((transform.parent, transform.child) for transform in trial.finish()[0])
            fitting += [(topic, *pair) for pair in pairs if not missing.isdisjoint(pair)][:1]
        for topic, parent, child in fitting:
            # Without the name of the frame that has the poses, the user has to know it.
            is_named = all(POSES[connection.ros_type] for connection in candidates[topic])
            if use and is_named and len(fitting) == 1:
                observe((reader, [self._pose_observer(PoseTopic(topic), reader)]))
                frame = parent if parent in missing else child
                used = f"the poses of {topic} are used ({child} in {parent}), as with `odom_topic={topic}`"
                self._notes.append(f"no transform has the frame {frame}: {used}")
            else:
                value = topic if is_named else f"{topic}:base_link"
                poses = f"{topic} has poses of {child} in {parent}, which are in no transform"
                self._notes.append(f"{poses}: `odom_topic={value}` uses them")

    def _pairs(self) -> Iterator[tuple[str, str]]:
        """Yield the pairs of frames of all sources."""
        yield from self._builder.pairs
        yield from ((joint.parent, joint.child) for model in self._models for joint in model.joints)
        trajectory = self._options.trajectory
        if trajectory is not None:
            yield trajectory.parent, trajectory.child
        for reading in self.poses:
            yield from ((transform.parent, transform.child) for transform in reading.finish()[0])

    def add(self, reader: Reader, first: dict[str, TransformRow], message: RawMessage) -> None:
        """Add the transforms of a message, or count it if it cannot be decoded.

        ``first`` has the first transform of each child frame that the user's transforms replace.
        """
        connection, warnings = message.connection, self._warnings
        try:
            rows = decode_transforms(message.data, connection.serialization)
        except DecodeError as err:
            text = f"{connection.topic}: a transform message cannot be decoded: {err.message}"
            warnings[text] = warnings.get(text, 0) + 1
            return
        if self._overridden:
            for row in rows:
                parent, child, *_ = row
                given = self._overridden.get(child.removeprefix("/"))
                if given and difference(row, first.setdefault(child, row))[0] > _MOVES:
                    warnings[f"`static_tf` replaces the transforms of {child} in {parent}, which move"] = 1
                elif given and max(apart := difference(row, given)) > _MOVES:
                    one = f"of {child} in {parent}, {apart[0]:.2f} m and {math.degrees(apart[1]):.0f} deg away"
                    self._replaced.setdefault(child, f"`static_tf` replaces the recorded transform {one}")
            rows = [row for row in rows if row[1].removeprefix("/") not in self._overridden]
        try:
            self._builder.add(rows, static=connection.is_static)
        except RecordingError as err:
            err.path, err.topic = reader.path, connection.topic
            raise

    def add_model(self, message: RawMessage) -> None:
        """Add the model in a message; a model that cannot be read gives a warning."""
        connection = message.connection
        try:
            text = Cursor(message.data, connection.serialization).string()
            self._models.append(parse_model(text, connection.topic))
        except (DecodeError, UsageError) as err:
            self._warnings[f"{connection.topic}: the robot's model cannot be used: {err.message}"] = 1

    def with_static(self, texts: Iterable[str]) -> TransformBuffer:
        """Return the transforms that can be used, with further static ones, after `finish`."""
        self._builder.add((StaticTransform.parse(text).row(0) for text in texts), static=True)
        return self._builder.build()

    def finish(self) -> RecordedTransforms:
        """Return the transforms, with warnings: those that cannot be used, and messages that cannot be decoded."""
        builder, notes, static = self._builder, [*self._notes], [*self._options.static]
        texts = [f"{text} ({count} times)" if count > 1 else text for text, count in self._warnings.items()]
        if self._models:
            joints = [*joints_to_add(self._models, builder.pairs)]
            static += joints
            builder.add((joint.row(0) for joint in joints), static=True)
            if joints:
                shown = name_list([f"{joint.child} in {joint.parent}" for joint in joints], 5)
                names = name_list([model.name for model in self._models])
                are = "is" if len(joints) == 1 else "are"
                notes.append(f"{counted(len(joints), 'fixed joint')} of {names} {are} used: {shown}")
        poses: tuple[AddedPoses, ...] = ()
        if self.poses or self._options.trajectory is not None:
            poses, further = self._add_poses(notes)
            texts += further
        buffer = builder.build()
        texts += [
            f"{counted(r.count, 'transform')} from {r.parent!r} to {r.child!r} not usable: {r.reason}"
            for r in buffer.rejections
        ]
        return RecordedTransforms(buffer, texts, notes, poses, tuple(static), tuple(self._replaced.values()))

    def _add_poses(self, notes: list[str]) -> tuple[tuple[AddedPoses, ...], list[str]]:
        """Add poses as transforms; return them and warnings, and append notes."""
        sources: list[tuple[str, PoseReading | None, Sequence[Trajectory]]] = []
        texts: list[str] = []
        for reading in self.poses:
            own_poses, further = reading.finish()
            if not own_poses:
                raise RecordingError("has no poses", topic=reading.topic)
            texts += further
            sources.append((reading.topic, reading, own_poses))
        if (given := self._options.trajectory) is not None:
            sources.append((given.name, None, [given]))
        added = []
        for name, own, trajectories in sources:
            attachments = {}
            for trajectory in trajectories:
                where = attach(self._builder.build(), trajectory.parent, trajectory.child)
                if where.frame in self._overridden:
                    texts.append(f"`static_tf` replaces the poses of {where.frame} from {name}")
                    continue
                replaced = self._builder.parents_of(where.replaced)
                self._builder.remove(where.replaced)
                add_trajectory(self._builder, trajectory, where)
                attachments[trajectory.parent, trajectory.child] = where
                if where.frame != trajectory.child:
                    notes.append(
                        f"{trajectory.child}, which has the poses of {name}, is fixed to {where.frame}: "
                        "they become its poses"
                    )
                notes += (f"{name} replaces the transforms of {frame} in {old}" for frame, old in replaced.items())
            added.append(AddedPoses(name, own, trajectories, attachments))
        return tuple(added), texts


def _model_connections(connections: Sequence[Connection], options: FrameOptions) -> list[Connection]:
    """Return the connections of the robot's model, beside the transforms; none if there are several robots'."""
    if options.model is not None:
        return []
    models = [c for c in connections if c.topic.rsplit("/", 1)[-1] == "robot_description" and c.ros_version is not None]
    models = [c for c in models if c.ros_type == "std_msgs/msg/String"]
    spaces = {c.topic.strip("/").rpartition("/")[0] for c in models}
    if len(spaces) > 1:
        namespaces = {topic.strip("/").rpartition("/")[0] for topic in options.tf_topics or ("/tf",)}
        models = [c for c in models if c.topic.strip("/").rpartition("/")[0] in namespaces]
    return models


def read_transforms(
    readers: Sequence[Reader],
    options: FrameOptions,
    *,
    needed: Collection[str] = (),
    meter: Meter | None = None,
) -> RecordedTransforms:
    """Read all transforms of recordings, anywhere in the files, and add the user's own.

    Parameters
    ----------
    readers
        The source first, then the recordings of ``tf_from``.
    needed
        Frames that are needed; see `TransformReading.supply`.
    meter
        Counts the bytes; None: nothing is reported.
    """
    reading = TransformReading(options)
    observe(*((reader, reading.observers(reader, own=reader is readers[0])) for reader in readers), meter=meter)
    if needed:
        reading.supply(readers[0], needed)
    return reading.finish()


class RobotTransforms:
    """The transforms between a robot's frames: the static ones, and a second of the moving ones, or several.

    Parameters
    ----------
    reader
        The recording.
    options
        The topics, and the transforms to add.
    times_ns
        The log times at which the seconds begin.
    poses
        The only topic with odometry, if there is one: it is used if no transform moves the frame that has the poses.

    Attributes
    ----------
    observers
        Take them from the recording; none if it is not clear which topics to use.
    reading
        The transforms, once `finish` has added them.
    odometry
        The topic with poses that is used; empty if none is.
    """

    def __init__(
        self, reader: Reader, options: FrameOptions, times_ns: Sequence[int], poses: Sequence[Connection] = ()
    ) -> None:
        self._reader = reader
        # Poses are about where the robot is, not about its frames.
        self.reading = TransformReading(replace(options, trajectory=None))
        self._poses = PoseReading(PoseTopic(""), poses)
        self.odometry = ""
        connections: list[Connection] = []
        with suppress(UsageError):
            connections = [*tf_connections(reader.connections, options.tf_topics), *poses]
        static, moving = (
            [connection for connection in connections if connection.is_static is kind] for kind in (True, False)
        )
        firsts = (static, _SOME_MESSAGES), (_model_connections(reader.connections, options), 1)
        self.observers = [Observer(own, copied_message, most) for own, most in firsts if own]
        times_ns = sorted(set(times_ns)) if moving else []
        for begin_ns, next_ns in zip_longest(times_ns, times_ns[1:], fillvalue=2**63):
            end_ns = min(begin_ns + _SOME_NS, next_ns)
            self.observers.append(Observer(moving, copied_message, _SOME_MESSAGES, begin_ns, end_ns))

    @property
    def is_cut(self) -> bool:
        """Whether one of the seconds may have more messages than were taken."""
        return any(len(observer.values) >= _SOME_MESSAGES for observer in self.observers)

    def finish(self) -> TransformBuffer | None:
        """Return the transforms; None if there are none, or it is not clear which ones to use."""
        for message in (value for observer in self.observers for value in observer.values):
            with suppress(RecordingError):
                if message.connection.ros_type in TF_TYPES:
                    self.reading.add(self._reader, {}, message)
                elif message.connection.ros_type in POSES:
                    self._poses.add(message)
                else:
                    self.reading.add_model(message)
        buffer = self.reading.finish().buffer
        children = {trajectory.child for trajectory in self._poses.finish()[0]}
        children.intersection_update(buffer.frames or children)
        if children and all(buffer.is_rigid(above, child) for child in children for above in buffer.above(child)):
            self.odometry = self._poses.topic
            self.reading.poses.append(self._poses)
            buffer = self.reading.finish().buffer
        return buffer if len(buffer) else None


def read_robot_transforms(reader: Reader, options: FrameOptions, time_ns: int) -> TransformBuffer | None:
    """Read the transforms between a robot's frames; see `RobotTransforms`."""
    robot = RobotTransforms(reader, options, [time_ns])
    observe((reader, robot.observers))
    return robot.finish()

"""Level scans: where the direction of up comes from, and the writer of the level frames' transforms."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pc2scan.bags.latching import is_static
from pc2scan.messages.definitions import definition
from pc2scan.messages.tfmessage import encode_transforms
from pc2scan.model import NEW_ID, TF_QOS, Connection
from pc2scan.tf.imu import ImuRequest, UpEstimate, read_up
from pc2scan.tf.reading import tf_connections
from pc2scan.tf.up_sources import UpByFrame, UpByImu

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Writer
    from pc2scan.tf.buffer import TransformBuffer
    from pc2scan.tf.options import FrameOptions
    from pc2scan.tf.placing import LevelTransform
    from pc2scan.tf.up_sources import UpSource

    from .report import Report
    from .scan_spec import ScanSpec
    from .topic_report import TopicReport

_TFMESSAGE = "tf2_msgs/msg/TFMessage"


class UpSources:
    """The source of the direction of up, for each level output. Each IMU is read once.

    Parameters
    ----------
    readers
        The sources first, then the recordings of ``tf_from``.
    buffer
        Their transforms.
    report
        Gets notes about what was measured.
    """

    def __init__(self, readers: Sequence[Reader], buffer: TransformBuffer, report: Report) -> None:
        self._readers = readers
        self._buffer = buffer
        self._report = report
        self._measured: dict[ImuRequest, UpEstimate] = {}
        self._sources: dict[tuple[str, str, int], UpSource] = {}

    def of(self, spec: ScanSpec, tolerance_ns: int) -> UpSource:
        """Return the source for one output; outputs with the same options share one object.

        Raises
        ------
        UsageError
            If the messages of an IMU do not show the direction of up.
        """
        key = (spec.fixed_frame, spec.imu, tolerance_ns)
        if key not in self._sources:
            self._sources[key] = (
                self._by_imu(ImuRequest.parse(spec.imu), tolerance_ns)
                if spec.imu
                else UpByFrame(spec.fixed_frame, self._buffer, tolerance_ns)
            )
        return self._sources[key]

    def _by_imu(self, request: ImuRequest, tolerance_ns: int) -> UpSource:
        found = self._measured.get(request)
        if found is None:
            found = self._measured[request] = read_up(self._readers, request)
            self._report.notes += found.notes
            self._report.warnings += found.warnings
        return UpByImu(found.topic, found.frame, found.stamps_ns, found.directions, self._buffer, tolerance_ns)


def tf_connection(reader: Reader, frames: FrameOptions, target: Destination) -> Connection:
    """Return the connection of the level frames: one more publisher of the topic that has the moving transforms."""
    moving = [c for c in tf_connections(reader.connections, frames.tf_topics) if not is_static(c.topic)]
    first = moving[0] if moving else None
    if first is not None and first.ros_version == target.ros_version and first.definition.data:
        # ROS 1 has two types with the same layout; all publishers of a topic have the same type.
        msgtype, text, digest = first.msgtype, first.definition, first.digest
    else:
        msgtype = _TFMESSAGE
        text, digest = definition(msgtype, target.ros_version)
    return Connection(
        id=NEW_ID,
        topic="/tf" if first is None else first.topic,
        msgtype=msgtype,
        serialization=target.serialization,
        definition=text,
        digest=digest,
        callerid="/pc2scan" if target.ros_version == 1 else None,
        qos=TF_QOS if target.ros_version == 2 else "",
    )


@dataclass(slots=True)
class LevelFrames:
    """Writes the transforms of the level frames.

    Attributes
    ----------
    handle
        The writer's handle of `tf_connection`.
    serialization
        The serialisation of the destination.
    report
        The report's entry that counts them.
    """

    handle: int
    serialization: str
    report: TopicReport
    _written: set[tuple[str, int]] = field(default_factory=set)

    def write(self, level: LevelTransform, log_time_ns: int, publish_time_ns: int, writer: Writer) -> None:
        """Write the transform of a scan, unless it was written for another scan of the same frame and stamp.

        Raises
        ------
        UnwritableError
            If the destination cannot store it.
        """
        _, name, stamp_ns, *_ = level.row
        if (name, stamp_ns) not in self._written:
            data = encode_transforms([level.row], self.serialization)
            writer.write(self.handle, log_time_ns, data, publish_time_ns)
            self._written.add((name, stamp_ns))
            self.report.messages_out += 1

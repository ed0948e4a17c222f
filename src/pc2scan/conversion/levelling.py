"""Level scans: where the direction of up comes from, and the writer of the level frames' transforms."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pc2scan.messages.definitions import definition
from pc2scan.messages.tfmessage import encode_transforms
from pc2scan.model import NEW_ID, TF_QOS, Connection
from pc2scan.transforms.reading import tf_connections
from pc2scan.transforms.up_sources import UpByFrame, UpByImu

if TYPE_CHECKING:
    from pc2scan.advice.survey import Survey
    from pc2scan.bags.destinations import Destination
    from pc2scan.bags.reader import Reader
    from pc2scan.model import Writer
    from pc2scan.request.options import ScanSpec
    from pc2scan.transforms.buffer import TransformBuffer
    from pc2scan.transforms.imu import UpEstimate
    from pc2scan.transforms.placing import FrameOptions, LevelTransform
    from pc2scan.transforms.up_sources import UpSource

    from .report import TopicReport

TFMESSAGE = "tf2_msgs/msg/TFMessage"


def up_source(spec: ScanSpec, buffer: TransformBuffer, survey: Survey) -> tuple[UpSource, UpEstimate | None]:
    """Return the source of the direction of up for a level output, and the estimate by its IMU; None without one.

    Raises
    ------
    UsageError
        If the messages of an IMU do not show the direction of up.
    """
    tolerance_ns, request = spec.params.tolerance_ns, spec.imu_request
    if request is None:
        return UpByFrame(spec.fixed_frame, buffer, tolerance_ns), None
    up = survey.imu(request.topic).up(request.frame)
    return UpByImu(up.topic, up.frame, up.stamps_ns, up.directions, buffer, tolerance_ns), up


def tf_connection(reader: Reader, frames: FrameOptions, target: Destination) -> Connection:
    """Return the connection of new transforms: one more publisher of the topic that has the moving ones."""
    moving = [c for c in tf_connections(reader.connections, frames.tf_topics) if not c.is_static]
    first = moving[0] if moving else None
    if first is not None and first.ros_version == target.ros_version and first.definition.data:
        # ROS 1 has two types with the same layout; all publishers of a topic have the same type.
        msgtype, text, digest = first.msgtype, first.definition, first.digest
    else:
        msgtype = TFMESSAGE
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
    serialization
        The serialisation of the destination.
    report
        The report's entry that counts them.
    handle
        The writer's handle of `tf_connection`.
    """

    serialization: str
    report: TopicReport
    handle: int = -1
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

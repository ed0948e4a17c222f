"""What is converted, and how: topics, points, frames, motion, and what a recording has besides the scans.

No ``from __future__ import annotations`` here: see `pc2scan.options.table`.
"""

from typing import Annotated, Any, Literal, TypedDict

from .option import Channels, File, Frame, How, Names, Paths, Period, Quantity, Scope, Section, Transforms, When, group
from .values import CHANNELS, FILTERS, RECORDINGS, SHARE, TRANSFORMS, duration, number, text, texts


@group(Section.TOPICS, Scope.SINGLE)
class SourceTopics(TypedDict, total=False):
    """Which topics are converted."""

    topics: Annotated[
        Names | None,
        texts("IN[:=OUT]", offers=("topics", "/PointCloud2", "/LaserScan")),
        "Cloud topic to convert, and the topic of its scans. Default: every topic with PointCloud2 or Livox's "
        "messages; the scans of a single topic are on /scan, of several on <topic>/scan.",
        How(typed="--topic", short="-t"),
    ]


@group(Section.TOPICS, Scope.CONVERSION)
class TimeRange(TypedDict, total=False):
    """What is read of a recording, and how."""

    start: Annotated[
        When,
        "Start time: seconds from the beginning, @seconds since 1970, or a date and time (ISO 8601). Messages that "
        "are latched then, and static transforms, are written at the start.",
    ]
    end: Annotated[When, "End time (exclusive), written like `start`."]
    strict: Annotated[
        bool,
        "End with an error at the first damage of a source, and at the first message that cannot be converted. "
        "Otherwise all that is readable is converted, the rest is listed, and the exit status is 3.",
        How(panel=Section.RUN),
    ]


@group(Section.TOPICS, Scope.CONVERSION)
class StampCorrection(TypedDict, total=False):
    """Lidars whose clock is not the recording's."""

    stamps: Annotated[
        Literal["header", "log"],
        "The stamps of converted messages: those of their headers, or their log times, for a lidar without a sound "
        "clock. Kept clouds and the points' own times are corrected, too.",
    ]
    time_offset: Annotated[
        Names | None,
        texts("[TOPIC=]S|auto"),
        "Add this to the stamps of converted messages, for a lidar on its own clock: 3.2s, -37s. auto: measure it "
        "against the transforms, or the log times. For one topic: /rear=0.12s; for the poses in a file: "
        "trajectory=0.5s.",
    ]


@group(Section.TOPICS, Scope.CONVERSION)
class CloudUnit(TypedDict, total=False):
    """Clouds in another unit than metres."""

    cloud_scale: Annotated[
        float,
        number("X"),
        "Multiply x, y and z of clouds by this, kept ones too: 0.001 for millimetres, 0.01 for centimetres.",
        How(default=1.0, default_text="1, which is metres"),
    ]


@group(Section.POINTS, Scope.ONE_OUTPUT)
class PointSelection(TypedDict, total=False):
    """Which points and beams are used.

    Filters are applied in this order. Finding the ground comes before the limits of height, because it needs the points
    that these reject.
    """

    remove: Annotated[
        Names | None,
        texts("BEAMS", words=("shadows", "speckles")),
        "Remove beams: shadows (returns between an edge and the surface behind it), or speckles as laser_filters finds "
        "them.",
    ]
    where: Annotated[
        Names | None,
        texts("CONDITION"),
        "Use only points whose fields fulfil this condition: 'ring in (3, 4, 5) and intensity > 10'. Fields, numbers,"
        " < <= > >= == != in, and or not, + - * / %, abs(). With several, all must hold.",
    ]
    exclude_box: Annotated[
        Names | None,
        texts("BOX"),
        "Reject points in this box, such as the robot's own body: 'frame x0 x1 y0 y1 z0 z1' (m).",
    ]
    exclude_polygon: Annotated[
        Names | None,
        texts("POLYGON"),
        "Reject points in this polygon, at any height, such as the robot's footprint: 'frame x0 y0 x1 y1 x2 y2 ...' "
        "(m).",
    ]
    ground: Annotated[
        Literal["keep", "remove"],
        "remove: reject points on the ground, which is found in each cloud; it may slope by up to 15 degrees and have"
        " kerbs. Needs a frame of the robot whose z axis points up.",
    ]
    min_height_slope: Annotated[
        float | None,
        number("M/M"),
        "Reject points below `min_height` + this * range, for ramps and rough ground. 0.05 is about 3 degrees.",
    ]
    filters: Annotated[
        Any,
        FILTERS,
        "Further filters of points, as objects.",
        How(panel=Section.PYTHON, typed="", scope=Scope.SINGLE),
    ]


@group(Section.FRAMES, Scope.CONVERSION)
class StaticTransforms(TypedDict, total=False):
    """Added transforms."""

    static_tf: Annotated[
        Transforms | None,
        TRANSFORMS,
        "Add a transform: 'parent child x y z qx qy qz qw' or 'parent child x y z roll pitch yaw' (m, rad; or 20cm, "
        "90deg); or the YAML file with a list of such transforms, *.yaml. Replaces the recording's transform to this "
        "child.",
    ]


@group(Section.FRAMES, Scope.CONVERSION)
class TransformInputs(TypedDict, total=False):
    """What gives transforms: topics, poses, and a robot's model."""

    tf_topics: Annotated[
        Names | None,
        texts("TOPIC", offers=("topics", "/TFMessage", "/tfMessage")),
        "Topic of the transforms, if not /tf and /tf_static.",
        How(typed="--tf-topic"),
    ]
    odom_topic: Annotated[
        Names | None,
        texts(
            "TOPIC[:FRAME]",
            offers=("topics", "/Odometry", "/TransformStamped", "/PoseStamped", "/PoseWithCovarianceStamped"),
        ),
        "Use the poses of this topic as transforms: nav_msgs/Odometry, TransformStamped, PoseStamped or "
        "PoseWithCovarianceStamped. FRAME: whose poses they are, if the messages name none or a wrong one: "
        "/pose:base_link; both frames: /pose:map:base_link.",
    ]
    trajectory: Annotated[
        File,
        "Use the poses of this file as transforms: TUM (stamp x y z qx qy qz qw). Needs `trajectory_frames`.",
    ]
    trajectory_frames: Annotated[
        str,
        text("PARENT:CHILD"),
        "The frames of `trajectory`: the poses are those of CHILD in PARENT (odom:base_link, map:velodyne).",
    ]
    urdf: Annotated[
        File,
        "The robot's model, whose fixed joints are static transforms; those of the recording have precedence.",
        How(default_text="the recording's /robot_description"),
    ]


@group(Section.FRAMES, Scope.CONVERSION)
class TransformSources(TransformInputs, total=False):
    """Where transforms come from."""

    tf_from: Annotated[Paths | None, RECORDINGS, "Read the transforms of this recording too."]


@group(Section.FRAMES, Scope.CONVERSION)
class SourceFrame(TypedDict, total=False):
    """The frame of messages."""

    source_frame: Annotated[Frame, "Frame of the messages to convert, if their frame_id is wrong or empty."]


class ConversionFrames(StaticTransforms, TransformSources, SourceFrame, total=False):
    """Frames and transforms of a conversion."""


@group(Section.MOVING, Scope.ONE_OUTPUT)
class RobotMotion(TypedDict, total=False):
    """The robot's motion."""

    deskew: Annotated[
        bool,
        "Transform each point of a cloud with the pose at its own time, through `fixed_frame`. With `reverse`, each "
        "beam of a scan; that needs a `target_frame` such as odom.",
    ]
    fixed_frame: Annotated[
        Frame,
        "A frame that does not move, such as odom; the robot's motion in it is corrected. For `level`, its z axis "
        "points up.",
    ]
    point_time: Annotated[
        str,
        text("FIELD[:UNIT]"),
        "Field with the points' times, relative to the stamp or absolute; unit: s, ms, us, ns. Without such a field: "
        "azimuth, which measures how the lidar turns; or azimuth:0.1 with the time of a turn (s), then :cw or :ccw, "
        "and :start or :end: the stamp is that of the first or last point.",
        How(default_text="t, time, timestamp, time_stamp or offset_time"),
    ]
    stamp: Annotated[
        Literal["header", "start", "middle", "end"],
        "The time of a deskewed scan: the cloud's stamp, or the start, middle or end of its points' times.",
    ]
    level: Annotated[
        bool,
        "Make scans in a frame without the roll and pitch of the target frame, which come from `fixed_frame` or "
        "`imu`. It has the target frame's name with _stabilized appended, and is written to /tf.",
    ]
    imu: Annotated[
        str,
        text("TOPIC[:FRAME]", offers=("topics", "/Imu")),
        "sensor_msgs/Imu topic from which `level` takes roll and pitch; and the IMU's frame, if its frame_id is wrong"
        " or empty.",
    ]


@group(Section.MOVING, Scope.ONE_OUTPUT)
class CloudCombination(TypedDict, total=False):
    """Scans of several messages."""

    window: Annotated[
        Period | None,
        duration("S"),
        "How far the stamps of the other topics may be from those of the first one.",
        How(default_text="half the median period"),
    ]
    accumulate: Annotated[
        Period | None,
        duration("S|Nclouds"),
        "Make each scan of all points of the last S seconds (1, 500ms), or of the last N clouds (10clouds).",
    ]
    every: Annotated[Period | None, duration("S"), "Make one scan every S seconds, instead of one for each cloud."]
    rebin: Annotated[bool, "Convert LaserScan to LaserScan: with other beams, in another frame, or several into one."]


@group(Section.TOPICS, Scope.ONE_OUTPUT)
class EchoChoice(TypedDict, total=False):
    """Which of several echoes is used."""

    echo: Annotated[
        Literal["first", "last", "strongest"],
        "Which echo of each beam of a MultiEchoLaserScan is used; strongest: the one with the highest intensity.",
    ]


@group(Section.REVERSE, Scope.SINGLE)
class Reversal(TypedDict, total=False):
    """Whether scans are converted to clouds."""

    reverse: Annotated[bool, "Convert LaserScan to PointCloud2, as laserscan_to_pointcloud does."]


@group(Section.REVERSE, Scope.SINGLE)
class CloudContent(Reversal, total=False):
    """What the clouds of scans have."""

    channels: Annotated[
        Channels | None,
        CHANNELS,
        "Add these fields to the cloud: distances, stamps, viewpoint.",
        How(typed="--channel"),
    ]


@group(Section.TOPICS, Scope.CONVERSION)
class OtherTopics(TypedDict, total=False):
    """What a recording has besides the scans."""

    keep: Annotated[
        Names | None,
        texts("TOPIC", offers=("topics",)),
        "Copy only these of the topics that are not converted (names or globs).",
    ]
    drop: Annotated[Names | None, texts("TOPIC", offers=("topics",)), "Do not write these topics (names or globs)."]
    keep_clouds: Annotated[bool, "Write the converted clouds too."]
    clouds_as: Annotated[
        Literal["recorded", "pointcloud2"],
        "pointcloud2: write the clouds of all types as PointCloud2 and, without `keep_clouds`, make no scans. Livox's "
        "have the fields of its driver (x y z intensity tag line timestamp).",
    ]
    only_scans: Annotated[bool, "Write only the scans."]
    keep_used: Annotated[
        str,
        text("TOPIC"),
        "Also write the points that give the scan its ranges, to this topic: PointCloud2 with all their fields and "
        "the beam's number.",
        How(panel=Section.POINTS, scope=Scope.ONE_OUTPUT),
    ]
    write_static_tf: Annotated[bool, "Write the added static transforms to /tf_static.", How(panel=Section.FRAMES)]


@group(Section.RUN, Scope.CONVERSION)
class FailureConditions(TypedDict, total=False):
    """When a run fails."""

    fail_on: Annotated[
        Literal["", "empty", "warning"],
        "Fail and write nothing. empty: if a scan has no return; warning: if there is any warning, skipped message or"
        " damage.",
    ]
    min_used: Annotated[
        Quantity,
        SHARE,
        "Fail and write nothing if less than this share of a topic's points is used in its scans: 0.05 or 5%.",
        How(default=0.0),
    ]

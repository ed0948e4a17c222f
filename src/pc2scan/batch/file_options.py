"""The options that a dataset file may have: their types, descriptions, and the JSON schema that is made of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pc2scan.bags.formats import FORMATS, destinations
from pc2scan.core.presets import PRESETS
from pc2scan.pipeline.parameters import PARAMETERS
from pc2scan.pipeline.scans_file import OUTPUT_KEYS
from pc2scan.pipeline.stages.filter_options import FILTER_OPTIONS

__all__ = ["FILE_OPTIONS", "FileOption", "schema"]


@dataclass(frozen=True, slots=True)
class FileOption:
    """An option in a dataset file.

    Attributes
    ----------
    kind
        ``flag``, ``number``, ``text``, ``texts`` (one or a list), ``path`` or ``paths``; ``value`` is a number or text.
    what
        A description.
    choices
        Allowed values; empty if any value is allowed.
    """

    kind: str
    what: str
    choices: tuple[str, ...] = ()


def _parameter_options() -> dict[str, FileOption]:
    kinds = {"bool": "flag", "str": "text"}
    return {
        name: FileOption(
            kinds.get(parameter.kind, "value"),
            parameter.help.replace("`", "") + (f" Unit: {parameter.unit}." if parameter.unit else ""),
            parameter.words if parameter.kind == "str" else (),
        )
        for name, parameter in PARAMETERS.items()
    }


def _as_in_scans_file(name: str) -> FileOption:
    key = OUTPUT_KEYS[name]
    return FileOption("value" if key.kind == "time" else key.kind, key.help, key.words)


#: Every option of a conversion that a dataset file may have.
FILE_OPTIONS: dict[str, FileOption] = {
    "topics": FileOption("texts", "Topics to convert, and the topics of their scans: /points:=/scan."),
    "keep": FileOption("texts", "Write only these of the topics that are not converted (names or globs)."),
    "drop": FileOption("texts", "Do not write these topics (names or globs)."),
    "keep_clouds": FileOption("flag", "Write the converted clouds too."),
    "remove": _as_in_scans_file("remove"),
    "keep_used": FileOption("text", "Write the points that the scan's beams read to this topic too."),
    "only_scans": FileOption("flag", "Write only the scans."),
    "start": FileOption("value", "Start time: seconds from the beginning, @seconds since 1970, or a date and time."),
    "end": FileOption("value", "End time (exclusive), in the form of start."),
    "scans": FileOption(
        "path", "A file with several outputs, each with its own options. Relative to the dataset file."
    ),
    "level": FileOption("flag", "Make scans in a frame without roll and pitch, by fixed_frame or imu."),
    "imu": _as_in_scans_file("imu"),
    "params_file": FileOption("path", "A ROS parameter file or an XML launch file. Relative to the dataset file."),
    "launch_args": FileOption("texts", "Arguments of the launch file: name:=value."),
    "node": FileOption("text", "The node whose parameters are read from the parameter file or the launch file."),
    "param": FileOption("texts", "Parameters in ROS notation: name:=value."),
    "remap": FileOption("texts", "Remappings in ROS notation: cloud_in:=/points."),
    "preset": FileOption("text", "Parameters that suit a consumer of the scans.", tuple(PRESETS)),
    **{name: _as_in_scans_file(name) for name in FILTER_OPTIONS},
    "static_tf": FileOption("texts", "Add transforms: parent child x y z roll pitch yaw."),
    "static_tf_file": FileOption("path", "A YAML list of such transforms. Relative to the dataset file."),
    "write_static_tf": FileOption("flag", "Write the added transforms to /tf_static."),
    "tf_from": FileOption("paths", "Read transforms from these recordings too. Relative to the dataset file."),
    "tf_topics": FileOption("texts", "Topics of the transforms, if not /tf and /tf_static."),
    "source_frame": FileOption("text", "Frame of the messages to convert, if their own frame_id is wrong or empty."),
    "deskew": FileOption("flag", "Transform each point of a cloud by the pose at its own time, through fixed_frame."),
    **{name: _as_in_scans_file(name) for name in ("fixed_frame", "point_time", "stamp")},
    "lead": FileOption("text", "If several topics become one scan: the topic whose stamps it has. Default: the first."),
    "window": FileOption(
        "value", "Maximum difference between its stamp and those of the others. Default: half the median period."
    ),
    **{name: _as_in_scans_file(name) for name in ("accumulate", "every")},
    "rebin": FileOption("flag", "Convert LaserScan to LaserScan."),
    "reverse": FileOption("flag", "Convert LaserScan to PointCloud2."),
    "channels": FileOption("texts", "With reverse: further fields of clouds.", ("distances", "stamps", "viewpoint")),
    "range_cutoff": FileOption("number", "With reverse: keep only returns nearer than this, in metres."),
    "on_error": FileOption("text", "What to do if a message cannot be converted.", ("skip", "fail")),
    "fail_on": FileOption("text", "Fail if a scan has no return, or for any warning.", ("empty", "warning")),
    "min_used": FileOption("number", "Fail if less than this share of a topic's points, 0 to 1, is in its scans."),
    "verify": FileOption("flag", "Compare the CRCs of MCAP files."),
    "strict": FileOption("flag", "Refuse damaged recordings."),
    "export": FileOption(
        "text",
        "Export scans or clouds, instead of writing recordings.",
        ("npz", "csv", "tum", "carmen", "flaser", "pcd", "kitti"),
    ),
    "pose_frame": FileOption("text", "With export: write the robot's pose in this frame (odom, map) at each stamp."),
    "base_frame": FileOption("text", "With export: the frame of the robot, whose pose is written."),
    "odom_topic": FileOption("text", "With export: take the poses from this nav_msgs/Odometry topic."),
    "to": FileOption("text", "Format of the output. Default: that of the source.", tuple(destinations())),
    "storage": FileOption("text", "Storage of a rosbag2 directory.", FORMATS["rosbag2"].storages),
    "compression": FileOption("text", "Compression of the output.", ("none", "lz4", "zstd", "bz2")),
    "profile": FileOption("text", "ROS version of an .mcap file.", ("ros1", "ros2")),
    "metadata_version": FileOption("number", "Version of a rosbag2 directory's metadata.yaml, 8 or 9."),
    "split": FileOption("text", "Split the output into several files, by time (60s, 10min) or size (500MB, 1GiB)."),
    "repeat_latched": FileOption("flag", "With split: repeat latched messages and static transforms in each file."),
    "ros_distro": FileOption("text", "ROS distribution whose message definitions are used if the recording has none."),
    **_parameter_options(),
}

_TYPES: dict[str, Any] = {
    "flag": {"type": "boolean"},
    "number": {"type": "number"},
    "value": {"type": ["number", "string"]},
    "text": {"type": "string"},
    "path": {"type": "string"},
}


def _type_of(option: FileOption) -> dict[str, Any]:
    if option.kind in ("texts", "paths"):
        item = {"type": "string"} | ({"enum": list(option.choices)} if option.choices else {})
        kind: dict[str, Any] = {"anyOf": [item, {"type": "array", "items": item}]}
    else:
        kind = _TYPES[option.kind] | ({"enum": list(option.choices)} if option.choices else {})
    return {"description": option.what, **kind}


def schema() -> dict[str, Any]:
    """Return the JSON schema of dataset files."""
    options = {name: _type_of(option) for name, option in FILE_OPTIONS.items()}
    texts = {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}, "minItems": 1}]}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Dataset file of pc2scan batch",
        "type": "object",
        "additionalProperties": False,
        "properties": {
            "defaults": {
                "description": "Options for all recordings.",
                "type": ["object", "null"],
                "additionalProperties": False,
                "properties": options,
            },
            "recordings": {
                "description": "Options for some recordings. All entries that match count; a later one overrides an "
                "earlier one, and all of them the defaults.",
                "type": ["array", "null"],
                "items": {
                    "type": "object",
                    "required": ["match"],
                    "additionalProperties": False,
                    "properties": {
                        "match": {
                            "description": "Globs of recordings, relative to the folder that is searched. Without a "
                            "slash, a name in any folder; ** is any number of folders.",
                            **texts,
                        },
                        "skip": {"description": "Do not convert these recordings.", "type": "boolean"},
                        **options,
                    },
                },
            },
        },
    }

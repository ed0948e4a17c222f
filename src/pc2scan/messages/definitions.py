"""The definitions of the messages that pc2scan writes, with their md5sums and RIHS01 hashes.

The texts are ROS's own, comments included, as its recorders store them (see ``NOTICE``): ``ros1.msg`` as
genmsg's ``gendeps --cat`` prints it, ``ros2.msg`` as rosbag2's MCAP recorder concatenates it.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from pc2scan.model import Definition, normalized_type

#: md5sum and RIHS01 hash by type. The tests compute both again.
_DIGESTS = {
    "sensor_msgs/msg/LaserScan": (
        "90c7ef2dc6895d81024acba2ac42f369",
        "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    ),
    "sensor_msgs/msg/PointCloud2": (
        "1158d486dd51d683ce2f1be655c3c181",
        "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    ),
    "tf2_msgs/msg/TFMessage": (
        "94810edda583a504dfda3829e70d7eec",
        "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    ),
}

#: The types that `definition` knows, in ROS 2's spelling.
TYPES = frozenset(_DIGESTS)


@cache
def definition(msgtype: str, ros_version: int) -> tuple[Definition, str]:
    """Return the definition of a type that pc2scan writes, and its hash.

    Parameters
    ----------
    msgtype
        One of `TYPES`, in the spelling of either ROS version.
    ros_version
        1 for ROS 1, 2 for ROS 2.

    Returns
    -------
    definition : Definition
        The text with all types that it depends on, as ``ros1msg`` or ``ros2msg``.
    digest : str
        md5sum (ROS 1) or RIHS01 hash (ROS 2).

    Raises
    ------
    KeyError
        If the type is none of `TYPES`.
    """
    digest = _DIGESTS[normalized_type(msgtype)][ros_version - 1]
    name = msgtype.rpartition("/")[2]
    data = Path(__file__).with_name("definitions").joinpath(f"{name}.ros{ros_version}.msg").read_bytes()
    return Definition(f"ros{ros_version}msg", data), digest

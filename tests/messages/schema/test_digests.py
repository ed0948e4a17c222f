from __future__ import annotations

import pytest

from pc2scan.messages.transcode import transcoder
from pc2scan.model import Connection


@pytest.mark.parametrize(
    ("name", "md5sum"),
    [
        ("sensor_msgs/msg/PointCloud2", "1158d486dd51d683ce2f1be655c3c181"),
        ("sensor_msgs/msg/LaserScan", "90c7ef2dc6895d81024acba2ac42f369"),
        ("sensor_msgs/msg/CameraInfo", "c9a58c1b0b154e0e6da7578cb991d214"),
        ("tf2_msgs/msg/TFMessage", "94810edda583a504dfda3829e70d7eec"),
        ("nav_msgs/msg/Odometry", "cd5e73d190d741a2f92e81eda573aca7"),
        ("std_msgs/msg/Empty", "d41d8cd98f00b204e9800998ecf8427e"),
    ],
)
def test_md5sums_as_ros1_nodes_know_them(name: str, md5sum: str) -> None:
    assert transcoder(Connection(1, "/topic", name, "cdr"), 1).connection.digest == md5sum

"""The options that commands share, in groups by subject. Here: the sections of the help."""

__all__ = ["FRAMES", "MOVING", "OUTPUT", "PARAMS", "POINTS", "REPORT", "REVERSE", "RUN", "SLAM", "TOPICS"]

TOPICS = "Topics and time"
PARAMS = "Parameters of pointcloud_to_laserscan"
SLAM = "Beyond pointcloud_to_laserscan (ready for SLAM)"
POINTS = "Which points"
FRAMES = "Frames"
MOVING = "Robots that move"
REVERSE = "LaserScan to PointCloud2"
RUN = "Run"
OUTPUT = "Output"
REPORT = "Report"

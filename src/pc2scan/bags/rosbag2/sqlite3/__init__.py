"""rosbag2's sqlite3 storage."""

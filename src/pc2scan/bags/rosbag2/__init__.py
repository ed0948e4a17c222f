"""rosbag2 directories, and their sqlite3 storage."""

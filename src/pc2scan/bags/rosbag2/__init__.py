"""rosbag2 directories, and their storages."""

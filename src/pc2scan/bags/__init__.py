"""Reads and writes recordings: a package for each container, and modules that they share.

=================  =======================================================================
module             contents
=================  =======================================================================
``formats``        the table of formats: the one place that lists containers
``opening``        detects a recording's format by content, and opens it
``folders``        finds the recordings in a folder, and the parts of one
``destinations``   plans destinations from their names and options
``reader``         the base class of readers; loads the chunks of a recording, and merges their messages by log time
``observers``      what is taken from messages while a recording is read once
``merged``         reads several recordings as one
``topics``         finds topics by the names that users give
``damage``         the damage of a recording, noted by its reader
``zstd``           reads recordings and messages that are compressed as a whole
``qos``            QoS profiles
``chunks``         common parts of containers with chunks
``rosbag1``        ROS 1 bags (``.bag``)
``mcap``           MCAP files
``rosbag2``        rosbag2 directories: metadata.yaml, and the sqlite3 storage (``.db3``)
=================  =======================================================================

In the package of a chunked format, ``records`` parses records, ``index`` (of a bag: ``records``, too) finds what is
where, ``recover`` does so in a damaged file, and ``read`` and ``write`` have what the table of formats opens.

Importing this package imports no format: each is loaded when the first file of its kind is opened.
"""

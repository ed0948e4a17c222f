"""Recordings: a package for each container, and what they share.

module               what it is about
===================  =======================================================================
``model``            connections, messages, and the protocols `Reader` and `Writer`
``registry``         telling formats apart, opening sources, planning destinations
``rosbag1_*``        ROS 1 bags (``.bag``)
``mcap_*``           MCAP files
``rosbag2_*``        rosbag2 directories: metadata.yaml and storage files
``sqlite3``          rosbag2's sqlite3 storage (``.db3``)
``qos``, ``yaml``    QoS profiles, and the YAML that they and metadata.yaml are written in
``zstd``             zstd around files and messages
``files``            a recording's file, read at given places
``segments``         the order of time within a chunked file
``merged``           several recordings as one
``topics``           topics as people name them
``staging``          a destination appears whole or not at all
``damage``           what is damaged in a recording, noted by its reader
``salvage``          as much of broken compressed data as can be decompressed
``sqlite3_pages``    the rows of a damaged ``.db3``
===================  =======================================================================
=======
=================  =======================================================================
module             what it is about
=================  =======================================================================
``formats``        the table of formats: the one place that lists containers
``opening``        detecting a recording's format by content, and opening it
``destinations``   what a destination's name and the options mean
``reader``         what readers have in common
``units``          what can be loaded by itself, and its messages merged by log time
``merged``         several recordings as one
``topics``         topics as people name them
``damage``         what is damaged in a recording, noted by its reader
``zstd``           zstd around files and messages; ``unpacked``: such a file as a recording
``qos``            QoS profiles
``chunked``        what containers that keep messages in chunks have in common
``rosbag1``        ROS 1 bags (``.bag``)
``mcap``           MCAP files
``rosbag2``        rosbag2 directories: metadata.yaml, and the sqlite3 storage (``.db3``)
=================  =======================================================================

Of a chunked format, ``records`` knows its records and ``chunks`` its chunks; ``index`` finds out
what is where, and ``recovery`` does so in a damaged file; ``reader`` and ``writer`` have the classes
that the table of formats opens.

Importing this package imports no format: each is loaded when the first file of its kind is opened.
"""

from __future__ import annotations

from pc2scan.model import (
    Attachment,
    Buffer,
    Connection,
    Definition,
    Metadata,
    RawMessage,
    Summary,
    Writer,
    normalized_type,
    ros1_type,
)

from .destinations import (
    Destination,
    default_destination,
    default_storage,
    open_writer,
    plan_destination,
)
from .opening import open_recording, sniff
from .reader import Reader

__all__ = [
    "Attachment",
    "Buffer",
    "Connection",
    "Definition",
    "Destination",
    "Metadata",
    "RawMessage",
    "Reader",
    "Summary",
    "Writer",
    "default_destination",
    "default_storage",
    "normalized_type",
    "open_recording",
    "open_writer",
    "plan_destination",
    "ros1_type",
    "sniff",
]

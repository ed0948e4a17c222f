"""Recordings: one module a format, one protocol for all, and a registry that picks by content.

===================  =======================================================================
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

Of a chunked format, ``*_records`` knows its records and ``*_chunks`` its chunks; ``*_contents`` finds out
what is where, and ``*_recovery`` does so in a damaged file; ``*_reader`` and ``*_writer`` have the classes
that the registry opens.

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

from .reader import Reader
from .registry import (
    Container,
    Destination,
    default_destination,
    default_storage,
    open_recording,
    open_writer,
    plan_destination,
    sniff,
)

__all__ = [
    "Attachment",
    "Buffer",
    "Connection",
    "Container",
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

"""The tables of the message types that conversions make, with their names and encoders.

A new type is one entry. Encoders get arrays, because encoding comes last.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from .definitions import definition
from .laserscan import LASERSCAN, LaserScan, encode_laserscan
from .pointcloud2 import POINTCLOUD2, StructuredCloud, encode_structured

if TYPE_CHECKING:
    from collections.abc import Callable

    from pc2scan.model import Definition

Message = TypeVar("Message")


@dataclass(slots=True, eq=False)
class OutputType(Generic[Message]):
    """A type of messages that conversions make.

    Attributes
    ----------
    name
        The last part of the default topic.
    encode
        Serialises a message; the second parameter is ``ros1`` or ``cdr``.
    define
        Its definition and ROS's digest of it, by type and ROS version (1 or 2).
    """

    name: str
    encode: Callable[[Message, str], bytes]
    define: Callable[[str, int], tuple[Definition, str]] = definition


#: The types that clouds can become, by ROS type in ROS 2's spelling; the first is the default.
OF_CLOUDS: dict[str, OutputType[LaserScan]] = {LASERSCAN: OutputType("scan", encode_laserscan)}

#: The same for scans.
OF_SCANS: dict[str, OutputType[StructuredCloud]] = {POINTCLOUD2: OutputType("cloud", encode_structured)}

"""The table of the message types that are 2D scans, with their decoders to `LaserScan`.

A new type is one entry, like those of clouds (`pc2scan.messages.clouds`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeAlias

from pc2scan.model import Buffer

from .laserscan import LASERSCAN, LaserScan, decode_laserscan

#: A decoder: returns the scan of a message's bytes, or raises a `DecodeError`.
DecodeScan: TypeAlias = Callable[[Buffer], LaserScan]


def _laserscan(serialization: str, _echo: str) -> DecodeScan:
    return partial(decode_laserscan, serialization=serialization)


def _multi_echo(serialization: str, echo: str) -> DecodeScan:
    from .multi_echo import decode_multi_echo  # noqa: PLC0415  # few recordings have them

    return partial(decode_multi_echo, serialization=serialization, echo=echo)


#: By ROS type in ROS 2's spelling, the function that makes the decoder of a serialisation (``ros1`` or ``cdr``) and an
#: echo (``first``, ``last`` or ``strongest``), which types with one range for each beam ignore.
SCANS: dict[str, Callable[[str, str], DecodeScan]] = {
    LASERSCAN: _laserscan,
    "sensor_msgs/msg/MultiEchoLaserScan": _multi_echo,
}

"""Decodes VelodyneScan, the packets of a turn, with the package velodyne-decoder.

Source of the layout: VelodyneScan.msg and VelodynePacket.msg of velodyne_msgs: for each packet a time and 1206 bytes.
In CDR times are aligned, so there are two bytes of padding after each packet but the last one.
"""

from __future__ import annotations

import atexit
import gc
import zlib
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from pc2scan.core.points import Points
from pc2scan.errors import DecodeError

from .pointcloud2 import CloudFields, structured_cloud
from .wire import Cursor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pc2scan.model import Buffer

_PACKET = 1206

#: The fields that the package returns. `time` is in seconds.
_POINT = np.dtype(
    [
        *((axis, "<f4") for axis in "xyz"),
        *(("intensity", "<f4"), ("time", "<f4"), ("column", "<u2"), ("ring", "u1"), ("return_type", "u1")),
    ]
)


def decode_velodyne(data: Buffer, serialization: str) -> Points:
    """Decode a serialised VelodyneScan.

    Parameters
    ----------
    data
        The whole message.
    serialization
        ``ros1`` or ``cdr``.

    Returns
    -------
    Points
        The points of all packets, those without a return left out: ``x``, ``y``, ``z`` in metres, as the lidar's model
        and its calibration in the package say; ``intensity``, ``time`` (seconds after the stamp), ``column``, ``ring``
        and ``return_type``.

    Raises
    ------
    DecodeError
        If the message ends too early, its packets are not of a known model, or the package is not installed.

    Notes
    -----
    The package finds the model in the packets. It keeps what it has found, so each message has a decoder of its own.
    """
    cursor = Cursor(data, serialization)
    sequence, stamp_ns, frame_id = cursor.header()
    (count,) = cursor.read("I")
    packets = []
    for _ in range(count):
        seconds, nanoseconds = cursor.read("II" if cursor.ros1 else "iI")
        # Relative to the stamp: the package takes float64, which has steps of 0.2 us at the present time.
        after = (seconds * 1_000_000_000 + nanoseconds - stamp_ns) / 1e9
        packets.append((after, bytes(cursor.take(_PACKET))))
    points = _points_of(packets, stamp_ns) if packets else np.empty(0, _POINT)
    cloud = structured_cloud(sequence, stamp_ns, frame_id, points, is_dense=True)
    return Points(sequence, stamp_ns, frame_id, CloudFields(cloud, further={"packets": _digest(packets)}))


@cache
def _library() -> Any:
    """Return the package."""
    import velodyne_decoder  # noqa: PLC0415  # an optional package

    # The command skips the interpreter's last garbage collection, and the package reports all that is not freed.
    atexit.register(gc.unfreeze)
    return velodyne_decoder


def _points_of(packets: list[tuple[float, bytes]], stamp_ns: int) -> NDArray[np.void]:
    try:
        library = _library()
    except ModuleNotFoundError as err:
        raise DecodeError(
            "it has packets of a Velodyne lidar, which the package velodyne-decoder decodes",
            stamp_ns=stamp_ns,
            hint='pip install "pc2scan[velodyne]"',
        ) from err
    try:
        # The package crashes if there are no packets.
        scan = library.PacketVector([library.VelodynePacket(after, packet) for after, packet in packets])
        last, decoded = library.ScanDecoder().decode(scan, as_pcl_structs=True)
    except RuntimeError as err:
        raise DecodeError(f"its packets cannot be decoded: {err}", stamp_ns=stamp_ns) from err
    points = np.empty(len(decoded), _POINT)
    for name in _POINT.names or ():
        points[name] = decoded[name]
    # The package's times are relative to the last packet.
    points["time"] += np.float32(last.host)
    return points


def _digest(packets: list[tuple[float, bytes]]) -> str:
    """Return a text that differs if the packets do, which may have the same points."""
    return f"{len(packets)} packets, CRC-32 {zlib.crc32(b''.join(packet for _, packet in packets)):08x}"

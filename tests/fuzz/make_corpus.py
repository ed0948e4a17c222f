"""Make the corpus: small sound inputs of every decoder, for the fuzzer to begin with.

``PYTHONPATH=src:tests python tests/fuzz/make_corpus.py``
"""

from __future__ import annotations

import bz2
import struct
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import lz4.frame
import zstandard

from bags import mcap_files, rosbag1_files
from builders import BATTERY, CONTENT, IDL, POINTS, T0, cloud, definition, points_of, qos_text, scan, write_rosbag2
from fuzz.decoders import CORPUS
from pc2scan import ProjectionParams
from pc2scan.bags.mcap_records import MAGIC
from pc2scan.pipeline.params_file import render_params_file

if TYPE_CHECKING:
    from collections.abc import Iterator


def inputs() -> Iterator[tuple[str, str, bytes]]:
    """Decoder, name and content."""
    first = {"ros1": (1, b"\0"), "cdr": (2, b"\xff")}
    for word, (generation, lead) in first.items():
        points = points_of(1, 3)
        yield "cloud", word, lead + cloud(points, generation)
        yield "wire", word, lead + cloud(points, generation)
        yield "scan", word, lead + scan(points[:, 0], generation)
        yield "transforms", word, lead + CONTENT.of("/tf")[0].data[generation]
        text = struct.pack("<I", 2) + (b"\0" if generation == 1 else b"a\0\0\0") * 4
        yield "transcoding", word, lead + (b"" if generation == 1 else b"\0\1\0\0") + text + bytes(60)
        yield "schema", word, bytes([generation - 1]) + definition(BATTERY, generation).encode()
    yield "schema", "idl", b"\x02" + IDL[BATTERY].encode()
    yield (
        "records",
        "connection",
        rosbag1_files.header(topic=b"/t", conn=bytes(4), body=rosbag1_files.header(type=b"a/B")[4:])[4:],
    )
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for kind in ("none", "bz2", "lz4"):
            payload = rosbag1_files.message(5) + rosbag1_files.connection_record()
            made = rosbag1_files.simple_bag(place / "a.bag", payload, compression=kind)
            yield "bag", kind, made.read_bytes().removeprefix(b"#ROSBAG V2.0\n")
        rows = [(0, 5, b"abc"), (1, 4, b"defg")]
        for kind in ("chunked", "unchunked"):
            made = mcap_files.library_file(place / f"{kind}.mcap", rows, extras=True, use_chunking=kind == "chunked")
            yield "mcap", kind, made.read_bytes().removeprefix(MAGIC)
        drive = write_rosbag2(place / "drive", CONTENT, version=9)
        yield "metadata", "version-9", (drive / "metadata.yaml").read_bytes()
    text = b"some text that repeats, some text that repeats"
    yield "salvage", "bz2", b"\0" + bz2.compress(text)[3:]
    yield "salvage", "lz4", b"\1" + lz4.frame.compress(text)[4:]
    yield "salvage", "zstd", b"\2" + zstandard.compress(text)[4:]
    yield "rows", "sound", b"\xfe".join((b"\1/t", b"\1p/msg/T", b"\1", b"\2" + bytes(T0 % 50), b"\0data"))
    yield "qos", "profile", qos_text((POINTS,)).encode()
    yield "parameters", "ros2", render_params_file(ProjectionParams()).encode()
    yield "parameters", "ros1", b"min_height: -0.5\nangle_min: rad(-pi/2)\nuse_inf: 1\n"


def main() -> None:
    """Write one file for each."""
    for decoder, name, data in inputs():
        (CORPUS / decoder).mkdir(parents=True, exist_ok=True)
        (CORPUS / decoder / name).write_bytes(data)


if __name__ == "__main__":
    main()

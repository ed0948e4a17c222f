"""Compressing and decompressing by name, within bounds."""

from __future__ import annotations

import io

import pytest
import zstandard

from pc2scan.files import compression as codecs
from pc2scan.files.compression import (
    LZ4_MAGIC,
    ZSTD_MAGIC,
    CompressionError,
    compress,
    decoder,
    decompress,
    zstd_content_size,
    zstd_head,
)
from pc2scan.options.table import options_of

DATA = bytes(range(256)) * 400 + bytes(50_000)
PACKING = ["bz2", "lz4", "zstd"]


def test_every_compression_that_can_be_asked_for_is_known() -> None:
    assert set(options_of("convert")["compression"].value.words) == codecs._COMPRESS.keys() == codecs._DECOMPRESS.keys()


@pytest.mark.parametrize("name", ["none", *PACKING])
@pytest.mark.parametrize("data", [b"", b"x", DATA], ids=len)
def test_there_and_back(name: str, data: bytes) -> None:
    packed = compress(name, data)
    assert decompress(name, memoryview(bytes(packed)), len(data)) == (data, True)


def test_frames_begin_with_their_magic() -> None:
    assert bytes(compress("lz4", DATA)).startswith(LZ4_MAGIC)
    assert bytes(compress("zstd", DATA)).startswith(ZSTD_MAGIC)


def test_levels_of_zstd() -> None:
    assert compress("zstd", DATA) == zstandard.ZstdCompressor().compress(DATA)
    assert compress("zstd", DATA, 1) == zstandard.ZstdCompressor(level=1).compress(DATA)


@pytest.mark.parametrize("name", ["bz2", "lz4"])
@pytest.mark.parametrize("size", [0, 1, 1_000, len(DATA) - 1])
def test_one_byte_more_shows_an_excess(name: str, size: int) -> None:
    assert decompress(name, compress(name, DATA), size) == (DATA[: size + 1], False)
    # What is cut is not complete.
    data, complete = decompress(name, bytes(compress(name, DATA))[:-5], len(DATA))
    assert not complete
    assert DATA.startswith(data)


def test_zstd_does_not_believe_another_size() -> None:
    with pytest.raises(CompressionError, match=f"the compressed data declare {len(DATA)} bytes"):
        decompress("zstd", compress("zstd", DATA), 1_000)
    silent = zstandard.ZstdCompressor(write_content_size=False).compress(DATA)
    assert zstd_content_size(silent) == -1
    assert decompress("zstd", silent, len(DATA)) == (DATA, True)
    for size in (1_000, len(DATA) - 1):
        with pytest.raises(CompressionError):
            decompress("zstd", silent, size)
    with pytest.raises(CompressionError):
        decompress("zstd", silent[:-5], len(DATA))


@pytest.mark.parametrize("name", PACKING)
def test_what_is_no_such_data(name: str) -> None:
    with pytest.raises(CompressionError):
        decompress(name, b"hello, this is text", 100)


def test_lz4_does_not_allocate_what_cannot_come() -> None:
    # A terabyte is not there to be allocated.
    data, complete = decompress("lz4", compress("lz4", DATA), 1 << 40)
    assert (data, complete) == (DATA, True)


@pytest.mark.parametrize("name", ["bz2", "zstd"])
def test_decoders_take_pieces(name: str) -> None:
    decoding, packed = decoder(name), bytes(compress(name, DATA)) + b"more"
    found = b""
    for start in range(0, len(packed), 100):
        found += decoding.feed(packed[start : start + 100])
        if decoding.eof:
            break
    assert found == DATA
    assert decoding.unused_data == b"more"[-len(decoding.unused_data) :]
    with pytest.raises(CompressionError):
        decoder(name).feed(b"hello, this is text")


def test_a_decoder_of_bz2_keeps_to_its_bound() -> None:
    assert len(decoder("bz2").feed(compress("bz2", DATA), 1_000)) == 1_000


def test_the_head_of_a_zstd_file() -> None:
    packed = bytes(compress("zstd", DATA))
    assert zstd_head(io.BytesIO(packed), 64) == DATA[:64]
    assert zstd_head(io.BytesIO(bytes(compress("zstd", b"abc"))), 64) == b"abc"
    with pytest.raises(CompressionError):
        zstd_head(io.BytesIO(ZSTD_MAGIC + b"garbage"), 64)
    with pytest.raises(CompressionError):
        zstd_content_size(b"hello, this is text")

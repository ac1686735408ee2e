from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from capture.decode import decode
from capture.exposure import read_exif_exposure
from capture.files.imagefile import MAX_PIXELS, read_pixels, write_exr
from capture.files.imageheader import Header, read_header
from capture.files.tiff import tiff_summary


def header_of(path: Path) -> Header:
    return read_header(memoryview(path.read_bytes()))


@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [
        *((".png", dtype) for dtype in (np.uint8, np.uint16)),
        *((".tif", dtype) for dtype in (np.uint8, np.uint16, np.float32)),
        (".jpg", np.uint8),
        (".hdr", np.float32),
        (".exr", np.float32),
    ],
)
def test_kind_and_size_are_what_the_decoder_finds(tmp_path, suffix, dtype):
    rgb = (np.random.default_rng(0).random((37, 53, 3)) * 200).astype(dtype)
    path = tmp_path / f"a{suffix}"
    if suffix == ".exr":
        write_exr(path, rgb)
    else:
        assert cv2.imwrite(str(path), rgb)
    kinds = {".png": "PNG", ".jpg": "JPEG", ".tif": "TIFF", ".hdr": "Radiance", ".exr": "EXR"}
    assert header_of(path) == Header(kinds[suffix], (53, 37), lossy=suffix == ".jpg")
    assert read_pixels(path).shape == (37, 53, 3)


def test_a_progressive_jpeg_with_exif_has_its_size(tmp_path):
    exif = Image.Exif()
    exif[0x010F] = "maker" * 500
    Image.fromarray(np.zeros((20, 30, 3), np.uint8)).save(tmp_path / "a.jpg", progressive=True, exif=exif)
    assert header_of(tmp_path / "a.jpg") == Header("JPEG", (30, 20), lossy=True)


def test_content_counts_and_not_the_ending(tmp_path):
    rgb = np.random.default_rng(1).integers(0, 256, (20, 30, 3), np.uint8)
    Image.fromarray(rgb).save(tmp_path / "a.png")
    renamed = (tmp_path / "a.png").rename(tmp_path / "a photo, é.jpg")
    assert (read_pixels(renamed) == rgb).all()
    # Nor is a PNG's saturation spread as a JPEG's has to be.
    rgb[:] = 100
    rgb[10, 10] = 255
    Image.fromarray(rgb).save(tmp_path / "b.png")
    assert decode((tmp_path / "b.png").rename(tmp_path / "b.jpg")).saturated.sum() == 1


def png_that_claims(width: int, height: int) -> bytes:
    """A PNG of a few bytes that would decode to width x height pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + chunk(b"IEND", b"")


def test_a_decompression_bomb_is_refused_before_it_is_decoded(tmp_path):
    side = int(MAX_PIXELS**0.5) + 1
    (tmp_path / "bomb.png").write_bytes(png_that_claims(side, side))
    with pytest.raises(
        ValueError, match=rf"bomb\.png: says that it holds {side}x{side} pixels; more than 400 million"
    ):
        decode(tmp_path / "bomb.png")
    # Reading what its EXIF says neither decodes nor warns.
    assert read_exif_exposure(tmp_path / "bomb.png").exposure_s is None
    bomb = tmp_path / "bomb.hdr"
    bomb.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n" + bytes(100))
    with pytest.raises(ValueError, match=r"bomb\.hdr: says that it holds 60000x60000 pixels"):
        decode(bomb)


def test_a_tiff_knows_whether_its_data_are_all_there(tmp_path):
    assert cv2.imwrite(
        str(tmp_path / "a.tif"), np.random.default_rng(2).integers(0, 9, (40, 50, 3), np.uint8)
    )
    whole = (tmp_path / "a.tif").read_bytes()
    summary = tiff_summary(whole)
    assert summary is not None
    assert (summary.size, summary.whole, summary.camera_raw) == ((50, 40), True, False)
    for length in (9, len(whole) // 2):
        cut = tiff_summary(whole[:length])
        assert cut is not None
        assert not cut.whole
    assert tiff_summary(b"\x89PNG") is None


def test_a_tiff_that_holds_jpeg_says_so(tmp_path):
    picture = Image.fromarray(np.zeros((16, 16, 3), np.uint8))
    for compression in ("jpeg", "tiff_lzw"):
        picture.save(tmp_path / "a.tif", compression=compression)
        assert header_of(tmp_path / "a.tif") == Header("TIFF", (16, 16), lossy=compression == "jpeg")


def test_directories_in_a_circle_come_to_an_end():
    # One directory without entries, whose next one is itself.
    summary = tiff_summary(b"II*\0" + struct.pack("<IHI", 8, 0, 8))
    assert summary is not None
    assert summary.size is None

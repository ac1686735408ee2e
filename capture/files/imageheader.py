"""What the first bytes of an image file say before it is decoded: its kind, its size, whether it is whole."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path

from capture.files.tiff import tiff_summary

_RAW_ENDINGS = (
    ".3fr .ari .arw .bay .cap .cr2 .cr3 .crw .dcr .dcs .dng .erf .fff .gpr .iiq .k25 .kdc .mef .mos .mrw .nef .nrw"
    " .orf .pef .ptx .pxn .raf .raw .rw2 .rwl .sr2 .srf .srw .x3f"
)
# JPEG markers that start a frame and hold its size: SOF0 to SOF15 without DHT, JPG and DAC.
_FRAME_STARTS = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_EXR_SIGNATURE = b"\x76\x2f\x31\x01"
# Bits of an EXR's version field: tiled, deep, multi-part. Their chunks are left to the codec.
_EXR_UNCOMMON = 0x1A00


@dataclass(frozen=True)
class Header:
    """What a file is.

    kind : "PNG", "JPEG", "TIFF", "EXR", "Radiance", "camera RAW", or "" if none of these.
    size : (width, height) in pixels, or None where the header doesn't state it.
    whole : False if the file ends before its data do, as far as its structure shows.
    lossy : JPEG-compressed, in a TIFF as well: what a pixel lost lies in its whole block.
    """

    kind: str
    size: tuple[int, int] | None = None
    whole: bool = True
    lossy: bool = False


def is_raw(path: Path) -> bool:
    """Whether a file is to be read as camera RAW, recognised by the ending of its name."""
    return path.suffix.lower() in _RAW_ENDINGS.split()


def read_header(data: memoryview) -> Header:
    """Kind, size and wholeness of an image file's bytes."""
    start = bytes(data[:16])
    if start.startswith(b"\x89PNG"):
        return _png(data)
    if start.startswith(b"\xff\xd8"):
        return Header("JPEG", _jpeg_size(data), lossy=True)
    if start.startswith(_EXR_SIGNATURE):
        return _exr(data)
    if start.startswith(b"#?"):
        return Header("Radiance", _radiance_size(data))
    if start[6:14] == b"HEAPCCDR" or start[4:10] == b"ftypcr":
        return Header("camera RAW")  # Canon's CRW and CR3
    tiff = tiff_summary(data)
    if tiff is None:
        return Header("")
    return Header("camera RAW" if tiff.camera_raw else "TIFF", tiff.size, tiff.whole, tiff.lossy)


def _png(data: memoryview) -> Header:
    whole = b"IEND" in bytes(data[-64:])
    return (
        Header("PNG", struct.unpack_from(">II", data, 16), whole)
        if len(data) >= 24
        else Header("PNG", None, False)
    )


def _jpeg_size(data: memoryview) -> tuple[int, int] | None:
    position = 2
    while position + 9 <= len(data) and data[position] == 0xFF:
        marker = data[position + 1]
        if marker in _FRAME_STARTS:
            height, width = struct.unpack_from(">HH", data, position + 5)
            return width, height
        position += 2 + struct.unpack_from(">H", data, position + 2)[0]
    return None


def _radiance_size(data: memoryview) -> tuple[int, int] | None:
    found = re.search(rb"\n([-+][XY]) (\d+) [-+][XY] (\d+)\n", bytes(data[:4096]))
    if found is None:
        return None
    first, second = int(found[2]), int(found[3])
    return (second, first) if found[1].endswith(b"Y") else (first, second)


def _exr(data: memoryview) -> Header:
    """An EXR whose chunks lie within the file, if it is of the common kind (scan lines, one part)."""
    window = None
    try:
        position = 8
        while data[position]:
            name, position = _text(data, position)
            _, position = _text(data, position)
            (length,) = struct.unpack_from("<I", data, position)
            if name == b"dataWindow":
                window = struct.unpack_from("<4i", data, position + 4)
            position += 4 + length
        if not int.from_bytes(data[4:8], "little") & _EXR_UNCOMMON:
            table = position + 1
            (first,) = struct.unpack_from("<Q", data, table)
            for offset in struct.unpack_from(f"<{(first - table) // 8}Q", data, table):
                _, length = struct.unpack_from("<iI", data, offset)
                if not offset or offset + 8 + length > len(data):
                    raise IndexError("a chunk lies beyond the end of the file")
    except (IndexError, ValueError, struct.error):
        return Header("EXR", None, whole=False)
    size = (window[2] - window[0] + 1, window[3] - window[1] + 1) if window else None
    return Header("EXR", size, whole=window is not None)


def _text(data: memoryview, position: int) -> tuple[bytes, int]:
    """A zero-terminated text and the position behind it."""
    end = bytes(data[position : position + 256]).index(0) + position
    return bytes(data[position:end]), end + 1

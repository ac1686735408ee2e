"""The structure of TIFF files, which many camera RAW formats share: is the file whole, and is it what it says?"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

_SUBFILE, _WIDTH, _HEIGHT, _COMPRESSION, _SUB_IFDS, _DNG_VERSION = 254, 256, 257, 259, 330, 50706
# Where image data lie: offsets and byte counts of strips, tiles, and old-style JPEG streams.
_DATA = ((273, 279), (324, 325), (513, 514))
_WANTED = {_SUBFILE, _WIDTH, _HEIGHT, _COMPRESSION, _SUB_IFDS, _DNG_VERSION}
_WANTED |= {tag for pair in _DATA for tag in pair}
_FORMATS = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}
_JPEG = (6, 7)  # of Compression: old-style, and as in TIFF's technical note 2
_DEFLATE = (8, 32946)
_REDUCED = 1  # bit of NewSubfileType: a smaller copy of another image in the file
_MOST_DIRECTORIES = 64  # a damaged file may chain its directories in a circle

Directory = dict[int, tuple[int, ...]]


@dataclass(frozen=True)
class TiffSummary:
    """What a TIFF's directories say.

    size : (width, height) of the first image, or None.
    whole : all image data that are announced lie within the file.
    camera_raw : the first image is a preview of a RAW image in the same file, or the file says that it is DNG.
    lossy : the first image is JPEG-compressed.
    """

    size: tuple[int, int] | None
    whole: bool
    camera_raw: bool
    lossy: bool = False


def tiff_summary(data: bytes | memoryview) -> TiffSummary | None:
    """What a TIFF file's directories say; None if the bytes aren't (classic) TIFF."""
    if bytes(data[:2]) not in (b"II", b"MM"):
        return None
    order = "<" if bytes(data[:2]) == b"II" else ">"
    try:
        if struct.unpack_from(f"{order}H", data, 2)[0] not in (42, 0x4F52, 0x5352, 0x55):  # TIFF, ORF, RW2
            return None
        directories = list(_directories(data, order))
    except struct.error:
        return TiffSummary(None, whole=False, camera_raw=False)
    whole = all(
        offset + count <= len(data)
        for directory in directories
        for offsets, counts in _DATA
        for offset, count in zip(directory.get(offsets, ()), directory.get(counts, ()), strict=False)
    )
    first: Directory = directories[0] if directories else {}
    preview = bool(first.get(_SUBFILE, (0,))[0] & _REDUCED) and _SUB_IFDS in first
    size = (first[_WIDTH][0], first[_HEIGHT][0]) if _WIDTH in first and _HEIGHT in first else None
    lossy = first.get(_COMPRESSION, (1,))[0] in _JPEG
    return TiffSummary(size, whole, preview or _DNG_VERSION in first, lossy)


def inflates(data: bytes | memoryview) -> bool:
    """Whether what Deflate compressed of a whole TIFF's first image has the checksums that were written with it."""
    directory = next(_directories(data, "<" if bytes(data[:2]) == b"II" else ">"), {})
    if directory.get(_COMPRESSION, (1,))[0] not in _DEFLATE:
        return True
    try:
        for offsets, counts in _DATA:
            for offset, count in zip(directory.get(offsets, ()), directory.get(counts, ()), strict=False):
                zlib.decompress(data[offset : offset + count])
    except zlib.error:
        return False
    return True


def _directories(data: bytes | memoryview, order: str) -> Iterator[Directory]:
    """Every directory of the file, sub-directories too; struct.error where one lies beyond its end."""
    pending = [struct.unpack_from(f"{order}I", data, 4)[0]]
    seen: set[int] = set()
    while pending and len(seen) < _MOST_DIRECTORIES:
        position = pending.pop(0)
        if position == 0 or position in seen:
            continue
        seen.add(position)
        (count,) = struct.unpack_from(f"{order}H", data, position)
        directory: Directory = {}
        for index in range(count):
            tag, kind, length = struct.unpack_from(f"{order}HHI", data, position + 2 + 12 * index)
            if kind in _FORMATS and tag in _WANTED:
                directory[tag] = _values(data, order, position + 10 + 12 * index, _FORMATS[kind], length)
        yield directory
        pending += directory.get(_SUB_IFDS, ())
        (following,) = struct.unpack_from(f"{order}I", data, position + 2 + 12 * count)
        pending.append(following)


def _values(data: bytes | memoryview, order: str, at: int, letter: str, length: int) -> tuple[int, ...]:
    form = f"{order}{length}{letter}"
    if struct.calcsize(form) > 4:
        (at,) = struct.unpack_from(f"{order}I", data, at)
    return struct.unpack_from(form, data, at)

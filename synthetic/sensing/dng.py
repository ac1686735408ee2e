"""Sensor mosaics as camera RAW files: minimal uncompressed DNG (Adobe, DNG specification 1.4)."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# XYZ to linear sRGB (IEC 61966-2-1): the camera's own colours are then those of sRGB.
_XYZ_TO_SRGB = (3.2406, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.2040, 1.0570)
_COLOURS = {"R": 0, "G": 1, "B": 2}
# Size in bytes and struct letter of TIFF's field types.
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
_LETTERS = {_BYTE: "B", _ASCII: "B", _SHORT: "H", _LONG: "I", _RATIONAL: "II", _SRATIONAL: "ii"}
_EXIF_IFD, _STRIP_OFFSETS = 34665, 273
_LARGEST = 2**31 - 1


class _Field(NamedTuple):
    kind: int
    values: Sequence[float]


def write_dng(
    path: Path,
    mosaic: NDArray[np.integer],
    *,
    black: int | Sequence[int] = 0,
    white: int = 65535,
    pattern: str = "RGGB",
    exposure_s: float = 1.0,
    iso: int = 100,
    f_number: float = 1.0,
    neutral: Sequence[float] = (1.0, 1.0, 1.0),
) -> None:
    """Write a Bayer mosaic as a DNG.

    mosaic : (h, w) integer codes in 0 to 65535, as they leave the sensor, h and w even.
    black : the code of no light, one number, or four for the 2x2 cells in reading order. white : that of saturation.
    pattern : the colours of the 2x2 cells in reading order. neutral : what the camera sees of white, RGB, at most 1.
    exposure_s, iso, f_number : as EXIF holds them.
    """
    mosaic = np.asarray(mosaic)
    if mosaic.ndim != 2 or mosaic.shape[0] % 2 or mosaic.shape[1] % 2:
        raise ValueError(f"{path}: the mosaic is {mosaic.shape}; it must be (h, w), both even")
    if mosaic.min() < 0 or mosaic.max() > 65535:
        raise ValueError(f"{path}: codes run from {mosaic.min()} to {mosaic.max()}; 16 bits are needed")
    height, width = mosaic.shape
    levels = np.broadcast_to(black, 4).tolist()
    strip = mosaic.astype("<u2").tobytes()
    # EXIF 2.3: time, f-number, ISO.
    exif = {
        33434: _Field(_RATIONAL, (exposure_s,)),
        33437: _Field(_RATIONAL, (f_number,)),
        34855: _Field(_SHORT, (iso,)),
    }
    tags = {
        254: _Field(_LONG, (0,)),  # the full image
        256: _Field(_LONG, (width,)),
        257: _Field(_LONG, (height,)),
        258: _Field(_SHORT, (16,)),
        259: _Field(_SHORT, (1,)),  # uncompressed
        262: _Field(_SHORT, (32803,)),  # colour filter array
        271: _Field(_ASCII, b"lightfactor\0"),
        272: _Field(_ASCII, b"synthetic sensor\0"),
        _STRIP_OFFSETS: _Field(_LONG, (0,)),
        274: _Field(_SHORT, (1,)),
        277: _Field(_SHORT, (1,)),
        278: _Field(_LONG, (height,)),
        279: _Field(_LONG, (len(strip),)),
        284: _Field(_SHORT, (1,)),
        33421: _Field(_SHORT, (2, 2)),
        33422: _Field(_BYTE, [_COLOURS[colour] for colour in pattern]),
        _EXIF_IFD: _Field(_LONG, (0,)),
        50706: _Field(_BYTE, (1, 4, 0, 0)),
        50707: _Field(_BYTE, (1, 1, 0, 0)),
        50708: _Field(_ASCII, b"lightfactor synthetic sensor\0"),
        50713: _Field(_SHORT, (2, 2)),
        50714: _Field(_LONG, levels),
        50717: _Field(_LONG, (white,)),
        50721: _Field(_SRATIONAL, _XYZ_TO_SRGB),
        50728: _Field(_RATIONAL, neutral),
        50778: _Field(_SHORT, (21,)),  # D65
    }
    # Where things lie depends on the sizes of the directories only: lay out once to know them.
    first = len(_directory(tags, 8))
    tags[_EXIF_IFD] = _Field(_LONG, (8 + first,))
    second = _directory(exif, 8 + first)
    tags[_STRIP_OFFSETS] = _Field(_LONG, (8 + first + len(second),))
    path.write_bytes(b"II*\0" + struct.pack("<I", 8) + _directory(tags, 8) + second + strip)


def rational(value: float) -> Fraction:
    """The nearest fraction of two 31-bit numbers, as TIFF and EXIF hold them: good to 1e-9 from 1e-6 to 1e6."""
    return Fraction(value).limit_denominator(int(_LARGEST / max(abs(value), 1)))


def _directory(fields: Mapping[int, _Field], start: int) -> bytes:
    """An image file directory at byte `start`, followed by the values that don't fit into their entries."""
    entries, data = b"", b""
    end = start + 2 + 12 * len(fields) + 4
    for tag in sorted(fields):
        kind, values = fields[tag]
        packed = _packed(kind, values)
        if len(packed) > 4:
            offset = end + len(data)
            data += packed + b"\0" * (len(packed) % 2)
            packed = struct.pack("<I", offset)
        entries += struct.pack("<HHI", tag, kind, len(values)) + packed.ljust(4, b"\0")
    return struct.pack("<H", len(fields)) + entries + struct.pack("<I", 0) + data


def _packed(kind: int, values: Sequence[float]) -> bytes:
    if kind in (_RATIONAL, _SRATIONAL):
        parts = [rational(value) for value in values]
        return b"".join(struct.pack(f"<{_LETTERS[kind]}", part.numerator, part.denominator) for part in parts)
    return struct.pack(f"<{len(values)}{_LETTERS[kind]}", *(int(value) for value in values))

"""How a JPEG file was quantised: its tables, which component uses which, and how components are subsampled."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array

Floats = NDArray[np.float64]

# Markers without a length: TEM, RST0 to RST7, SOI; and those that end the tables: SOS, EOI.
_BARE = {0x01, *range(0xD0, 0xD9)}
_ENDS = {0xDA, 0xD9}
_QUANTISATION, _ADOBE = 0xDB, 0xEE
# Frames whose coefficients are quantised: SOF0 to SOF15 but the lossless ones, DHT, JPG and DAC.
_FRAMES = set(range(0xC0, 0xD0)) - {0xC3, 0xC4, 0xC7, 0xC8, 0xCB, 0xCC, 0xCF}


def _zigzag() -> NDArray[np.intp]:
    """(64,) places in a row-major 8x8 table of the coefficients as files order them: by diagonals, to and fro."""
    rows, columns = (axis.ravel() for axis in np.indices((8, 8)))
    diagonal = rows + columns
    return np.lexsort((np.where(diagonal % 2, rows, columns), diagonal))


_ZIGZAG = _zigzag()


@dataclass(frozen=True, eq=False)
class JpegTables:
    """The quantisation of a JPEG file.

    steps : (c, 8, 8) float64, the step of each component's orthonormal DCT coefficients in codes; rows are vertical
        frequencies. reduction : per component, how many times fewer samples it has (down, across). luma_chroma :
        the components are Y, Cb, Cr (JFIF), or Y alone; otherwise R, G, B.
    """

    steps: Floats
    reduction: tuple[tuple[int, int], ...]
    luma_chroma: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", frozen_array(self.steps))


def jpeg_tables(data: memoryview) -> JpegTables | None:
    """The quantisation that a JPEG file's markers state (ITU-T T.81, annex B), baseline or progressive.

    None if the file is no JPEG, loses nothing by quantisation, or holds components that aren't grey, colour or ink.
    """
    if bytes(data[:2]) != b"\xff\xd8":
        return None
    tables: dict[int, Floats] = {}
    components: list[tuple[int, int, int, int]] = []
    transform: int | None = None
    try:
        position = 2
        while data[position] == 0xFF:
            marker = data[position + 1]
            if marker in _ENDS:
                break
            if marker == 0xFF or marker in _BARE:  # fill bytes may come before any marker
                position += 1 if marker == 0xFF else 2
                continue
            (length,) = struct.unpack_from(">H", data, position + 2)
            body = data[position + 4 : position + 2 + length]
            if marker == _QUANTISATION:
                tables |= _quantisation(body)
            elif marker in _FRAMES:
                components = [
                    (body[at], body[at + 1] >> 4, body[at + 1] & 15, body[at + 2])
                    for at in range(6, 6 + 3 * body[5], 3)
                ]
            elif marker == _ADOBE and bytes(body[:5]) == b"Adobe":
                transform = body[11]
            position += 2 + length
        if len(components) not in (1, 3, 4):
            return None
        across, down = max(part[1] for part in components), max(part[2] for part in components)
        # Ink (four components) is luma and chroma of the inverted picture, with black apart.
        chosen = components[:3]
        return JpegTables(
            np.array([tables[part[3]] for part in chosen]),
            tuple((down // part[2], across // part[1]) for part in chosen),
            transform != 0 and bytes(part[0] for part in chosen) != b"RGB",
        )
    except (IndexError, KeyError, struct.error, ZeroDivisionError):
        return None


def _quantisation(body: memoryview) -> dict[int, Floats]:
    """The tables (8, 8) of one DQT segment by their number; 8 or 16 bits an entry."""
    tables = {}
    position = 0
    while position < len(body):
        wide, number = body[position] >> 4, body[position] & 15
        entries = struct.unpack_from(">64H" if wide else ">64B", body, position + 1)
        table = np.empty(64)
        table[_ZIGZAG] = entries
        tables[number] = table.reshape(8, 8)
        position += 129 if wide else 65
    return tables

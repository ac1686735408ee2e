"""Whether the compressed data of a JPEG file hold the picture that its header announces.

Decoders fill what is missing with grey, and skip what is left over. Huffman codes fall out of step where bytes are lost
or wrong, so that the data end too early or too late. Pillow decodes them once more at an eighth of the size, into a
picture with room behind its end: there, and where data are missing, libjpeg leaves all coefficients zero, which is
exactly middle grey.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from PIL.JpegImagePlugin import JpegImageFile

_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"
_END, _SCAN, _INTERVAL, _PROGRESSIVE, _HUFFMAN_TABLES = 0xD9, 0xDA, 0xDD, 0xC2, 0xC4
# Markers without a segment: TEM and SOI, and RST0 to RST7, which belong into scans.
_BARE, _RESTARTS = {0x01, 0xD8}, range(0xD0, 0xD8)
# SOF0 to SOF15 without DHT, JPG and DAC; those with Huffman codes of quantised coefficients.
_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_HUFFMAN = {0xC0, 0xC1, _PROGRESSIVE}
# Segments that say nothing of the coefficients: APP0 to APP15, COM.
_NOTES = {*range(0xE0, 0xF0), 0xFE}
# Longest side of a picture in libjpeg, and MCUs side by side where each restart interval is a picture of its own.
_LONGEST, _ACROSS = 65_500, 4000
# How coefficients that are all zero are decoded; inks are inverted.
_GREY = (127, 128)
# A block takes two bits at least: no change of its mean, and its end.
_FEWEST_BITS = 2
# Levels by which a block's mean may differ from a pixel of its, whose colours are finer.
_MEANS_AGREE = 12
# Zeros in a row that no block holds, unless they are the codes of flat blocks.
_ZEROS = bytes(64)
_OUT_OF_STEP = "its data don't end where its picture does"


@dataclass(frozen=True, eq=False)
class _Parts:
    """The parts of a JPEG file.

    frame : marker of the frame. size : (width, height), pixels. sampling : (across, down) of each component.
    header : segments before the first scan, without notes and restart interval. height_at : place of the height in it.
    interval : MCUs between restarts, 0 without. scan : the first scan's segment. pieces : its data, cut at restarts.
    tail : what follows, EOI included. single : no other scan belongs to the picture.
    """

    frame: int
    size: tuple[int, int]
    sampling: tuple[tuple[int, int], ...]
    header: bytes
    height_at: int
    interval: int
    scan: bytes
    pieces: tuple[bytes, ...]
    tail: bytes
    single: bool

    @property
    def mcu(self) -> tuple[int, int]:
        """Width and height of an MCU in pixels."""
        if len(self.sampling) == 1:
            return 8, 8
        return 8 * max(part[0] for part in self.sampling), 8 * max(part[1] for part in self.sampling)

    @property
    def blocks(self) -> int:
        """Blocks in an MCU."""
        return 1 if len(self.sampling) == 1 else sum(across * down for across, down in self.sampling)

    @property
    def grid(self) -> tuple[int, int]:
        """MCUs of the picture, across and down."""
        return -(-self.size[0] // self.mcu[0]), -(-self.size[1] // self.mcu[1])


def jpeg_fault(data: bytes) -> str | None:
    """What is wrong with the compressed data of a JPEG file, in words; None if nothing is seen.

    A wrong byte stays unseen where the codes fall back into step at once, and in arithmetic codes. Of files with
    several scans (progressive ones), data that end too early aren't seen; with restarts, only markers are checked.
    """
    try:
        parts = _parts(data)
    except (IndexError, struct.error):
        return "it ends before its picture does"
    except ValueError as error:
        return str(error)
    if parts.frame not in _HUFFMAN or min(parts.size) == 0:
        return None
    if not parts.single:
        return None if parts.interval else _left_over(parts)
    across, down = parts.grid
    each = parts.interval or across * down
    count = -(-across * down // each)
    if len(parts.pieces) != count:
        return f"its data hold {len(parts.pieces) - 1} restart markers instead of {count - 1}"
    sizes = np.full(count, each)
    sizes[-1] = across * down - each * (count - 1)
    if _is_zeroed(parts):
        return "a part of its data was overwritten with zeros"
    bad = np.flatnonzero(_out_of_step(parts, sizes))
    if not len(bad):
        return None
    if count == 1:
        return _OUT_OF_STEP
    top, bottom = (bad[0] * each // across, -(-(bad[-1] + 1) * each // across))
    rows = f"{top * parts.mcu[1]} to {min(bottom * parts.mcu[1], parts.size[1])}"
    return f"its data are out of step between the rows {rows}"


def _parts(data: bytes) -> _Parts:
    """ValueError where segments don't follow each other; IndexError or struct.error where the file ends too early."""
    array = np.frombuffer(data, np.uint8)
    # FF 00 is a byte of the data, and FF FF fills.
    marks = np.flatnonzero((array[:-1] == 0xFF) & (array[1:] != 0) & (array[1:] != 0xFF))
    header, frame, scan = bytearray(), b"", b""
    height_at, interval, tail_at = 0, 0, 0
    pieces: tuple[bytes, ...] = ()
    single = True
    position = 2
    while data[position] != 0xFF or data[position + 1] != _END:
        marker = data[position + 1]
        if data[position] != 0xFF or marker == 0 or marker in _RESTARTS:
            raise ValueError(f"its parts don't follow each other at byte {position}")
        if marker == 0xFF or marker in _BARE:
            position += 1 if marker == 0xFF else 2
            continue
        (length,) = struct.unpack_from(">H", data, position + 2)
        segment = data[position : position + 2 + length]
        position += len(segment)
        if marker == _SCAN:
            ends = marks[np.searchsorted(marks, position) :]
            kinds = array[ends + 1].astype(int) - _RESTARTS[0]
            restarts = int(np.flatnonzero((kinds < 0) | (kinds > 7))[0])
            if (kinds[:restarts] != np.arange(restarts) % 8).any():
                raise ValueError("restart markers in its data are missing or out of order")
            bounds = [position - 2, *ends[: restarts + 1].tolist()]
            if scan:
                single = False
            else:
                scan, tail_at = segment, bounds[-1]
                pieces = tuple(data[a + 2 : b] for a, b in pairwise(bounds))
            position = bounds[-1]
        elif marker == _INTERVAL:
            (interval,) = struct.unpack_from(">H", segment, 4)
        elif not scan and marker not in _NOTES:
            if marker in _FRAMES:
                frame, height_at = segment, len(header) + 5
            header += segment
    if not scan or not frame:
        raise ValueError("it holds no picture")
    height, width = struct.unpack_from(">HH", frame, 5)
    sampling = tuple((frame[k] >> 4, frame[k] & 15) for k in range(11, 11 + 3 * frame[9], 3))
    single &= frame[1] != _PROGRESSIVE and scan[4] == len(sampling)
    tail = data[tail_at : position + 2]
    size = (width, height)
    return _Parts(frame[1], size, sampling, bytes(header), height_at, interval, scan, pieces, tail, single)


def _is_zeroed(parts: _Parts) -> bool:
    """Whether data hold more zeros in a row than codes can give, as where a sector could not be copied."""
    position = 0
    while position < len(parts.header):
        marker, length = struct.unpack_from(">xBH", parts.header, position)
        at, position = position + 4, position + 2 + length
        while marker == _HUFFMAN_TABLES and at < position:
            # A table's first symbol has the code of zeros: no change of the mean, or the end of a block.
            if parts.header[at + 17] != 0:
                return any(_ZEROS in piece.rstrip(b"\0") for piece in parts.pieces)
            at += 17 + sum(parts.header[at + 1 : at + 17])
    return False


def _left_over(parts: _Parts) -> str | None:
    """What is wrong where several scans make the picture, without restarts."""
    across, down = parts.grid
    if (down + 2) * parts.mcu[1] > _LONGEST:
        return None
    # Half the size shows most of what a scan of fine detail leaves behind the end.
    shown = _mcus(parts, parts.pieces, (across, down + 2), 2, parts.tail)
    # Scans of single bits take those that fill their last byte, seven at most, for more blocks; and pixels are mixed
    # with their neighbours.
    if shown is None or not _is_grey(shown[0, across * down + 9 :]).all():
        return _OUT_OF_STEP
    return None


def _out_of_step(parts: _Parts, sizes: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which pieces (k,) of a scan hold fewer or more than `sizes` (k,) MCUs; none where they are too long to count."""
    room = int(sizes[0]) + 2
    across = min(room, _ACROSS) if parts.interval else parts.grid[0]
    down = -(-room // across)
    at_once = _LONGEST // (down * parts.mcu[1])
    bad = np.zeros(len(sizes), bool)
    if at_once == 0 or across * parts.mcu[0] > _LONGEST or (parts.interval and across * down > 0xFFFF):
        return bad
    for first in range(0, len(sizes), at_once):
        some = slice(first, first + at_once)
        bad[some] = _judged(parts, parts.pieces[some], sizes[some], (across, down))
    return bad


def _judged(
    parts: _Parts, pieces: Sequence[bytes], sizes: NDArray[np.intp], grid: tuple[int, int]
) -> NDArray[np.bool_]:
    """As `_out_of_step`, each piece decoded into MCUs of its own (across, down), which have room for two more."""
    shown = _mcus(parts, pieces, grid)
    if shown is None:
        return np.ones(len(pieces), bool)
    grey = _is_grey(shown)
    # Where data end, libjpeg completes the MCU that it is at with zeros.
    bad = np.asarray((~grey & (np.arange(grey.shape[1]) > sizes[:, None])).any(axis=1))
    for k in np.flatnonzero(bad).tolist():
        # Some cameras pad their data with zeros.
        bare = _mcus(parts, [pieces[k].rstrip(b"\0")], grid)
        bad[k] = bare is None or not _is_grey(bare[0, sizes[k] + 1 :]).all()
    line = np.arange(len(pieces))
    for k in np.flatnonzero(~bad & grey[line, sizes]).tolist():
        coloured = np.flatnonzero(~grey[k, : sizes[k]])
        end = int(coloured[-1]) + 1 if len(coloured) else 0
        if end < sizes[k]:
            bad[k] = _runs_out(parts, pieces[k], end, int(sizes[k]) - end, grid)
        else:
            bad[k] = not _may_turn_grey(parts, shown[k, end - 1])
    return bad


def _may_turn_grey(parts: _Parts, last: NDArray[np.uint8]) -> bool:
    """Whether the bits that fill data's last byte, ones, can change means from an MCU's (n,) to grey in the next one.

    Otherwise that is skipped because data ended within the MCU before it.
    """
    # As the first MCU of a piece, they change grey: zeros follow where data end.
    changes = _mcus(parts, [bytes((0xFF00 >> ones & 0xFF,)) for ones in range(8)], (1, 1))
    if changes is None:
        return True
    channels = len(last) * 64 // (parts.mcu[0] * parts.mcu[1])
    means = last[-channels:].astype(int) + changes[:, 0, :channels]
    return bool((np.abs(means - 2 * _GREY[1]).max(axis=1) <= _MEANS_AGREE).any())


def _runs_out(parts: _Parts, piece: bytes, end: int, grey: int, grid: tuple[int, int]) -> bool:
    """Whether a piece's data hold `end` MCUs only, so that the `grey` ones behind them are missing.

    If not, the bits of grey MCUs may go without an effect on those before them.
    """
    spare = grey * parts.blocks * _FEWEST_BITS // 8
    if spare < 1:
        return False
    less = piece[: max(len(piece) - spare, 0)]
    less = less[:-1] if less[-1:] == b"\xff" else less
    for scale in (1, 8):
        before, after = (_mcus(parts, [data], grid, scale) for data in (piece, less))
        if before is None or after is None or not np.array_equal(before[0, :end], after[0, :end]):
            return True
    return False


def _is_grey(mcus: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which MCUs (..., n) have no coefficients."""
    return np.asarray(np.isin(mcus, _GREY).all(axis=-1))


def _mcus(
    parts: _Parts, pieces: Sequence[bytes], grid: tuple[int, int], scale: int = 8, tail: bytes = _EOI
) -> NDArray[np.uint8] | None:
    """Pieces of a scan, each decoded into MCUs of its own: (k, MCUs, n); None where Pillow refuses them.

    grid : MCUs for each, across and down. scale : how many times smaller pixels are shown; at 1 luma only, since
    colours are mixed with their neighbours'. tail : what follows.
    """
    width, height = (side * cells for side, cells in zip(parts.mcu, grid, strict=True))
    header = bytearray(parts.header)
    struct.pack_into(">HH", header, parts.height_at, height * len(pieces), width)
    data = [_SOI, bytes(header)]
    if len(pieces) > 1:
        data.append(struct.pack(">BBHH", 0xFF, _INTERVAL, 4, grid[0] * grid[1]))
    data.append(parts.scan)
    for k, piece in enumerate(pieces):
        data += [piece, bytes((0xFF, _RESTARTS[k % 8]))]
    data[-1] = tail
    try:
        with JpegImageFile(io.BytesIO(b"".join(data))) as image:
            image.draft("L" if scale == 1 else image.mode, (width // scale, height * len(pieces) // scale))
            pixels = np.asarray(image)
    except (OSError, SyntaxError):
        return None
    across, down = (side // scale for side in parts.mcu)
    cells = pixels.reshape(len(pieces), grid[1], down, grid[0], across, -1).transpose(0, 1, 3, 2, 4, 5)
    return cells.reshape(len(pieces), grid[0] * grid[1], -1)

"""How a JPEG file was quantised: its tables, which component uses which, and how components are subsampled."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL.JpegImagePlugin import JpegImageFile

from capture.arrays import frozen_array

Floats = NDArray[np.float64]


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
    try:
        header = JpegImageFile(io.BytesIO(data))
        across, down = (max(part[axis] for part in header.layer) for axis in (1, 2))
        # Ink (four components) is luma and chroma of the inverted picture, with black apart.
        chosen = header.layer[:3]
        return JpegTables(
            np.array([header.quantization[table] for *_, table in chosen]).reshape(-1, 8, 8),
            tuple((down // high, across // wide) for _, wide, high, _ in chosen),
            header.info.get("adobe_transform") != 0 and bytes(part[0] for part in chosen) != b"RGB",
        )
    except (
        SyntaxError,
        LookupError,
        ValueError,
        ZeroDivisionError,
        OSError,
    ):  # SyntaxError: no JPEG, or cut off
        return None

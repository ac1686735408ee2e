"""A sensor's codes as the files that cameras write: PNG, TIFF, JPEG with EXIF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from synthetic.sensing.dng import rational
from synthetic.sensing.sensor import Sensor

# EXIF 2.3: the sub-directory, and in it time, f-number and ISO.
_EXIF_IFD, _TIME, _F_NUMBER, _ISO = 34665, 33434, 33437, 34855


def write_codes(path: Path, codes: NDArray[np.unsignedinteger], sensor: Sensor) -> None:
    """Write codes (h, w, 3) as PNG or TIFF, recognised by the ending; more than 8 bits fill the range of 16.

    12 and 14 bits are spread so that white is 65535, as RAW converters do: capture reads the file's type, not what
    the converter counted in.
    """
    import cv2

    if sensor.bits not in (8, 16):
        codes = np.round(codes * (65535 / (2**sensor.bits - 1))).astype(np.uint16)
    _, data = cv2.imencode(path.suffix, np.ascontiguousarray(codes[..., ::-1]))
    path.write_bytes(data.tobytes())


def write_jpeg(
    path: Path, codes: NDArray[np.uint8], quality: int, exposure_s: float, iso: int, f_number: float
) -> None:
    """Write codes (h, w, 3) as JPEG with colour halved in both directions, as most cameras do, and EXIF."""
    from PIL import Image
    from PIL.TiffImagePlugin import IFDRational

    exif = Image.Exif()
    exif.get_ifd(_EXIF_IFD).update(
        {_TIME: IFDRational(rational(exposure_s)), _F_NUMBER: IFDRational(rational(f_number)), _ISO: iso}
    )
    exif[_EXIF_IFD] = 0  # Pillow writes the sub-directory only where the main one mentions it
    Image.fromarray(codes).save(path, "JPEG", quality=quality, subsampling="4:2:0", exif=exif)

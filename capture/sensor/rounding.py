"""What rounding to a file's codes adds to a photograph's variance, and nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture.bracket.response import Response
from capture.files.imagefile import check_header, read_file, read_pixels
from capture.radiance import RadianceImage
from capture.sensor.noise import SensorNoise
from capture.srgb import srgb_to_linear

if TYPE_CHECKING:
    from capture.decode import Encoding


def decode_with_rounding(path: Path, encoding: Encoding) -> tuple[RadianceImage, NDArray[np.float32]]:
    """A photograph, and the variance of its rounding to codes (h, w, 3), step^2 / 12.

    The photograph's own variance holds besides what JPEG compression lost, but no noise of a sensor and no doubt about
    a recovered response.
    """
    from capture.decode import decode

    curve = encoding.exact() if isinstance(encoding, Response) else encoding
    image = decode(path, curve, noise=SensorNoise(np.zeros(3), np.zeros(3)))
    if check_header(path, read_file(path)).kind != "JPEG":
        return image, image.variance
    if isinstance(curve, Response):
        table = curve.table(255).T
    else:
        codes = np.arange(256) / 255
        table = np.repeat((codes if curve == "linear" else srgb_to_linear(codes))[:, None], 3, axis=1)
    variance = (np.gradient(table, axis=0) ** 2 / 12).astype(np.float32)
    return image, variance[read_pixels(path), np.arange(3)]

"""Photographs and masks to linear radiance with variance and a saturation mask."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_view
from capture.exposure import relative_exposure
from capture.imagefile import read_pixels
from capture.manifest import RadiometryTable
from capture.photoset import ExposureSettings, Photo, PhotoSet

Encoding = Literal["linear", "srgb"]


@dataclass(frozen=True, eq=False)
class RadianceImage:
    """What the sensor saw, linear.

    radiance : (h, w, 3) float32, relative units; 1 is the white level of an integer file at the
        exposure that the set takes as its unit.
    variance : (h, w, 3) float32, the part of the noise that the file itself tells: quantisation. Sensor
        noise comes on top and is estimated from the fit's residuals.
    saturated : (h, w) bool, true where any channel is at the file's white level; in JPEG
        files also within four pixels of there.
    """

    radiance: NDArray[np.float32]
    variance: NDArray[np.float32]
    saturated: NDArray[np.bool_]

    def __post_init__(self) -> None:
        if self.radiance.shape[2:] != (3,) or self.radiance.shape != self.variance.shape:
            raise ValueError(
                f"radiance {self.radiance.shape} and variance {self.variance.shape} must both be (h, w, 3)"
            )
        if self.saturated.shape != self.radiance.shape[:2]:
            raise ValueError(f"saturated is {self.saturated.shape}, the image {self.radiance.shape[:2]}")
        for name, dtype in (("radiance", np.float32), ("variance", np.float32), ("saturated", np.bool_)):
            object.__setattr__(self, name, frozen_view(getattr(self, name), dtype))


def decode(path: Path, encoding: Encoding = "linear", exposure: float = 1.0) -> RadianceImage:
    """Decode one photograph to linear radiance.

    path : 8- or 16-bit PNG, JPEG or TIFF, or floats: EXR, Radiance .hdr or TIFF (always linear).
    encoding : "linear", or "srgb" to undo the sRGB curve of integer files (IEC 61966-2-1).
    exposure : what the radiance is divided by, relative to the unit exposure, > 0.
    """
    pixels = read_pixels(path)
    if np.issubdtype(pixels.dtype, np.floating):
        return _decode_float(path, pixels, exposure)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: pixels are {pixels.dtype}; 8- or 16-bit integers or floats are needed")
    levels = 255 if pixels.dtype == np.uint8 else 65535
    codes = np.arange(levels + 1) / levels
    linear = codes if encoding == "linear" else srgb_to_linear(codes)
    # A code stands for an interval as wide as one step; uniform in it, the variance is width^2 / 12.
    quantum = np.gradient(linear) ** 2 / 12
    saturated = (pixels == levels).any(axis=2)
    if path.suffix.lower() in (".jpg", ".jpeg"):
        # Compression spreads a clipped pixel's loss over its block of 8, two blocks where colour is halved.
        saturated = cv2.dilate(saturated.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    return RadianceImage(
        radiance=(linear / exposure).astype(np.float32)[pixels],
        variance=(quantum / exposure**2).astype(np.float32)[pixels],
        saturated=saturated,
    )


def decode_photo(photoset: PhotoSet, photo: Photo) -> RadianceImage:
    """Decode a photograph of a set as its manifest says, and check it against its camera."""
    size = (photo.camera.height, photo.camera.width)
    return decode_in_set(photoset.radiometry, photo.file, photo.exposure, size)


def decode_in_set(
    radiometry: RadiometryTable, path: Path, settings: ExposureSettings, size: tuple[int, int]
) -> RadianceImage:
    """Decode a photograph shot under a set's radiometry, whose camera has (height, width) `size`."""
    if radiometry.encoding == "response":
        raise ValueError(
            f"{path}: [radiometry] encoding = 'response' needs a recovered response curve, which this version"
            " cannot apply yet; convert the photographs to linear files or use 'linear' or 'srgb'"
        )
    image = decode(path, radiometry.encoding, relative_exposure(path, radiometry.exposure, settings))
    check_size(path, image.radiance, size)
    return image


def read_mask(path: Path, size: tuple[int, int]) -> NDArray[np.float32]:
    """A mask as coverage, (h, w) float32 in 0 to 1; nonzero is the object, grey levels are partial cover."""
    pixels = read_pixels(path).max(axis=2).astype(np.float32)
    check_size(path, pixels, size)
    bad = int((~np.isfinite(pixels)).sum())
    if bad:
        raise ValueError(f"{path}: the mask holds {bad} values that are not finite")
    peak = pixels.max()
    if not peak > 0:
        raise ValueError(f"{path}: the mask is empty; it must be nonzero where the object is")
    return pixels / peak


def check_size(path: Path, pixels: NDArray[np.generic], size: tuple[int, int]) -> None:
    """ValueError unless an image is as large as its camera says, (height, width)."""
    if pixels.shape[:2] != size:
        raise ValueError(
            f"{path}: is {pixels.shape[1]}x{pixels.shape[0]} pixels, but its camera is {size[1]}x{size[0]};"
            " give the camera of this photo, or the photo that belongs to this camera"
        )


def srgb_to_linear(codes: NDArray[np.floating]) -> NDArray[np.float64]:
    """The sRGB decoding curve (IEC 61966-2-1), codes and result in 0 to 1."""
    codes = np.asarray(codes, float)
    return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: NDArray[np.floating]) -> NDArray[np.float64]:
    """The sRGB encoding curve (IEC 61966-2-1), values and result in 0 to 1; for pictures to look at."""
    linear = np.asarray(linear, float)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _decode_float(path: Path, pixels: NDArray[np.generic], exposure: float) -> RadianceImage:
    radiance = pixels.astype(np.float32) / np.float32(exposure)
    bad = ~np.isfinite(radiance).all(axis=2)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise ValueError(
            f"{path}: {int(bad.sum())} pixels are not finite (NaN or infinite), the first at column {column},"
            f" row {row}; render or export the photograph again"
        )
    step = _float_step(path, pixels) / np.float32(exposure)
    return RadianceImage(
        radiance=radiance,
        variance=np.broadcast_to(step**2 / 12, radiance.shape),
        saturated=np.zeros(radiance.shape[:2], bool),
    )


def _float_step(path: Path, pixels: NDArray[np.generic]) -> NDArray[np.float32]:
    """The step between neighbouring stored numbers, broadcastable to the pixels; float32's counts as none."""
    if pixels.dtype == np.float16:
        return np.spacing(np.abs(pixels)).astype(np.float32)
    if path.suffix.lower() == ".hdr":
        # RGBE: three mantissas of 8 bits share the exponent of the brightest channel.
        _, exponent = np.frexp(pixels.max(axis=2, keepdims=True))
        return np.ldexp(np.float32(1), exponent - 8)
    return np.zeros(1, np.float32)

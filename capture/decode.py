"""Photographs and masks to linear radiance with variance and a saturation mask."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.arrays import reused_empty
from capture.bracket.response import Response
from capture.chart.colormatrix import ColorMatrix
from capture.clipping import cut_off
from capture.exposure import ExposureSettings, relative_exposure
from capture.files.imagefile import read_cover, read_exr_layers, read_file, read_image, rgbe_step
from capture.files.imageheader import Header, is_raw
from capture.files.jpegtables import JpegTables, jpeg_tables
from capture.files.rawfile import read_raw
from capture.photo import Photo
from capture.radiance import LOSSY_REACH, Image, Places, RadianceImage
from capture.radiometry import Radiometry
from capture.sensor.flatfield import FlatField
from capture.sensor.jpegnoise import BLOCK, jpeg_code_variance
from capture.sensor.noise import SensorNoise, Step, estimate_noise
from capture.srgb import srgb_to_linear

Encoding = Literal["linear", "srgb"] | Response
Codes = NDArray[Any]
Floats = NDArray[np.float64]


def decode(
    path: Path,
    encoding: Encoding = "linear",
    exposure: float = 1.0,
    *,
    noise: SensorNoise | None = None,
    flat_field: FlatField | None = None,
    white_balance: NDArray[np.floating] | None = None,
    color: ColorMatrix | None = None,
) -> RadianceImage:
    """Decode one photograph to linear radiance.

    path : camera RAW; 8- or 16-bit PNG, JPEG or TIFF; or floats: EXR, Radiance .hdr or TIFF. RAW and floats are
        always linear.
    encoding : of integer files: "linear", "srgb" to undo the sRGB curve (IEC 61966-2-1), or a recovered response.
    exposure : what the radiance is divided by, relative to the unit exposure, > 0.
    noise : the sensor's read and shot noise. Without it, that of integer and RAW files is estimated from the
        photograph itself, once its variance is asked for, and floats have what an EXR states in channels
        variance.R, .G, .B (and saturated), as merged brackets do. Quantisation is added, JPEG's too. Floats that don't
        state where they are saturated are so where they were cut off (`clipping`).
    flat_field : relative illumination over the image, divided out.
    white_balance : (3,) factors that the channels are multiplied by.
    color : to linear sRGB, by a chart; without it colours are the camera's own.
    """
    scale = (np.ones(3) if white_balance is None else np.asarray(white_balance, float)) / exposure
    if is_raw(path):
        image = _decode_raw(path, noise, scale)
    else:
        pixels, header = read_image(path)
        if np.issubdtype(pixels.dtype, np.floating):
            image = _decode_float(path, pixels, header.kind, noise, scale)
        else:
            image = _decode_integers(path, pixels, header, encoding, noise, scale)
    image = image if flat_field is None else _flattened(path, image, flat_field)
    return image if color is None else color.applied(image)


def decode_photo(radiometry: Radiometry, photo: Photo) -> RadianceImage:
    """Decode a photograph as its set's radiometry says, and check it against its camera.

    Through a polarising filter, radiance is that which unpolarised light would have without it.
    """
    size = (photo.camera.height, photo.camera.width)
    passed = 1.0 if photo.polariser is None else photo.polariser.transmission
    return decode_in_set(radiometry, photo.file, photo.exposure, size, passed)


def photo_mask(photo: Photo) -> Image | None:
    """The mask of a photograph of a set as coverage, (h, w) float32 in 0 to 1; None if it has none."""
    if photo.mask is None:
        return None
    return read_mask(photo.mask, (photo.camera.height, photo.camera.width))


def decode_in_set(
    radiometry: Radiometry,
    path: Path,
    settings: ExposureSettings,
    size: tuple[int, int],
    transmission: float = 1.0,
) -> RadianceImage:
    """Decode a photograph shot under a set's radiometry, whose camera has (height, width) `size`.

    transmission : what a filter before the camera passes of unpolarised light, divided out.
    """
    image = decode(
        path,
        radiometry.encoding,
        transmission * relative_exposure(path, radiometry.exposure, settings),
        noise=radiometry.noise,
        flat_field=radiometry.flat_field,
        white_balance=radiometry.white_balance,
        color=radiometry.color,
    )
    check_size(path, image.radiance, size)
    return image


def read_mask(path: Path, size: tuple[int, int]) -> NDArray[np.float32]:
    """A mask as coverage, (h, w) float32 in 0 to 1; nonzero is the object, grey levels are partial cover.

    Of a file with an alpha channel this is the mask, unless it is the same everywhere.
    """
    pixels = read_cover(path)
    check_size(path, pixels, size, "give the mask of this photo, drawn at its size")
    peak = float(pixels.max())
    if np.issubdtype(pixels.dtype, np.floating) and not np.isfinite(pixels.sum(dtype=np.float64)):
        bad = int((~np.isfinite(pixels)).sum())
        raise ValueError(f"{path}: the mask holds {bad} values that are not finite")
    if not peak > 0:
        raise ValueError(f"{path}: the mask is empty; it must be nonzero where the object is")
    if pixels.dtype == np.uint8:
        # Twice as fast as dividing, and the same.
        shares = np.divide(np.arange(256), np.float32(peak), dtype=np.float32)
        return np.asarray(cv2.LUT(np.ascontiguousarray(pixels), shares))
    return np.divide(pixels, np.float32(peak), dtype=np.float32)


def check_size(
    path: Path,
    pixels: NDArray[np.generic],
    size: tuple[int, int],
    remedy: str = "give the camera of this photo, or the photo that belongs to this camera",
) -> None:
    """ValueError unless an image is as large as its camera says, (height, width). remedy : what to do then."""
    if pixels.shape[:2] != size:
        raise ValueError(
            f"{path}: is {pixels.shape[1]}x{pixels.shape[0]} pixels, but its camera is {size[1]}x{size[0]}; {remedy}"
        )


def _decode_integers(
    path: Path, pixels: Codes, header: Header, encoding: Encoding, noise: SensorNoise | None, scale: Floats
) -> RadianceImage:
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: pixels are {pixels.dtype}; 8- or 16-bit integers or floats are needed")
    levels = 255 if pixels.dtype == np.uint8 else 65535
    if isinstance(encoding, Response):
        table, curve_variance = encoding.table(levels).T, encoding.variance_table(levels).T
        brightest = encoding.brightest(levels)
    else:
        codes = np.arange(levels + 1) / levels
        table = np.repeat((codes if encoding == "linear" else srgb_to_linear(codes))[:, None], 3, axis=1)
        curve_variance, brightest = np.zeros(1), np.full(3, levels - 1)

    @cache
    def noise_model() -> tuple[SensorNoise, JpegTables | None]:
        model = noise or _own_noise(pixels, _step_at(table.mean(axis=1)), table.astype(np.float32))
        return model, jpeg_tables(read_file(path).data) if header.kind == "JPEG" else None

    def variance_of(codes: Codes) -> Image:
        model, tables = noise_model()
        slope = np.gradient(table, axis=0)
        # A code stands for an interval as wide as one step; uniform in it, the variance is width^2 / 12.
        quantum = slope**2 / 12
        total = _looked_up(codes, (quantum + curve_variance + model.variance(table)) * scale**2)
        if tables is not None:
            total += jpeg_code_variance(codes, tables) * _looked_up(codes, (slope * scale) ** 2)
        return total

    def variance_at(rows: Places, columns: Places) -> Image:
        if not len(rows):
            return np.zeros((0, 3), np.float32)
        _, tables = noise_model()
        # What compression did to a pixel follows from its whole block.
        side = 1 if tables is None else BLOCK * max(max(pair) for pair in tables.reduction)
        tiles, places = _tiles_at(pixels, rows, columns, side)
        return np.asarray(variance_of(tiles)[places])

    dark = reused_empty(pixels.shape[:2], np.uint8)  # 255 where no channel is saturated
    cv2.inRange(pixels, (0, 0, 0), tuple(map(int, brightest)), dark)
    if header.lossy:
        cv2.erode(dark, LOSSY_REACH, dark)
    saturated = np.equal(dark, 0, out=reused_empty(dark.shape, np.bool_))
    radiance = _looked_up(pixels, table * scale)
    return RadianceImage(radiance, lambda: variance_of(pixels), saturated, variance_at)


def _tiles_at(pixels: Codes, rows: Places, columns: Places, side: int) -> tuple[Codes, tuple[Places, Places]]:
    """The square tiles, side by side, that hold given pixels, and the pixels' rows and columns among them.

    Beyond the image its last row and column are repeated.
    """
    height, width = pixels.shape[:2]
    across = -(-width // side)
    numbers, tile = np.unique(rows // side * across + columns // side, return_inverse=True)
    down, along = np.divmod(numbers, across)
    step = np.arange(side)
    y = np.minimum(down * side + step[:, None], height - 1)  # (side, tiles)
    x = np.minimum(along * side + step[:, None], width - 1)
    tiles = pixels[y[:, :, None], x.T[None]]  # (side, tiles, side, 3)
    places = rows % side, tile * side + columns % side
    return np.ascontiguousarray(tiles.reshape(side, -1, 3)), places


def _step_at(table: Floats) -> Callable[[NDArray[np.floating]], Floats]:
    """The step between neighbouring codes, as a function of the linear signal."""
    steps = np.gradient(table)
    return lambda signal: np.interp(signal, table, steps)


def _own_noise(linear: Codes, step: Step, table: Image | None = None) -> SensorNoise:
    """The noise that a photograph shows of itself, as of `estimate_noise`; none where all is black or saturated."""
    try:
        return estimate_noise(linear, step, table)
    except ValueError:
        return SensorNoise(np.zeros(3), np.zeros(3))


def _looked_up(pixels: Codes, table: Floats) -> Image:
    """Each code's entry of a table (levels + 1, 3), per channel."""
    entries = table.astype(np.float32)
    # One table for all channels is twice as fast to look up as three.
    same = (entries == entries[:, :1]).all()
    lookup = np.ascontiguousarray(entries[:, 0]) if same else np.ascontiguousarray(entries[None])
    image = reused_empty(pixels.shape)
    return np.asarray(cv2.LUT(pixels, lookup, image))


def _decode_raw(path: Path, noise: SensorNoise | None, scale: Floats) -> RadianceImage:
    raw = read_raw(path)
    model = noise or _own_noise(raw.mosaic, raw.step)
    factor = scale.astype(np.float32)

    def variance() -> Image:
        return (model.variance(raw.linear) + np.float32(raw.step**2 / 12)) * factor**2

    def variance_at(rows: Places, columns: Places) -> Image:
        return (model.variance(raw.linear[rows, columns]) + np.float32(raw.step**2 / 12)) * factor**2

    return RadianceImage(raw.linear * factor, variance, raw.saturated, variance_at)


def _decode_float(
    path: Path, pixels: NDArray[np.generic], kind: str, noise: SensorNoise | None, scale: Floats
) -> RadianceImage:
    linear = pixels.astype(np.float32)
    bad = ~np.isfinite(linear).all(axis=2)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise ValueError(
            f"{path}: {int(bad.sum())} pixels are not finite (NaN or infinite), the first at column {column},"
            f" row {row}; render or export the photograph again"
        )
    factor = scale.astype(np.float32)
    layers = read_exr_layers(path) if kind == "EXR" else {}
    stated = layers.get("variance", np.zeros(1, np.float32)).astype(np.float32)
    if stated.shape not in ((1,), linear.shape) or not (np.isfinite(stated) & (stated >= 0)).all():
        raise ValueError(
            f"{path}: its channels variance.R, .G, .B must hold variances: finite and not negative"
        )

    def variance() -> Image:
        own = np.broadcast_to(stated + _float_step(kind, pixels) ** 2 / 12, linear.shape)
        return np.asarray((own if noise is None else own + noise.variance(linear)) * factor**2, np.float32)

    clipped = layers["saturated"] > 0 if "saturated" in layers else cut_off(linear, kind)
    return RadianceImage(linear * factor, variance, clipped)


def _float_step(kind: str, pixels: NDArray[np.generic]) -> Image:
    """The step between neighbouring stored numbers, broadcastable to the pixels; float32's counts as none."""
    if pixels.dtype == np.float16:
        return np.spacing(np.abs(pixels)).astype(np.float32)
    if kind == "Radiance":
        return rgbe_step(pixels)
    return np.zeros(1, np.float32)


def _flattened(path: Path, image: RadianceImage, flat_field: FlatField) -> RadianceImage:
    height, width = image.saturated.shape
    try:
        illumination = flat_field.gain(width, height)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return RadianceImage(
        image.radiance / illumination,
        lambda: image.variance / illumination**2,
        image.saturated,
        lambda rows, columns: (
            image.variance_at(rows, columns)
            / np.broadcast_to(illumination, image.radiance.shape)[rows, columns] ** 2
        ),
    )

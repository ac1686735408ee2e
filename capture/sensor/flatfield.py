"""Flat fields: how much of the light each pixel receives, relative to where the lens gives most."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array, frozen_view
from capture.files.documents import read_json
from capture.files.imagefile import read_pixels
from capture.files.tables import Table

Floats = NDArray[np.float64]
Image = NDArray[np.float32]

# Three orders are usual; a cos^4 law at 40 degrees still differs by a percent from three, by 0.1% from five.
ORDERS = 5
# Below this share of the light an image can't be corrected: noise is all that would be brought up.
LEAST_ILLUMINATION = 0.05


@dataclass(frozen=True, eq=False)
class RadialFlatField:
    """Vignetting as a polynomial 1 + a1 r^2 + a2 r^4 + a3 r^6 + ... (after Goldman and Chen, "Vignette and exposure
    calibration and compensation", 2005), r being the distance from the centre over half the image's diagonal.

    width, height : pixels of the photographs.
    centre : (2,) float64, x and y in pixels. coefficients : (3, 5) float64, RGB by order; 0 beyond the chosen order.
    covariance : (17, 17) float64 of centre and coefficients, row by row; 0 for what was not fitted.
    structured : (3,) float64, what the polynomial leaves beyond noise, RMS relative to the illumination.
    """

    width: int
    height: int
    centre: Floats
    coefficients: Floats
    covariance: Floats
    structured: Floats

    def __post_init__(self) -> None:
        shapes = {"centre": (2,), "coefficients": (3, ORDERS), "structured": (3,)}
        shapes["covariance"] = (2 + 3 * ORDERS, 2 + 3 * ORDERS)
        for name, shape in shapes.items():
            value = frozen_array(getattr(self, name))
            if value.shape != shape or not np.isfinite(value).all():
                raise ValueError(f"{name} has shape {value.shape}; it must be {shape}, and finite")
            object.__setattr__(self, name, value)

    def gain(self, width: int, height: int) -> Image:
        """Relative illumination (h, w, 3) float32, 1 at the centre; ValueError for photographs of another size.

        Radiance is divided by it, variance by its square.
        """
        _check_size(self, width, height)
        squares = self._squares()
        illumination = np.empty((height, width, 3), np.float32)
        for channel, coefficients in enumerate(self.coefficients):
            illumination[..., channel] = np.polynomial.polynomial.polyval(squares, [1, *coefficients])
        lowest = float(illumination.min())
        if lowest < LEAST_ILLUMINATION:
            raise ValueError(
                f"the flat field falls to {lowest:.1%} of the light; below {LEAST_ILLUMINATION:.0%} nothing can be"
                " corrected: crop the photographs, or use another lens"
            )
        return illumination

    def std(self, width: int, height: int) -> Image:
        """Standard deviation of `gain`, (h, w, 3) float32."""
        _check_size(self, width, height)
        illumination = self.gain(width, height)
        radius = half_diagonal(width, height)
        x, y = _offsets(self)
        squares = self._squares()
        powers = squares[..., None] ** np.arange(1, ORDERS + 1)
        result = np.empty_like(illumination)
        for channel, coefficients in enumerate(self.coefficients):
            derivative = np.polynomial.polynomial.polyder([1, *coefficients])
            slope = -2 / radius**2 * np.polynomial.polynomial.polyval(squares, derivative)
            towards = np.concatenate([(slope * x)[..., None], (slope * y)[..., None], powers], axis=-1)
            chosen = [0, 1, *range(2 + ORDERS * channel, 2 + ORDERS * (channel + 1))]
            part = self.covariance[np.ix_(chosen, chosen)]
            variance = np.einsum("hwi,ij,hwj->hw", towards, part, towards, optimize=True)
            # Once at the pixel and once at the centre, where the gain is 1 by definition.
            misfit = 2 * (self.structured[channel] * illumination[..., channel]) ** 2
            result[..., channel] = np.sqrt(variance + misfit)
        return result

    def _squares(self) -> Floats:
        x, y = _offsets(self)
        return (x**2 + y**2) / half_diagonal(self.width, self.height) ** 2


@dataclass(frozen=True, eq=False)
class FlatFieldMap:
    """Relative illumination pixel by pixel.

    illumination : (h, w, 3) float32, 1 at its smooth maximum in each channel.
    relative_std : (3,) float64, its standard deviation relative to it, RMS over the image.
    """

    illumination: Image
    relative_std: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "illumination", frozen_view(self.illumination, np.float32))
        object.__setattr__(self, "relative_std", frozen_array(self.relative_std))
        if self.illumination.ndim != 3 or self.illumination.shape[2] != 3:
            raise ValueError(f"illumination is {self.illumination.shape}; it must be (h, w, 3)")
        lowest = float(self.illumination.min())
        if not lowest >= LEAST_ILLUMINATION:
            raise ValueError(
                f"the flat field falls to {lowest:.1%} of the light; below {LEAST_ILLUMINATION:.0%} nothing can be"
                " corrected: crop the photographs, or use another lens"
            )

    @property
    def width(self) -> int:
        return self.illumination.shape[1]

    @property
    def height(self) -> int:
        return self.illumination.shape[0]

    def gain(self, width: int, height: int) -> Image:
        """Relative illumination (h, w, 3) float32; ValueError for photographs of another size."""
        _check_size(self, width, height)
        return self.illumination

    def std(self, width: int, height: int) -> Image:
        """Standard deviation of `gain`, (h, w, 3) float32."""
        _check_size(self, width, height)
        return self.illumination * self.relative_std.astype(np.float32)


FlatField = RadialFlatField | FlatFieldMap


def half_diagonal(width: int, height: int) -> float:
    """The unit of r, in pixels."""
    return float(np.hypot(width, height) / 2)


class _Radial(Table):
    centre: tuple[float, float]
    centre_std: tuple[float, float]
    coefficients: tuple[tuple[float, ...], ...]
    coefficients_std: tuple[tuple[float, ...], ...]
    covariance: tuple[tuple[float, ...], ...]
    structured_rms_relative: tuple[float, float, float]


class _Map(Table):
    file: str
    relative_std: tuple[float, float, float]


class _FlatFieldTable(Table):
    format: int
    kind: Literal["radial", "map"]
    width: int
    height: int
    radial: _Radial | None
    map: _Map | None


def read_flat_field(path: Path) -> FlatField:
    """The flat field that a flatfield.json holds, or names: a map lies beside it as an EXR."""
    what = (
        "a flatfield.json, as 'lightfactor calibrate flatfield' writes it, holds format, kind, width, height"
    )
    table = read_json(path, _FlatFieldTable, _FlatFieldTable.model_fields, what)
    if table.format != 1:
        raise ValueError(f"{path}: format is {table.format}; this version reads format 1")
    part = table.radial if table.kind == "radial" else table.map
    if part is None:
        raise ValueError(f"{path}: kind is {table.kind!r}, but {table.kind} is null; make it again")
    try:
        if isinstance(part, _Radial):
            return RadialFlatField(
                table.width,
                table.height,
                np.array(part.centre),
                np.array(part.coefficients),
                np.array(part.covariance),
                np.array(part.structured_rms_relative),
            )
        flat_field = FlatFieldMap(
            read_pixels(path.with_name(part.file)).astype(np.float32), np.array(part.relative_std)
        )
        _check_size(flat_field, table.width, table.height)
        return flat_field
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _check_size(flat_field: FlatField, width: int, height: int) -> None:
    if (flat_field.width, flat_field.height) != (width, height):
        raise ValueError(
            f"is {width}x{height} pixels, but the flat field is {flat_field.width}x{flat_field.height};"
            " photograph flat fields at the size, crop and orientation of the photographs"
        )


def _offsets(flat_field: RadialFlatField) -> tuple[Floats, Floats]:
    """x (1, w) and y (h, 1) of the pixels from the centre, pixels."""
    x = np.arange(flat_field.width) + 0.5 - flat_field.centre[0]
    y = np.arange(flat_field.height) + 0.5 - flat_field.centre[1]
    return x[None, :], y[:, None]

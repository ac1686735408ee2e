"""A camera's colour matrix as a color.json holds it, and what it makes of a photograph."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.files.documents import read_json
from capture.files.tables import Table
from capture.radiance import Image, RadianceImage

Floats = NDArray[np.float64]
_Row = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class ColorMatrix:
    """Linear sRGB of linear camera RGB, and how certain it is.

    matrix : (3, 3). covariance : (9, 9) of it, row by row.
    """

    matrix: Floats
    covariance: Floats

    def __post_init__(self) -> None:
        for name, shape in (("matrix", (3, 3)), ("covariance", (9, 9))):
            value = frozen_array(getattr(self, name))
            if value.shape != shape or not np.isfinite(value).all():
                raise ValueError(f"{name} must be {shape[0]} rows of {shape[1]} finite numbers")
            object.__setattr__(self, name, value)
        if np.linalg.cond(self.matrix) > 1e6:
            raise ValueError("matrix is singular: it makes two colours of the camera one")

    @property
    def relative_covariance(self) -> Floats:
        """Covariance (9, 9) of dM M^-1, row by row: by it linear sRGB is off, whatever the camera's own colours are."""
        change = np.kron(np.eye(3), np.linalg.inv(self.matrix).T)
        return np.asarray(change @ self.covariance @ change.T)

    def applied(self, image: RadianceImage) -> RadianceImage:
        """A photograph in linear sRGB; its channels' noise, which they share now, is told channel by channel."""
        squares = (self.matrix**2).astype(np.float32)
        matrix = self.matrix.astype(np.float32)

        def mixed(values: Image, by: NDArray[np.float32]) -> Image:
            return np.asarray(cv2.transform(np.ascontiguousarray(values), by), np.float32)

        return RadianceImage(
            mixed(image.radiance, matrix),
            lambda: mixed(image.variance, squares),
            image.saturated,
            lambda rows, columns: np.asarray(image.variance_at(rows, columns) @ squares.T, np.float32),
        )


class _ColorTable(Table):
    format: int
    matrix: tuple[_Row, _Row, _Row]
    covariance: tuple[tuple[float, ...], ...]


def read_color(path: Path) -> ColorMatrix:
    """The matrix of a color.json; ValueError names what is wrong with it."""
    what = "a color.json, as 'lightfactor calibrate color' writes it, holds format, matrix and covariance"
    table = read_json(path, _ColorTable, ("format", "matrix", "covariance"), what)
    if table.format != 1:
        raise ValueError(f"{path}: format is {table.format}; this version reads format 1")
    if len(table.covariance) != 9 or {len(row) for row in table.covariance} != {9}:
        raise ValueError(f"{path}: covariance must have nine rows of nine numbers, for the matrix row by row")
    try:
        return ColorMatrix(np.array(table.matrix), np.array(table.covariance))
    except ValueError as error:
        raise ValueError(f"{path}: {error}; make it again with 'lightfactor calibrate color'") from error

"""The noise of a sensor: what read and shot noise are, for a file or as a guess from a single photograph."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.files.documents import read_json
from capture.files.tables import Table
from capture.sensor.blindnoise import Places, noise_line

Floats = NDArray[np.float64]
# Distance of neighbouring codes, a number or a function of the signal.
Step = float | Callable[[NDArray[np.floating]], NDArray[np.floating]]


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Read and shot noise of a linear signal, variance = read_std^2 + shot * signal (Janesick 2007).

    The signal is linear with 1 at the file's white level. Quantisation comes on top: the decoder adds it, which
    knows the step of each code.

    read_std : (3,) float64, standard deviation in the dark, RGB, >= 0.
    shot : (3,) float64, variance per unit signal, RGB, >= 0: 1 / full well in electrons.
    covariance : (3, 2, 2) float64 of (read_std, shot) in each channel; None where nobody estimated it.
    """

    read_std: Floats
    shot: Floats
    covariance: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("read_std", "shot"):
            value = frozen_array(getattr(self, name))
            if value.shape != (3,) or not np.isfinite(value).all() or (value < 0).any():
                raise ValueError(f"{name} is {value.tolist()}; it must be three finite numbers >= 0")
            object.__setattr__(self, name, value)
        if self.covariance is not None:
            covariance = frozen_array(self.covariance)
            if covariance.shape != (3, 2, 2):
                raise ValueError(f"covariance has shape {covariance.shape}; it must be (3, 2, 2)")
            object.__setattr__(self, "covariance", covariance)

    def variance(self, linear: NDArray[np.floating]) -> NDArray[np.float32]:
        """Variance of a linear signal (..., 3), float32, same shape; below zero the shot noise is none."""
        read = (self.read_std**2).astype(np.float32)
        return read + self.shot.astype(np.float32) * np.maximum(linear, 0).astype(np.float32, copy=False)


def estimate_noise(
    linear: NDArray[Any], step: Step = 0.0, table: NDArray[np.floating] | None = None
) -> SensorNoise:
    """Read and shot noise guessed from one photograph, where nobody has measured them.

    linear : (h, w, 3), or (h, w) the mosaic of a RAW file; 1 at the white level. table : (levels, 3), what codes stand
    for where `linear` holds codes (h, w, 3) instead: a few of them are looked at. step : distance of neighbouring
    codes in the same unit, a number, or a function of the signal (same shape) where the encoding is curved.
    ValueError if too little of it is neither saturated nor black.

    It sees noise from pixel to pixel. JPEG compression, demosaicing and noise reduction take the finest part of it
    away and correlate the rest: the guess is then too low for means over many pixels. A photograph without any
    smooth place makes it too high.
    """
    if linear.ndim not in (2, 3) or linear.shape[2:] not in ((), (1,), (3,)):
        raise ValueError(f"the photograph is {linear.shape}; it must be (h, w, 3), or (h, w) for a mosaic")
    values = linear[..., 0] if linear.shape[2:] == (1,) else linear

    def picked(rows: Places, columns: Places) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        found = values[rows, columns]
        if table is not None:
            # Steps by code, not by signal: a look-up in place of a search.
            return table[found, np.arange(3)], np.broadcast_to(_steps(step, table), table.shape)[
                found, np.arange(3)
            ]
        return found, np.broadcast_to(_steps(step, found), found.shape)

    offsets, slopes = noise_line(values.shape, picked)
    return SensorNoise(np.broadcast_to(np.sqrt(offsets), 3), np.broadcast_to(slopes, 3))


def _steps(step: Step, signal: NDArray[np.floating]) -> NDArray[np.floating] | float:
    return step(signal) if callable(step) else step


class _Estimates(Table):
    value: tuple[float | None, float | None, float | None]
    std: tuple[float | None, float | None, float | None]
    at_most: tuple[float, float, float]


class _NoiseTable(Table):
    format: int
    read_std: _Estimates
    shot: _Estimates


def read_noise_model(path: Path) -> SensorNoise:
    """The model that a noise.json holds; where a number is undetermined, the largest that it may be."""
    what = "a noise.json, as 'lightfactor calibrate noise' writes it, holds format, read_std and shot"
    table = read_json(path, _NoiseTable, ("format", "read_std", "shot"), what)
    if table.format != 1:
        raise ValueError(f"{path}: format is {table.format}; this version reads format 1")
    numbers = [
        [limit if value is None else value for value, limit in zip(part.value, part.at_most, strict=True)]
        for part in (table.read_std, table.shot)
    ]
    try:
        return SensorNoise(np.array(numbers[0]), np.array(numbers[1]))
    except ValueError as error:
        raise ValueError(f"{path}: {error}; make it again with 'lightfactor calibrate noise'") from error

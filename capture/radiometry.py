"""How the numbers in a set's files stand for light: response, noise, flat field, colours, exposure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from capture.bracket.response import Response, read_response
from capture.chart.colormatrix import ColorMatrix, read_color
from capture.exposure import ExposureSource
from capture.files.imageheader import is_raw
from capture.files.rawfile import camera_white_balance
from capture.manifest import RadiometryTable
from capture.sensor.flatfield import FlatField, read_flat_field
from capture.sensor.noise import SensorNoise, read_noise_model


@dataclass(frozen=True, eq=False)
class Radiometry:
    """How all photographs of a set become radiance; the fields are as in `capture.decode.decode`."""

    encoding: Literal["linear", "srgb"] | Response = "linear"
    exposure: ExposureSource = "equal"
    noise: SensorNoise | None = None
    flat_field: FlatField | None = None
    white_balance: NDArray[np.float64] | None = None
    color: ColorMatrix | None = None


def read_radiometry(
    table: RadiometryTable, resolve: Callable[[str], Path], photos: Sequence[Path]
) -> Radiometry:
    """A manifest's [radiometry] with the calibration files that it names.

    resolve : a path as the manifest writes it to one that can be opened.
    photos : the set's; with white_balance = "camera", the first RAW file among them gives the factors for all. With
    "reference" there are none yet: these are read off a photograph that is decoded so far.
    """
    white_balance = None
    if table.white_balance == "camera":
        raw = next((path for path in photos if is_raw(path)), None)
        if raw is None:
            raise ValueError(
                "[radiometry] white_balance = 'camera', but no photo is camera RAW; give three factors"
                " [red, green, blue], or 'none'"
            )
        white_balance = camera_white_balance(raw)
    elif table.white_balance not in ("none", "reference"):
        white_balance = np.array(table.white_balance)
    return Radiometry(
        encoding=_encoding(table, resolve),
        exposure=table.exposure,
        noise=read_noise_model(resolve(table.noise)) if table.noise else None,
        flat_field=read_flat_field(resolve(table.flat_field)) if table.flat_field else None,
        white_balance=white_balance,
        color=read_color(resolve(table.color)) if table.color else None,
    )


def _encoding(table: RadiometryTable, resolve: Callable[[str], Path]) -> Literal["linear", "srgb"] | Response:
    if table.encoding != "response" or table.file is None:
        return "linear" if table.encoding == "linear" else "srgb"
    return read_response(resolve(table.file))

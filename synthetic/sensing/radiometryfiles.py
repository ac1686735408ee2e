"""What calibration would find if it made no errors: response, noise and flat field in capture's own files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.bracket.response import Response, response_channels
from capture.files.documents import software, write_json
from capture.files.imagefile import write_exr
from capture.sensor.flatfield import FlatFieldMap
from synthetic.sensing.development import Development
from synthetic.sensing.sensor import Sensor, signal_of, vignetting

Floats = NDArray[np.float64]

# Names that a folder of them holds.
RADIOMETRY_FILES = ("response.json", "noise.json", "flatfield.json", "flatfield.exr")


def write_radiometry(folder: Path, development: Development, width: int, height: int) -> dict[str, Any]:
    """Write a camera's true calibration into a folder; returns the keys of [radiometry] that name the files.

    response.json where the response has no name in capture; flatfield.json and .exr where the lens vignettes; and
    noise.json. Decoded by them, photographs of width x height pixels are the true radiance times
    `development.radiance_factor`. ValueError if the vignetting is too deep to be divided out.
    """
    sensor = development.sensor
    about = {"format": 1, "inputs": {}, "software": software()}
    keys: dict[str, Any] = {"encoding": development.encoding, "exposure": development.exposure}
    if development.encoding == "response":
        keys["file"] = "response.json"
        gauge = "absolute: exposure 1 is the white level"
        unit = "natural logarithm of the exposure; value k / (n - 1) at index k of n"
        channels = response_channels(true_response(sensor))
        write_json(folder / "response.json", {**about, "gauge": gauge, "unit": unit, "channels": channels})
    if np.isfinite(sensor.focal_px):
        keys["flat_field"] = "flatfield.json"
        _write_flat_field(folder, sensor, width, height, about)
    keys["noise"] = "noise.json"
    read_std, shot = true_noise(development)
    numbers = {"read_std": _exactly(read_std), "shot": _exactly(shot)}
    unit = "signal relative to the file's white level; variance = read_std^2 + shot * signal"
    write_json(folder / "noise.json", {**about, "unit": unit, **numbers})
    return keys


def true_response(sensor: Sensor) -> Response:
    """The sensor's response as capture holds it: 256 knots for 8 bits, 1024 for more, exposure 1 at white."""
    knots = 256 if sensor.bits == 8 else 1024
    signal = signal_of(np.arange(1, knots) / (knots - 1), sensor)
    # The logarithm of value 0 is no number; just above it, exposure grows in proportion to the value.
    log_exposure = np.concatenate([[np.nan], np.log(signal)])
    log_std = np.where(np.isnan(log_exposure), np.nan, 0.0)
    return Response(np.tile(log_exposure, (3, 1)), np.tile(log_std, (3, 1)), np.tile([0.0, 1.0], (3, 1)))


def true_noise(development: Development) -> tuple[Floats, Floats]:
    """Read noise and variance per unit signal, (3,) each, of the signal that is 1 at white.

    They are a photosite's: interpolation of a mosaic and JPEG compression, which come later, make less of it. Where 12
    or 14 bits are spread over 16, of which the file's readers know nothing, the coarser rounding counts as read noise.
    """
    sensor = development.sensor
    variance = (sensor.read_noise / sensor.full_well) ** 2
    if development.file != "dng" and sensor.bits in (12, 14):
        coarse, fine = 1 / (2**sensor.bits - 1), 1 / 65535
        variance = variance + (coarse**2 - fine**2) / 12
    return np.sqrt(variance), 1 / sensor.full_well


def _write_flat_field(folder: Path, sensor: Sensor, width: int, height: int, about: dict[str, Any]) -> None:
    illumination = np.repeat(vignetting(sensor, width, height)[..., None], 3, axis=2)
    try:
        FlatFieldMap(illumination.astype(np.float32), np.zeros(3))
    except ValueError as error:
        raise ValueError(f"focal_px = {sensor.focal_px} at {width}x{height} pixels: {error}") from error
    write_exr(folder / "flatfield.exr", illumination)
    document = {
        **about,
        "kind": "map",
        "width": width,
        "height": height,
        "unit": "illumination relative to the optical axis",
        "radial": None,
        "map": {"file": "flatfield.exr", "relative_std": [0.0, 0.0, 0.0]},
    }
    write_json(folder / "flatfield.json", document)


def _exactly(values: Floats) -> dict[str, list[float]]:
    """Known numbers as capture's files hold estimates."""
    return {"value": values.tolist(), "std": [0.0] * len(values), "at_most": values.tolist()}

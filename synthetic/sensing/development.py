"""Development: from the radiance that a lens sees to the files that a camera writes, at one exposure for a whole set.

A set is decoded to the very unit of `Sensor`: radiance 1 fills the well in one second on the axis. With EXIF, which
states ISO and f-number too, decoded radiance is the truth times `Development.radiance_factor`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from synthetic.sensing.camerafiles import write_codes, write_jpeg
from synthetic.sensing.dng import write_dng
from synthetic.sensing.sensor import Sensor, codes_of, expose, expose_mosaic

Floats = NDArray[np.float64]
FileKind = Literal["png", "tiff", "jpeg", "dng"]

_ENDINGS: dict[str, str] = {"png": ".png", "tiff": ".tif", "jpeg": ".jpg", "dng": ".dng"}
_JPEG_QUALITY = 95
# RAW files keep noise below black by this share of their range.
_PEDESTAL = 1 / 32
# Rationals of EXIF hold these to a billionth.
_SHORTEST, _LONGEST = 1e-6, 1e6


@dataclass(frozen=True, eq=False)
class Development:
    """How photographs are exposed and written.

    file : "png" or "tiff", 8 bits or up to 16; "jpeg" and "dng", which hold their exposure as EXIF.
    demosaic : a mosaic of colours is counted and interpolated, edge-aware, before the response curve.
    exposure_s : seconds; None to let `choose_exposure` saturate a share `saturated` of the object's pixels (None: 0).
    bracket : stops relative to it, rising, one photograph each.
    jpeg_quality : 1 to 100; None for 95, and for other files.
    iso, f_number : what EXIF says beside the time. They change no photograph.
    """

    sensor: Sensor = field(default_factory=Sensor)
    file: FileKind = "png"
    demosaic: bool = False
    exposure_s: float | None = None
    saturated: float | None = None
    bracket: tuple[float, ...] = (0.0,)
    jpeg_quality: int | None = None
    iso: int = 100
    f_number: float = 1.0

    def __post_init__(self) -> None:
        if self.file not in _ENDINGS:
            raise ValueError(f"file is {self.file!r}; use one of {', '.join(_ENDINGS)}")
        self._check_exposure()
        self._check_file()

    @property
    def ending(self) -> str:
        """The ending of file names."""
        return _ENDINGS[self.file]

    @property
    def encoding(self) -> Literal["linear", "srgb", "response"]:
        """[radiometry] encoding of the files."""
        if self.sensor.response == "linear":
            return "linear"
        return "srgb" if self.sensor.response == "srgb" else "response"

    @property
    def exposure(self) -> Literal["exif", "manual"]:
        """[radiometry] exposure: "manual" where photographs need `exposure_s` in the manifest."""
        return "exif" if self.file in ("jpeg", "dng") else "manual"

    @property
    def radiance_factor(self) -> float:
        """What decoded radiance is to the true one: f_number^2 x 100 / ISO where EXIF states these, otherwise 1."""
        return self.f_number**2 * 100 / self.iso if self.exposure == "exif" else 1.0

    def times(self, exposure_s: float) -> tuple[float, ...]:
        """The exposure times of a bracket about `exposure_s`, seconds."""
        return tuple(exposure_s * 2.0**stop for stop in self.bracket)

    def _check_exposure(self) -> None:
        if self.exposure_s is not None and not 0 < self.exposure_s < np.inf:
            raise ValueError(f"exposure_s is {self.exposure_s}; it must be > 0, or left out to be chosen")
        if self.exposure_s is not None and self.saturated is not None:
            raise ValueError(
                f"exposure_s = {self.exposure_s} fixes the exposure that saturated = {self.saturated} would choose:"
                " remove one of them"
            )
        if self.saturated is not None and not 0 <= self.saturated < 1:
            raise ValueError(
                f"saturated is {self.saturated}; it is a share of the object's pixels, 0 to below 1"
            )
        stops = np.asarray(self.bracket, float)
        if stops.ndim != 1 or not len(stops) or not np.isfinite(stops).all() or (np.diff(stops) <= 0).any():
            raise ValueError(f"bracket is {list(self.bracket)}; it must be rising stops, such as [-2, 0, 2]")
        if not 0 < self.iso < 65536 or self.iso != int(self.iso):
            raise ValueError(f"iso is {self.iso}; it must be an integer from 1 to 65535")
        if not 0 < self.f_number < np.inf:
            raise ValueError(f"f_number is {self.f_number}; it must be > 0")

    def _check_file(self) -> None:
        bits, curved = self.sensor.bits, self.sensor.response != "linear"
        if self.file == "jpeg" and bits != 8:
            raise ValueError(f"JPEG holds 8 bits, but the sensor's bits is {bits}: write bits = 8")
        if self.file == "dng" and bits == 8:
            raise ValueError("RAW files hold 12 to 16 bits, but the sensor's bits is 8: write bits = 14")
        if self.file == "dng" and curved:
            raise ValueError(
                f"RAW files are linear, but response is {self.sensor.response!r}: remove it, or write another file"
            )
        if self.file == "dng" and self.demosaic:
            raise ValueError("a DNG holds the mosaic; whoever reads it demosaics: remove demosaic = true")
        if bits in (12, 14) and curved:
            raise ValueError(
                f"bits is {bits} with response {self.sensor.response!r}; curves come with 8 or 16 bits, for 16 is what"
                " the file then counts in"
            )
        if self.jpeg_quality is not None and self.file != "jpeg":
            raise ValueError(f"jpeg_quality is for file = 'jpeg', but that is {self.file!r}: remove it")
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"jpeg_quality is {self.jpeg_quality}; it must be 1 to 100")


@dataclass(frozen=True)
class WrittenShot:
    """One written file. file : its name. exposure_s : seconds."""

    file: str
    exposure_s: float


def write_photograph(
    stem: Path,
    radiance: NDArray[np.floating],
    exposure_s: float,
    development: Development,
    rng: np.random.Generator,
) -> tuple[WrittenShot, ...]:
    """Expose and write a photograph, or its bracket, rising in time as `stem`_0, `stem`_1, ...; the ending is added.

    radiance : (h, w, 3), finite and >= 0, of the unit of `Sensor`; noise-free. exposure_s : seconds, of stop 0.
    """
    low = float(np.min(radiance))
    if radiance.ndim != 3 or radiance.shape[2] != 3 or not np.isfinite(radiance).all() or low < 0:
        raise ValueError(
            f"{stem}: radiance is {radiance.shape} with a minimum of {low}; it must be (h, w, 3), finite and >= 0"
        )
    times = development.times(exposure_s)
    if development.exposure == "exif" and (min(times) < _SHORTEST or max(times) > _LONGEST):
        raise ValueError(
            f"{stem}: exposure times run from {min(times):.3g} to {max(times):.3g} s, but EXIF holds {_SHORTEST:g} to"
            f" {_LONGEST:g}; scale the light, or write png or tiff"
        )
    shots = []
    for index, time in enumerate(times):
        name = f"{stem.name}_{index}" if len(times) > 1 else stem.name
        path = stem.with_name(name + development.ending)
        _write(path, radiance, time, development, rng)
        shots.append(WrittenShot(path.name, time))
    return tuple(shots)


def _write(
    path: Path,
    radiance: NDArray[np.floating],
    time: float,
    development: Development,
    rng: np.random.Generator,
) -> None:
    sensor = development.sensor
    if development.file == "dng":
        white = 2**sensor.bits - 1
        black = int(_PEDESTAL * (white + 1))
        mosaic = expose_mosaic(radiance, time, sensor, rng, black)
        write_dng(
            path,
            mosaic,
            black=black,
            white=white,
            exposure_s=time,
            iso=development.iso,
            f_number=development.f_number,
        )
        return
    make = _demosaiced if development.demosaic else expose
    codes = make(radiance, time, sensor, rng)
    if development.file == "jpeg":
        quality = _JPEG_QUALITY if development.jpeg_quality is None else development.jpeg_quality
        write_jpeg(path, codes.astype(np.uint8), quality, time, development.iso, development.f_number)
    else:
        write_codes(path, codes, sensor)


def _demosaiced(
    radiance: NDArray[np.floating], time: float, sensor: Sensor, rng: np.random.Generator
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Codes as `expose` gives them, of a sensor that sees one colour per pixel."""
    counted = replace(sensor, bits=16, response="linear")
    black = int(_PEDESTAL * 65536)
    mosaic = expose_mosaic(radiance, time, counted, rng, black)
    rgb = cv2.demosaicing(mosaic, cv2.COLOR_BayerRGGB2RGB_EA)
    return codes_of((rgb.astype(float) - black) / (65535 - black), sensor)

"""A sensor with a formula: radiance through a lens to electrons, noise, a response curve and codes.

    electrons = Poisson(full_well * vignetting * radiance * exposure)
    signal    = (electrons + read noise) / full_well                       clipped to 0 and 1
    code      = round(response(signal) * (2^bits - 1))

The converter clips, behind the read noise: cameras set the white level below what their wells hold, so that all that
is too bright has one code.

Photons are counted one by one and the vignetting is the cos^4 law, so that calibrations, which fit Gaussian noise
and polynomials, are judged by other formulas than their own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.srgb import linear_to_srgb

Floats = NDArray[np.float64]
Response = Callable[[Floats], Floats]

# Signal in 0 to 1 to output in 0 to 1.
RESPONSES: dict[str, Response] = {
    "linear": lambda signal: signal,
    "srgb": linear_to_srgb,
    "gamma": lambda signal: signal ** (1 / 2.2),
    # A film-like curve with a toe and a shoulder, and no formula that anybody fits.
    "film": lambda signal: (1 - np.exp(-3.2 * signal**0.8)) / (1 - np.exp(-3.2)),
}


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor behind a lens.

    full_well : (3,) electrons at the white level, RGB, or one number. read_noise : (3,) electrons, standard deviation.
    focal_px : focal length in pixels of the cos^4 vignetting (about the image centre unless `centre`, (x, y) in
        pixels, is given); infinite for none.
    response : a name in `RESPONSES`, or a callable that maps signal to output, both in 0 to 1 and rising.
    bits : 8, 12, 14 or 16.
    """

    full_well: Floats = field(default_factory=lambda: np.full(3, 20_000.0))
    read_noise: Floats = field(default_factory=lambda: np.full(3, 4.0))
    focal_px: float = np.inf
    centre: tuple[float, float] | None = None
    response: str | Response = "linear"
    bits: int = 16

    def __post_init__(self) -> None:
        for name in ("full_well", "read_noise"):
            value = np.broadcast_to(np.asarray(getattr(self, name), float), 3)
            if not np.isfinite(value).all() or (value < 0).any():
                raise ValueError(f"{name} is {value.tolist()} electrons; it must be finite and >= 0")
            object.__setattr__(self, name, frozen_array(value))
        if not (self.full_well > 0).all():
            raise ValueError(f"full_well is {self.full_well.tolist()} electrons; it must be > 0")
        if not self.focal_px > 0:
            raise ValueError(f"focal_px is {self.focal_px}; it must be > 0")
        if isinstance(self.response, str) and self.response not in RESPONSES:
            raise ValueError(f"response {self.response!r} is not known; use one of {', '.join(RESPONSES)}")
        if self.bits not in (8, 12, 14, 16):
            raise ValueError(f"bits is {self.bits}; it must be 8, 12, 14 or 16")

    @property
    def curve(self) -> Response:
        """The response as a function of the signal."""
        return RESPONSES[self.response] if isinstance(self.response, str) else self.response


def expose(
    radiance: NDArray[np.floating], exposure_s: float, sensor: Sensor, rng: np.random.Generator
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """The codes (h, w, 3) of one photograph: uint8 for 8 bits, otherwise uint16 in 0 to 2^bits - 1.

    radiance : (h, w, 3), >= 0; 1 fills the well in one second on the axis. exposure_s : seconds, > 0.
    """
    height, width = radiance.shape[:2]
    light = np.asarray(radiance, float) * vignetting(sensor, width, height)[..., None] * exposure_s
    electrons = rng.poisson(light * sensor.full_well)
    noisy = electrons + rng.normal(size=light.shape) * sensor.read_noise
    return codes_of(noisy / sensor.full_well, sensor)


def codes_of(signal: NDArray[np.floating], sensor: Sensor) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """The codes of a signal of any shape that is 1 at the white level; beyond 0 and 1 it is clipped."""
    values = np.asarray(sensor.curve(np.clip(np.asarray(signal, float), 0, 1)))
    return np.round(values * (2**sensor.bits - 1)).astype(np.uint8 if sensor.bits == 8 else np.uint16)


def signal_of(values: NDArray[np.floating] | float, sensor: Sensor) -> Floats:
    """The signal that the sensor's response turns into values, both 0 to 1, of one shape; by bisection.

    Good to 1e-15, whatever the curve.
    """
    values = np.asarray(values, float)
    low, high = np.zeros(values.shape), np.ones(values.shape)
    for _ in range(50):
        middle = (low + high) / 2
        above = np.asarray(sensor.curve(middle)) > values
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray((low + high) / 2)


def expose_mosaic(
    radiance: NDArray[np.floating],
    exposure_s: float,
    sensor: Sensor,
    rng: np.random.Generator,
    black: int = 0,
) -> NDArray[np.uint16]:
    """The codes (h, w) of one photograph behind an RGGB filter, as a RAW file holds them.

    Noise reaches below the code `black` of no light; 2^bits - 1 is the white level. Linear: the response is not used.
    """
    height, width = radiance.shape[:2]
    light = np.asarray(radiance, float) * vignetting(sensor, width, height)[..., None] * exposure_s
    rows, columns = np.indices((height, width)) % 2
    colour = rows + columns  # red 0, green 1, blue 2
    electrons = rng.poisson(
        np.take_along_axis(light, colour[..., None], axis=2)[..., 0] * sensor.full_well[colour]
    )
    signal = (electrons + rng.normal(size=colour.shape) * sensor.read_noise[colour]) / sensor.full_well[
        colour
    ]
    white = 2**sensor.bits - 1
    return np.clip(np.round(black + signal * (white - black)), 0, white).astype(np.uint16)


def vignetting(sensor: Sensor, width: int, height: int) -> Floats:
    """Illumination relative to the axis (h, w), cos^4 of the angle from it (Horn, Robot Vision, 1986, sec. 10.3)."""
    centre_x, centre_y = sensor.centre or (width / 2, height / 2)
    x = (np.arange(width) + 0.5 - centre_x) / sensor.focal_px
    y = (np.arange(height) + 0.5 - centre_y) / sensor.focal_px
    return np.asarray(1 / (1 + x[None, :] ** 2 + y[:, None] ** 2) ** 2)

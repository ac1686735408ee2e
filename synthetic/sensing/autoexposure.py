"""One exposure time for all photographs of a set, as a photographer sets it by the brightest parts of the object."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from synthetic.sensing.development import Development
from synthetic.sensing.sensor import Sensor, signal_of, vignetting

# Standard deviations of the noise by which the brightest pixel stays below white where nothing may saturate.
_HEADROOM = 5.0


def object_brightness(
    radiance: NDArray[np.floating], coverage: NDArray[np.floating], sensor: Sensor
) -> NDArray[np.float32]:
    """How fast each of the object's pixels nears white, (n,) float32, 1 over seconds.

    radiance : (h, w, 3). coverage : (h, w), positive where the object is. The fastest channel counts, and the lens's
    vignetting; white is where signals begin to be given the top code.
    """
    height, width = coverage.shape
    seen = coverage > 0
    light = np.asarray(radiance, float)[seen] * vignetting(sensor, width, height)[seen][:, None]
    # Codes round to the top one half a step below it.
    white = float(signal_of(1 - 0.5 / (2**sensor.bits - 1), sensor))
    return np.asarray((light / white).max(axis=1), np.float32)


def choose_exposure(brightness: Iterable[NDArray[np.floating]], development: Development) -> float:
    """The exposure time in seconds for all photographs of a set.

    brightness : of each photograph, as `object_brightness` gives it; not looked at where the time is given.
    Automatic, a share `saturated` of all the object's pixels lies above white; at 0 even the brightest stays as far
    below that noise doesn't take it there. ValueError if the object is black.
    """
    if development.exposure_s is not None:
        return development.exposure_s
    share = development.saturated or 0.0
    parts = [np.asarray(part) for part in brightness if len(part)]
    values = np.concatenate(parts) if parts else np.zeros(1, np.float32)
    # The pixel number `place` from above is the first that may not saturate.
    place = int(np.floor(share * len(values)))
    limit = float(np.partition(values, -1 - place)[-1 - place])
    if not limit > 0:
        rest = f" but {share:.0%}" if share else ""
        raise ValueError(
            f"the exposure can't be chosen: all{rest} of the object's pixels are black; light it, or give exposure_s"
        )
    return (_unclipped(development.sensor) if share == 0 else 1.0) / limit


def _unclipped(sensor: Sensor) -> float:
    """The largest signal that stays below white by `_HEADROOM` deviations of its noise, in all channels.

    In electrons, n + k sqrt(n + r^2) = N, solved for n, with full well N and read noise r.
    """
    k, well, read = _HEADROOM, sensor.full_well, sensor.read_noise
    below = well + k**2 / 2 - k * np.sqrt(well + k**2 / 4 + read**2)
    if not (below > 0).all():
        raise ValueError(
            f"full_well {well.tolist()} electrons with read_noise {read.tolist()} leaves nothing between noise and"
            " white; give exposure_s"
        )
    return float((below / well).min())

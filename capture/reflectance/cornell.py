"""Text files of Cornell's light measurement laboratory.

A file gives the number of wavelengths, the wavelengths (nm), and rows of theta_i, phi_i, theta_s, phi_s (radians)
and one reflectance (1/sr) per wavelength. Some thousand samples, dense nowhere.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.reflectance.samples import ReflectanceSamples
from capture.reflectance.spectra import reflectance_to_srgb

Floats = NDArray[np.float64]


def read_cornell(path: Path) -> ReflectanceSamples:
    """The samples of a file, in linear sRGB under D65. Raises ValueError for a file of another kind."""
    numbers: list[float] = []
    for number, line in enumerate(path.read_text(encoding="latin-1").splitlines(), 1):
        try:
            numbers += [float(word) for word in line.partition("#")[0].split()]
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}; is it a Cornell BRDF file?") from None
    wavelengths = int(numbers[0]) if numbers and np.isfinite(numbers[0]) else 0
    rest = len(numbers) - 1 - wavelengths
    if wavelengths < 2 or rest <= 0 or rest % (4 + wavelengths):
        raise ValueError(
            f"{path}: {len(numbers)} numbers are no count of wavelengths, as many wavelengths, and rows of four angles"
            " and as many reflectances; is it a Cornell BRDF file, complete?"
        )
    rows = np.array(numbers[1 + wavelengths :]).reshape(-1, 4 + wavelengths)
    if not np.isfinite(rows).all():
        raise ValueError(f"{path}: row {int(np.argwhere(~np.isfinite(rows))[0, 0])} is not finite")
    theta_i, phi_i, theta_s, phi_s = rows[:, :4].T
    rgb = reflectance_to_srgb(numbers[1 : 1 + wavelengths], rows[:, 4:])
    return ReflectanceSamples(_spherical(theta_i, phi_i), _spherical(theta_s, phi_s), rgb)


def _spherical(theta: Floats, phi: Floats) -> Floats:
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)

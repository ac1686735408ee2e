"""Isotropic BRDFs that Cornell's light measurement laboratory measured, from its text files.

A file gives the numbers of wavelengths, the wavelengths (nm), and rows of theta_i, phi_i, theta_s, phi_s (radians)
and one reflectance (1/sr) per wavelength. Some thousand samples, dense nowhere: what lies between them is interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import RBFInterpolator

from synthetic.materials.material import AnyFloats, Floats
from synthetic.materials.spectra import reflectance_to_srgb
from synthetic.materials.tabulated import RusinkiewiczAngles, Tabulated, bin_centres, directions, half_angles

# Of the table: theta_h, theta_d, phi_d.
_BINS = (90, 90, 36)
# Reflectance (1/sr) below which differences count as such, not as ratios.
_DARK = 2e-3


@dataclass(frozen=True, eq=False)
class CornellSamples:
    """wi, wo : (n, 3) local unit directions to the light and to the sensor. rgb : (n, 3) linear sRGB under D65, 1/sr,
    negative where a colour is outside the gamut."""

    wi: Floats
    wo: Floats
    rgb: Floats


def read_cornell(path: Path) -> CornellSamples:
    """The samples of a file. Raises ValueError for a file of another kind."""
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
    return CornellSamples(_spherical(theta_i, phi_i), _spherical(theta_s, phi_s), rgb)


def interpolated(samples: CornellSamples) -> Tabulated:
    """A material through the samples: linear in the logarithm, reciprocal, mirror-symmetric, and never below 0.

    Colours outside the gamut lose their negative channel. Nowhere is it brighter than the brightest sample; and
    directions that lean further from the normal than any that was measured reflect as if they leaned that far, so
    that the growth of a highlight towards grazing stops there. Left-out samples of two enamel paints were predicted
    to 1.4% in the median and 17% at the 95th percentile, of the value and 0.02 / sr; worst in the highlight at
    grazing angles.
    """
    values = np.log(np.maximum(samples.rgb, 0) + _DARK)
    places = _embedded(half_angles(samples.wi, samples.wo))
    # Smoother kernels swing far out where samples are scarce, as in the gap that the sensor leaves about the light.
    surface = RBFInterpolator(places, values, kernel="linear", degree=1)
    # Mirror symmetry and reciprocity: a quarter turn of phi_d holds all.
    wi, wo = directions(RusinkiewiczAngles(*np.broadcast_arrays(*bin_centres(_BINS))))
    half = _BINS[2] // 2
    lowest = min(samples.wi[:, 2].min(), samples.wo[:, 2].min())
    wi, wo = _raised(wi[:, :, :half], lowest), _raised(wo[:, :, :half], lowest)
    wanted = _embedded(half_angles(wi, wo)).reshape(-1, 3)
    # No more than was ever measured, where nothing was.
    logs = np.minimum(surface(wanted), values.max(axis=0))
    quarter = np.maximum(np.exp(logs) - _DARK, 0).reshape(*_BINS[:2], half, 3)
    table = np.concatenate([quarter, quarter[:, :, ::-1]], axis=2)
    return Tabulated(np.zeros(3), np.ones(3), table)


def _embedded(angles: RusinkiewiczAngles) -> Floats:
    """Coordinates (..., 3) in which near pairs are near: without a seam in phi_d, which means nothing at the poles."""
    turn = np.sin(angles.theta_h) * np.sin(angles.theta_d) * np.abs(np.cos(angles.phi_d))
    return np.stack([angles.theta_h, angles.theta_d, turn], axis=-1)


def _raised(w: AnyFloats, lowest: float) -> Floats:
    """Directions (..., 3), lifted in their own azimuth to a cosine of at least `lowest`."""
    up = np.maximum(w[..., 2:], lowest)
    flat = w[..., :2] / np.maximum(np.linalg.norm(w[..., :2], axis=-1, keepdims=True), 1e-12)
    return np.concatenate([flat * np.sqrt(1 - np.minimum(up, 1) ** 2), up], axis=-1)


def _spherical(theta: Floats, phi: Floats) -> Floats:
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)

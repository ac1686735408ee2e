"""From spectra of reflectance to linear sRGB, as daylight shows them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

# Spectral power of CIE illuminant D65 from 400 to 700 nm in steps of 10, relative [CIE 15, table 1].
_D65_WAVELENGTHS = np.arange(400.0, 701.0, 10.0)
# fmt: off
_D65 = np.array([
    82.7549, 91.486, 93.4318, 86.6823, 104.865, 117.008, 117.812, 114.861, 115.923, 108.811, 109.354,
    107.802, 104.79, 107.689, 104.405, 104.046, 100.0, 96.3342, 95.788, 88.6856, 90.0062,
    89.5991, 87.6987, 83.2886, 83.6992, 80.0268, 80.2146, 82.2778, 78.2842, 69.7213, 71.6091,
])
# fmt: on

# Linear sRGB from XYZ [IEC 61966-2-1].
_SRGB_FROM_XYZ = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]],
)


def colour_matching(wavelengths_nm: ArrayLike) -> Floats:
    """CIE 1931 2-degree colour matching functions x, y, z (n, 3) at wavelengths (n,), to about 1% of the peak.

    The fit of Wyman, Sloan, Shirley, "Simple analytic approximations to the CIE XYZ color matching functions", JCGT
    2(2), 2013, eq. 4.
    """
    nm = np.asarray(wavelengths_nm, float)

    def bell(peak: float, below: float, above: float) -> Floats:
        return np.exp(-0.5 * ((nm - peak) / np.where(nm < peak, below, above)) ** 2)

    x = 1.056 * bell(599.8, 37.9, 31.0) + 0.362 * bell(442.0, 16.0, 26.7) - 0.065 * bell(501.1, 20.4, 26.2)
    y = 0.821 * bell(568.8, 46.9, 40.5) + 0.286 * bell(530.9, 16.3, 31.1)
    z = 1.217 * bell(437.0, 11.8, 36.0) + 0.681 * bell(459.0, 26.0, 13.8)
    return np.stack([x, y, z], axis=-1)


def reflectance_to_srgb(wavelengths_nm: ArrayLike, reflectance: ArrayLike) -> Floats:
    """Linear sRGB (..., 3) of reflectances (..., n) at evenly spaced wavelengths (n,), 400 to 700 nm, under D65.

    A reflectance of 1 at every wavelength is (1, 1, 1). Colours outside sRGB's gamut have a negative channel.
    """
    nm = np.asarray(wavelengths_nm, float)
    if nm.ndim != 1 or len(nm) < 2 or not np.allclose(np.diff(nm), nm[1] - nm[0]):
        raise ValueError(f"wavelengths are {nm.tolist()} nm; they must be evenly spaced")
    if nm[0] < 400 or nm[-1] > 700:
        raise ValueError(f"wavelengths span {nm[0]:g} to {nm[-1]:g} nm; 400 to 700 nm are known")
    weights = np.interp(nm, _D65_WAVELENGTHS, _D65)[:, None] * colour_matching(nm) @ _SRGB_FROM_XYZ.T
    return np.asarray(np.asarray(reflectance, float) @ (weights / weights.sum(axis=0)))

"""Linear sRGB, CIE XYZ and CIE L*a*b*, and how far apart two colours look."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skimage.color import deltaE_ciede2000, lab2xyz, xyz2lab, xyz_tristimulus_values
from skimage.color.colorconv import rgb_from_xyz, xyz_from_rgb

from capture.primaries import adaptation

Floats = NDArray[np.float64]

# XYZ of daylight D50 and D65, 2 degrees, Y = 1.
_D50, _D65 = (
    np.asarray(xyz_tristimulus_values(illuminant=name, observer="2"), float) for name in ("D50", "D65")
)
# XYZ (D65) from linear sRGB.
XYZ_FROM_SRGB = np.asarray(xyz_from_rgb, float)


def lab_d50_to_srgb(lab: Floats) -> Floats:
    """Linear sRGB (n, 3) of CIE L*a*b* (n, 3) under D50, adapted to sRGB's white by Bradford's transform."""
    xyz = np.asarray(lab2xyz(np.asarray(lab, float), illuminant="D50"))
    return np.asarray(xyz @ (rgb_from_xyz @ adaptation(_D50, _D65)).T)


def srgb_to_lab(srgb: Floats) -> Floats:
    """CIE L*a*b* (n, 3), D65, of linear sRGB (n, 3)."""
    return np.asarray(xyz2lab(np.asarray(srgb, float) @ XYZ_FROM_SRGB.T, illuminant="D65"))


def delta_e_2000(srgb: Floats, reference: Floats) -> Floats:
    """How far apart colours look, (n,), CIEDE2000, of linear sRGB (n, 3): 1 is just to be seen."""
    return np.asarray(deltaE_ciede2000(srgb_to_lab(reference), srgb_to_lab(srgb)))

"""Binary files of the MERL database (Matusik, Pfister, Brand, McMillan, "A data-driven reflectance model", 2003)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# What its integers are to be multiplied by: red, green, blue.
_SCALES = np.array([1.0, 1.15, 1.66]) / 1500


def read_merl(path: Path) -> Floats:
    """The table (n_h, n_d, n_p, 3) of a file, linear RGB in 1/sr, NaN where it was not measured.

    Bins start at theta_h = pi/2 (i / n_h)^2, theta_d = pi/2 j / n_d, phi_d = pi k / n_p. What the file marks as not
    measured, by a negative number or NaN, is mostly pairs of which one lies below the horizon. Raises ValueError for a
    file of another kind.
    """
    data = path.read_bytes()
    if len(data) < 12:
        raise ValueError(f"{path}: has {len(data)} bytes; a MERL file starts with three 4-byte integers")
    shape = tuple(int(n) for n in np.frombuffer(data, "<i4", 3))
    expected = 12 + 24 * int(np.prod(shape, dtype=object))
    if min(shape) < 1 or len(data) != expected:
        raise ValueError(
            f"{path}: names a table of {' x '.join(map(str, shape))} and has {len(data)} bytes instead of"
            f" {expected}; it is no MERL file, or was cut short"
        )
    values = np.frombuffer(data, "<f8", offset=12).reshape(3, *shape)
    return np.moveaxis(np.where(values >= 0, values, np.nan), 0, -1) * _SCALES

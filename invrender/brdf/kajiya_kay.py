"""Kajiya and Kay's lobe of fibres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Lobe

Floats = NDArray[np.float64]


def kajiya_kay(exponent: float) -> Lobe:
    """cos^s(theta_i + theta_o - pi), of angles to the tangent, where the cosine is above 0 [Kajiya and Kay 1989].

    Of tangents in the place of normals. A fibre reflects a ray into the cone about its tangent that the ray lies on.
    R02 prints theta_i - theta_o, which has the viewer on the other side of the fibre; orders are the same.
    """

    def lobe(tangents: Floats, wi: Floats, wo: Floats) -> Floats:
        cos_i, cos_o = (tangents * wi).sum(axis=-1), (tangents * wo).sum(axis=-1)
        sines = np.sqrt(np.maximum(1 - cos_i**2, 0) * np.maximum(1 - cos_o**2, 0))
        return np.asarray(np.maximum(sines - cos_i * cos_o, 0) ** exponent)

    return lobe

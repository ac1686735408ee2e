"""The spheres that RH01 measured."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synthetic.materials.facets import BeckmannSlopes
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.smith import SmithMaterial

# Fig. 11 holds ratios. The brightest of them, Kd = 0.92, becomes an albedo of 0.79 under this scale, a
# usual value for a white plastic.
RADIOMETRIC_SCALE = 0.86 / np.pi
# At grazing angles the exact lobe of the paint of Fig. 11 reflects 6 times its Ks; at this scale none of the six
# spheres reflects more than it receives there.
EXACT_SCALE = 0.39 / np.pi


class Fig11Row(NamedTuple):
    """A row of [RH01, Fig. 11]: kd and ks are RGB ratios, the largest kd + ks of a material being 1."""

    kd: tuple[float, float, float]
    ks: tuple[float, float, float]
    mu: float | None
    sigma: float


def _grey(value: float) -> tuple[float, float, float]:
    return value, value, value


# The columns "known", measured under known lighting.
RH01_MATERIALS = {
    "teflon": Fig11Row(_grey(0.89), _grey(0.11), 1.78, 0.12),
    "delrin": Fig11Row(_grey(0.87), _grey(0.13), 1.44, 0.10),
    "neoprene": Fig11Row(_grey(0.92), _grey(0.08), 1.49, 0.10),
    "steel": Fig11Row(_grey(0.20), _grey(0.80), None, 0.20),
    "bronze": Fig11Row((0.15, 0.08, 0.05), (0.85, 0.68, 0.59), None, 0.12),
    "painted": Fig11Row((0.62, 0.71, 0.62), _grey(0.29), 1.38, 0.15),
}


def radiometric(row: Fig11Row, scale: float = RADIOMETRIC_SCALE) -> MicrofacetMaterial:
    """A material with the ratios of Fig. 11 that reflects less than it receives. scale : 1/sr."""
    return MicrofacetMaterial(scale * np.array(row.kd), scale * np.array(row.ks), row.mu, row.sigma)


def exact(row: Fig11Row, scale: float = EXACT_SCALE) -> SmithMaterial:
    """The same ratios, index and roughness in the physically exact form. scale : 1/sr."""
    facets = BeckmannSlopes(row.sigma, row.sigma)
    return SmithMaterial(scale * np.array(row.kd), scale * np.array(row.ks), row.mu, facets)

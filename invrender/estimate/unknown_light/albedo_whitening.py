"""Unknown albedo textures: what all photographs of a place on the surface have in common carries almost no weight.

    B = p(x) Kd E(n) + Ks S(n, view)

Under one light the first term is the same in all photographs of a place x, whatever its albedo p. So the albedo is
taken for a random effect [Laird & Ware 1982, eq. 2.2]: noise that all samples of a place share, far above their own.
Weighed by the inverse of that covariance, light and lobe are determined by what differs between photographs of the same
places: that highlights move, while the albedo stays. So no light is taken for albedo, nor albedo for light [RH01,
section 6.4].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

# Standard deviation of the albedo over that of a sample's noise: half of the radiance over half a hundredth. No less,
# as albedo that varies slowly over a surface isn't as independent from place to place as a random effect is.
_ALBEDO_STD = 100.0


def albedo_whitening(place: NDArray[np.int64]) -> csr_array:
    """The matrix (n, n) that leaves of samples what of them is as certain as their own noise.

    place : (n,), the number of the place that each shows. Its square is the inverse covariance of samples whose noise
    has variance 1 and is independent, but for `_ALBEDO_STD`^2 that those of a place share: I - M, with M the mean over
    the m samples of a place, times 1 - (1 + m `_ALBEDO_STD`^2)^-1/2.
    """
    at = np.unique(place, return_inverse=True)[1]
    count = np.bincount(at)
    share = 1 - 1 / np.sqrt(1 + count * _ALBEDO_STD**2)
    numbers = np.arange(len(at))
    of = csr_array((np.ones(len(at)), (numbers, at)), shape=(len(at), len(count)))
    alone = csr_array((np.ones(len(at)), (numbers, numbers)))
    return csr_array(alone - of @ csr_array(of.T.multiply((share / count)[:, None])))

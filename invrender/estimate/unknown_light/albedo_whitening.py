"""Paint that nobody knows: what all photographs of a place on the surface have in common tells next to nothing.

    B = p(x) Kd E(n) + Ks S(n, view)

Under one light the first term is the same in all photographs of a place x, whatever its paint p. So paint is taken for
a random effect [Laird & Ware 1982, eq. 2.2]: noise that all samples of a place share, far above their own. Weighed by
the inverse of that covariance, light and lobe are told by what differs between photographs of the same places: that
highlights move, while paint stays. No light is taken for paint so, nor paint for light [RH01, section 6.4].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

# Standard deviation of paint over that of a sample's noise: half of the radiance over half a hundredth. No less, as
# paint that varies slowly over a surface isn't as independent from place to place as a random effect is.
_PAINT = 100.0


def albedo_whitening(place: NDArray[np.int64]) -> csr_array:
    """The matrix (n, n) that leaves of samples what of them is as certain as their own noise.

    place : (n,), the number of the place that each shows. Its square is the inverse covariance of samples whose noise
    has variance 1 and is independent, but for `_PAINT`^2 that those of a place share: I - M, with M the mean over the m
    samples of a place, times 1 - (1 + m `_PAINT`^2)^-1/2.
    """
    at = np.unique(place, return_inverse=True)[1]
    count = np.bincount(at)
    share = 1 - 1 / np.sqrt(1 + count * _PAINT**2)
    numbers = np.arange(len(at))
    of = csr_array((np.ones(len(at)), (numbers, at)), shape=(len(at), len(count)))
    alone = csr_array((np.ones(len(at)), (numbers, numbers)))
    return csr_array(alone - of @ csr_array(of.T.multiply((share / count)[:, None])))

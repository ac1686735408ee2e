"""Camera response as a polynomial: Mitsunaga and Nayar, "Radiometric self calibration" (CVPR 1999)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

Floats = NDArray[np.float64]
ORDERS = (1, 2, 3, 4, 5, 6, 8)
_DARKEST = 1e-6


class ExposurePolynomial:
    """Exposure I(z) = sum of c_n z^n over n = 0 to `order`, as Chebyshev polynomials between `low` and `high`.

    The paper minimises differences of exposure, I(z_1) - R I(z_2); here, as for every curve, they are weighted by what
    noise makes of them. The order is the one that predicts best, as in the paper.
    """

    def __init__(self, low: float, high: float, order: int) -> None:
        self.low, self.high, self.order = low, high, order
        self.roughness: Floats = np.zeros((self.size, self.size))

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.order + 1

    def fitted_to(self, values: Floats, log_exposure: Floats, std: Floats) -> Floats:
        """Parameters (size,) nearest to a curve that is given at values (n,), to begin with."""
        exposure = np.exp(log_exposure - log_exposure.max())
        weights = 1 / (exposure * std)
        design = chebyshev.chebvander(self._scaled(values), self.order)
        return np.linalg.lstsq(design * weights[:, None], exposure * weights, rcond=None)[0]

    def log_exposure(self, params: Floats, values: Floats) -> Floats:
        """ln I at values, of their shape; no less than `_DARKEST` of the largest, since polynomials cross zero."""
        return np.log(self._exposure(params, values))

    def slope(self, params: Floats, values: Floats) -> Floats:
        """d ln I / dz at values, of their shape."""
        scaled = self._scaled(values)
        inner = 2 / (self.high - self.low)
        return chebyshev.chebval(scaled, chebyshev.chebder(params)) * inner / self._exposure(params, values)

    def jacobian(self, params: Floats, values: Floats) -> Any:
        """d ln I / dparams, sparse (n, size), at values (n,)."""
        from scipy.sparse import csr_array

        design = chebyshev.chebvander(self._scaled(values), self.order)
        return csr_array(design / self._exposure(params, values)[:, None])

    def _exposure(self, params: Floats, values: Floats) -> Floats:
        darkest = _DARKEST * abs(float(chebyshev.chebval(1.0, params)))
        return np.maximum(chebyshev.chebval(self._scaled(values), params), darkest)

    def _scaled(self, values: Floats) -> Floats:
        return 2 * (values - self.low) / (self.high - self.low) - 1

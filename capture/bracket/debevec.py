"""Camera response as a smooth curve of log exposure: Debevec and Malik, "Recovering high dynamic range radiance maps
from photographs" (SIGGRAPH 1997), eq. 3."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_SEGMENTS = 80
_DEGREE = 3
# Share of the range over which the knots are drawn together at both ends, where responses bend most.
_END = 1 / 512


class LogExposureSpline:
    """g(z) = ln of the exposure that gives value z: a cubic spline whose curvature is penalised.

    The paper solves for one number per 8-bit code and penalises second differences; a spline of 80 segments says
    the same for any depth, with derivatives. Its knots are even in s(z) = ln((z - low + e) / (high - z + e)), and
    so is the penalty: a power law (gamma) and its mirror image, a shoulder, are nearly straight lines in s, where
    a penalty even in z would have to bend the middle to follow the ends.

    low, high : values between which the curve is wanted.
    """

    def __init__(self, low: float, high: float) -> None:
        self.low, self.high = low, high
        self._end = _END * (high - low)
        ends = self._warped(np.array([low, high]))
        step = (ends[1] - ends[0]) / _SEGMENTS
        self._knots = ends[0] + step * np.arange(-_DEGREE, _SEGMENTS + _DEGREE + 1)
        differences = np.diff(np.eye(self.size), n=2, axis=0) / step**1.5
        self.roughness: Floats = differences.T @ differences

    @property
    def size(self) -> int:
        """Number of parameters."""
        return _SEGMENTS + _DEGREE

    def start(self) -> Floats:
        """Parameters of the straight line g = s, (size,) float64."""
        return self._knots[2 : 2 + self.size].copy()

    def log_exposure(self, params: Floats, values: Floats) -> Floats:
        """g at values in `low` to `high`, of their shape."""
        return self._spline(params)(self._warped(values))

    def slope(self, params: Floats, values: Floats) -> Floats:
        """dg/dz at values, of their shape."""
        inner = 1 / (values - self.low + self._end) + 1 / (self.high - values + self._end)
        return self._spline(params).derivative()(self._warped(values)) * inner

    def jacobian(self, params: Floats, values: Floats) -> Any:
        """dg/dparams, sparse (n, size), at values (n,)."""
        from scipy.interpolate import BSpline

        inside = np.clip(self._warped(values), self._knots[_DEGREE], self._knots[-_DEGREE - 1])
        return BSpline.design_matrix(inside, self._knots, _DEGREE)

    def _warped(self, values: Floats) -> Floats:
        return np.log((values - self.low + self._end) / (self.high - values + self._end))

    def _spline(self, params: Floats) -> Any:
        from scipy.interpolate import BSpline

        return BSpline(self._knots, params, _DEGREE)


def solve_debevec(
    curve: LogExposureSpline,
    values: Floats,
    usable: NDArray[np.bool_],
    log_times: Floats,
    smoothing: float = 1.0,
) -> Floats:
    """Spline parameters that minimise eq. 3, scenes' log exposures eliminated; hat weights, eq. 4.

    values : (n, p). usable : (n, p), False where clipped. log_times : (p,). smoothing : in units of a weight of one
    observation per 100. Increasing: where the samples leave the curve without direction, flat pieces are joined.
    """
    from scipy.optimize import isotonic_regression
    from scipy.sparse import csr_array

    n, p = values.shape
    half = (curve.high - curve.low) / 2
    hat = np.clip(np.minimum(values - curve.low, curve.high - values) / half, 1e-3, 1)
    usable = usable & (usable.sum(axis=1, keepdims=True) > 1)
    rows = np.flatnonzero(usable.ravel())
    pixel, photo = np.divmod(rows, p)
    weight = hat.ravel()[rows]
    design = curve.jacobian(curve.start(), values.ravel()[rows])
    gather = csr_array((weight, (pixel, np.arange(len(rows)))), shape=(n, len(rows)))
    sums = np.maximum(np.asarray(gather.sum(axis=1)).ravel(), 1e-9)
    means = (gather @ design).toarray() / sums[:, None]
    times = log_times[photo]
    mean_times = (gather @ times) / sums
    matrix = (design.T @ design.multiply(weight[:, None])).toarray() - means.T @ (means * sums[:, None])
    right = design.T @ (weight * (times - mean_times[pixel]))
    middle = curve.jacobian(curve.start(), np.array([curve.low + half])).toarray()
    matrix += smoothing * weight.sum() / 100 / curve.size * curve.roughness / np.diag(curve.roughness).max()
    params = np.linalg.solve(matrix + np.diag(matrix).max() * middle.T @ middle, right)
    return isotonic_regression(params).x + 1e-4 * np.arange(curve.size)

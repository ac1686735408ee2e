"""A camera's colours from a chart: the matrix to linear sRGB, how even the light was, and how linear the camera is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from capture.chart.chart import Chart
from capture.chart.colorspaces import XYZ_FROM_SRGB
from capture.chart.patches import SeenPatches

Floats = NDArray[np.float64]

# Luminance, of a perfect white as 1.
LUMINANCE = XYZ_FROM_SRGB[1]
# Below this share of a perfect white differences count as they are, above as the lightness that they make, L* by
# luminance to the power of a third.
_DARK, _LIGHTNESS = 0.01, 2 / 3
# How much more certain greys count than other patches, at most; rounds to find out.
_MOST_CERTAIN, _ROUNDS = 8.0, 4
# Trials of a fit: a chart's own takes a dozen, that of another chart would take thousands.
_MOST_TRIALS = 300
# Exponents that the search begins at, of a linear camera and of an sRGB file; camera numbers that count as black.
_EXPONENTS, _BLACK = (1.0, 2.2), 1e-6
# Numbers of a photograph: light over the chart, of second degree and r^4 as lenses fall off; how its colour changes
# across (red and blue beside green, to the right and to the bottom); glare.
_LIGHT, _TINT, _GLARE = 7, 4, 3


@dataclass(frozen=True, eq=False)
class ColorFit:
    """Camera RGB to linear sRGB by a matrix, and what the chart's light was.

    matrix : (3, 3); a neutral surface keeps its green. covariance : (9, 9) of it, row by row. light : (photos, n), on
    the patches relative to their mean. slope, slope_std : (photos, 2), by how much light grows to the right and to the
    bottom, as a share, over the chart's longer side. tint, tint_std : (photos, 2, 2), the same of red and of blue
    beside green. glare, glare_std : (photos, 3), linear sRGB that is everywhere, as a share of a perfect white.
    corrected : (photos, n, 3), linear sRGB of the patches in even light without glare, at the reference's level.
    reference : (n, 3). misfit : RMS of weighted residuals, to compare references by. exponent, exponent_std : to whose
    power the camera's numbers would be linear; 1 of a linear camera.
    """

    matrix: Floats
    covariance: Floats
    light: Floats
    slope: Floats
    slope_std: Floats
    tint: Floats
    tint_std: Floats
    glare: Floats
    glare_std: Floats
    corrected: Floats
    reference: Floats
    misfit: float
    exponent: float
    exponent_std: float

    @property
    def neutral(self) -> Floats:
        """Camera RGB (3,) of a neutral surface in the chart's light, green 1."""
        return np.asarray(np.linalg.solve(self.matrix, np.ones(3)))


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the fit is given: rgb (photos, n, 3), places' powers (photos, n, 7), reference (n, 3), weights (n,)."""

    rgb: Floats
    places: Floats
    reference: Floats
    weight: Floats

    def parts(self, numbers: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Matrix (3, 3), and of each photograph light (photos, 7), its tint (photos, 2, 2), and glare (photos, 3).

        The first photograph's level is in the matrix.
        """
        own = np.insert(numbers, 9, 1.0)[9:].reshape(len(self.rgb), -1)
        light, tint, glare = np.split(own, np.cumsum([_LIGHT, _TINT]), axis=1)
        return numbers[:9].reshape(3, 3), light, tint.reshape(-1, 2, 2), glare

    def shown(self, numbers: Floats) -> Floats:
        """Linear sRGB (photos, n, 3) of the patches."""
        matrix, light, tint, glare = self.parts(numbers)
        evened = np.einsum("pnt,pt->pn", self.places, light)
        tinted = np.einsum("pnt,pct->pnc", self.places[..., 1:3], tint)
        even = self.rgb * np.insert(1 + tinted, 1, 1.0, axis=2)
        return np.asarray(evened[..., None] * (even @ matrix.T) - glare[:, None])

    def off(self, numbers: Floats) -> Floats:
        """Weighted residuals, patch by patch, all colours of one together."""
        return np.asarray(((self.shown(numbers) - self.reference) * self.weight[:, None]).ravel())


def fit_color(chart: Chart, photos: Sequence[SeenPatches]) -> ColorFit:
    """The matrix by which photographs of a chart show its colours best.

    Of patch i in photograph p, s_p(x_i) M D_p(x_i) c_pi - g_p = t_i, with camera RGB c, the reference t, glare g, s of
    second degree in places x as lamps fall off, with r^4 as lenses do, and D diagonal, as lamps of two colours light
    it. Differences count as by lightness, t^(-2/3), and greys by how much less they scatter: their spectra are flat, so
    that all cameras see them alike. All is solved for together.
    """
    reference = chart.srgb
    lightness = (np.maximum(reference @ LUMINANCE, 0) + _DARK) ** -_LIGHTNESS
    rgb = np.stack([photo.rgb for photo in photos])
    places = np.stack([_powers(_across(photo.centres)) for photo in photos])
    grey = np.isin(np.arange(len(reference)), chart.greys)
    weighed = rgb * lightness[:, None]
    start = np.linalg.lstsq(
        weighed.reshape(-1, 3), np.tile(reference * lightness[:, None], (len(photos), 1)), rcond=None
    )[0]
    own = np.tile(np.eye(_LIGHT + _TINT + _GLARE)[0], len(photos))
    numbers = np.concatenate([start.T.ravel(), own[1:]])
    seen = _Seen(rgb, places, reference, lightness)
    for _ in range(_ROUNDS):
        solved = _least(seen.off, numbers)
        numbers = solved.x
        left = np.abs((seen.shown(numbers) - reference) * lightness[:, None])
        scatter = np.sqrt((left**2).mean(axis=(0, 2)))
        colours, greys = (float(np.sqrt(np.mean(scatter[of] ** 2))) for of in (~grey, grey))
        more = np.clip(colours / max(greys, 1e-12), 1.0, _MOST_CERTAIN)
        seen = _Seen(rgb, places, reference, lightness * np.where(grey, more, 1.0))
    solved = _least(seen.off, numbers)
    matrix, light, tint, glare = seen.parts(solved.x)
    covariance = _covariance(solved.jac, solved.fun)
    scaled, change = _keeping_green(matrix)
    # The level of the first photograph has none.
    _, light_std, tint_std, glare_std = seen.parts(np.sqrt(np.diag(covariance)))
    evened = np.einsum("pnt,pt->pn", places, light)
    shares = (1 / evened) / (1 / evened).mean(axis=1, keepdims=True)
    return ColorFit(
        scaled,
        change @ covariance[:9, :9] @ change.T,
        shares,
        # Where s makes up for less light, light grows the other way.
        -light[:, 1:3] / light[:, :1],
        light_std[:, 1:3] / np.abs(light[:, :1]),
        -tint,
        tint_std,
        glare,
        glare_std,
        seen.shown(solved.x),
        reference,
        float(np.sqrt(np.mean(scatter**2))),
        *_exponent(seen, solved.x),
    )


def _least(off: Callable[[Floats], Floats], start: Floats) -> OptimizeResult:
    """The least squares of residuals from a start on, as far as `_MOST_TRIALS` lead."""
    return least_squares(off, start, x_scale="jac", method="lm", max_nfev=_MOST_TRIALS)


def _exponent(seen: _Seen, numbers: Floats) -> tuple[float, float]:
    """The power of the camera's numbers that fits best with all else, and its standard deviation."""

    def off(more: Floats) -> Floats:
        return replace(seen, rgb=np.maximum(seen.rgb, _BLACK) ** more[-1]).off(more[:-1])

    ways = [_least(off, np.append(numbers, start)) for start in _EXPONENTS]
    best = min(ways, key=lambda way: float(way.cost))
    return float(best.x[-1]), float(np.sqrt(_covariance(best.jac, best.fun)[-1, -1]))


def _covariance(jacobian: Floats, left: Floats) -> Floats:
    """Of the numbers, by what each patch would move them if it were left out [MacKinnon, White 1985, HC3]."""
    slopes, residuals = jacobian.reshape(-1, 3, jacobian.shape[1]), left.reshape(-1, 3)
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    own = slopes @ inverse @ slopes.transpose(0, 2, 1)
    unseen = np.linalg.solve(np.eye(3) - own, residuals[..., None])[..., 0]
    moves = np.einsum("pq,naq,na->np", inverse, slopes, unseen)
    return np.asarray(moves.T @ moves)


def _across(centres: Floats) -> Floats:
    """Places (n, 2) from -0.5 to 0.5 across the chart's longer side."""
    middle = (centres.min(axis=0) + centres.max(axis=0)) / 2
    return np.asarray((centres - middle) / np.ptp(centres, axis=0).max())


def _powers(places: Floats) -> Floats:
    """1, x, y, x^2, x y, y^2, r^4 of places (n, 2)."""
    x, y = places.T
    return np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y, (x * x + y * y) ** 2], axis=1)


def _keeping_green(matrix: Floats) -> tuple[Floats, Floats]:
    """A matrix scaled so that neutrals keep their green, and derivatives (9, 9) of it."""
    inverse = np.linalg.inv(matrix)
    neutral = inverse @ np.ones(3)
    # d(neutral) = -M^-1 dM neutral.
    slope = -np.outer(inverse[1], neutral).ravel()
    return matrix * neutral[1], neutral[1] * np.eye(9) + np.outer(matrix.ravel(), slope)

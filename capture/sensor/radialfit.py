"""Vignetting as a radial polynomial, fitted to flat-field photographs: the simplest that predicts unseen parts.

The light on a wall is never quite even: each photograph may have a linear gradient of its own, and a saddle. A gradient
and a shift of the vignetting's centre look alike in one photograph, up to terms of third order, which is why the
camera should be turned between them. Where it wasn't, neither is taken to be absent because the other explains the
photograph: both are fitted, within what is usual of lamps and lenses, and the intervals hold what that leaves open.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from capture.parallel import one_blas_thread
from capture.selection import simplest
from capture.sensor.flatfield import ORDERS, RadialFlatField, half_diagonal
from capture.sensor.flatlight import TERMS, light_terms
from capture.sensor.flattiles import FlatTiles

Floats = NDArray[np.float64]

_NUMBERS = 2 + 3 * ORDERS
_FOLDS = 5
# Gradients that are let go beyond this over half the diagonal are no lamp's.
_WIDE_GRADIENT = 0.5
# A wall's light changes by about this much over half the diagonal, where no turned camera shows it.
_USUAL_GRADIENT = 0.03
# Lenses are centred to about this part of half the diagonal.
_USUAL_CENTRE = 0.1
# Gradients that scatter by less than this part of their mean are one gradient: the camera was never turned.
_ALIKE = 0.3
# An outlier is this many deviations off its neighbourhood.
_OUTLYING = 5.0
_BORDER = 3  # tiles


@dataclass(frozen=True)
class RadialModel:
    """One candidate: how many orders, the centre free or the image's, coefficients per channel or shared, and a
    gradient and saddle of the light in each photograph or none."""

    order: int
    free_centre: bool
    per_channel: bool
    gradient: bool

    @property
    def basis(self) -> Floats:
        """(17, k): centre and coefficients of all channels from the fitted numbers."""
        columns = []
        if self.free_centre:
            columns += [np.eye(_NUMBERS)[0], np.eye(_NUMBERS)[1]]
        for power in range(self.order):
            rows = np.eye(_NUMBERS)[[2 + ORDERS * channel + power for channel in range(3)]]
            columns += list(rows) if self.per_channel else [rows.sum(axis=0)]
        return np.array(columns).T


@dataclass(frozen=True, eq=False)
class RadialFit:
    """A candidate's fit. numbers : (17,) centre, in half diagonals from the image centre, and coefficients.

    held_out : (t,) mean squared error of the logarithm on each tile, predicted from the others, in units of its
    variance. light : (p, 4) of each photograph, as in `flatlight`; light_covariance : (3, 3) of what is undetermined
    from the lens: their mean gradient, and a bowl (times r^2) as deep as their saddles, which no turned camera shows.
    residual : (p, t, 3) of the logarithm. turned : the light's gradients differ, so that the camera was turned.
    """

    model: RadialModel
    numbers: Floats
    covariance: Floats
    light: Floats
    light_covariance: Floats
    residual: Floats
    structured: Floats
    held_out: Floats
    turned: bool = True

    @property
    def gradients(self) -> Floats:
        """(p, 2) relative change of the light per half diagonal, to the right and down."""
        return self.light[:, :2]

    @property
    def centre_known(self) -> bool:
        """Whether the photographs determine more of the centre than is known of any lens."""
        return bool((np.diag(self.covariance)[:2] < (_USUAL_CENTRE / 2) ** 2).all())


def fit_radial(tiles: FlatTiles) -> tuple[RadialFit, list[RadialFit]]:
    """The chosen fit, and all candidates: of the highest order with each kind of centre, channels and light, then of
    each order with the kind that was chosen.

    Chosen is the simplest whose held-out error isn't clearly above the best one's: by one standard error of the
    difference, tile by tile. What the best one says otherwise is added to the covariance. One photograph, or several
    whose gradients agree, the camera never turned, have the centre free and the gradient too: the light then is
    taken to change by 3% over half the diagonal (standard deviation), and the centre to be a tenth of it off.
    """
    photos = len(tiles.signal)
    richest = RadialModel(ORDERS, True, True, True)
    with one_blas_thread():
        # Outliers, noise and misfit are those that even the richest model leaves, for all candidates alike.
        spread, wide, turned = tiles.relative_std, _WIDE_GRADIENT, False
        for _ in range(3):
            _, light, residual, *_ = _solve(tiles, richest, spread, wide)
            spread = _spread(tiles, residual)
            turned = _turned(light[:, :2])
            # Gradients of the light are around zero: that is what separates them from a shifted centre.
            around_zero = np.sqrt(np.mean(light[:, :2] ** 2) * photos / max(photos - 1, 1))
            wide = float(np.clip(around_zero, 1e-5, _WIDE_GRADIENT)) if turned else _USUAL_GRADIENT
        fits = [_fit(tiles, model, spread, wide) for model in _richest(turned)]
        kind = _simplest(fits)[0].model
        fits += [_fit(tiles, replace(kind, order=order), spread, wide) for order in range(1, ORDERS)]
    fit, best = _simplest(fits)
    otherwise = best.numbers - fit.numbers
    mean_gradient = (best.gradients - fit.gradients).mean(axis=0)
    return replace(
        fit,
        covariance=fit.covariance + np.outer(otherwise, otherwise),
        light_covariance=fit.light_covariance + np.pad(np.outer(mean_gradient, mean_gradient), (0, 1)),
        turned=turned,
    ), fits


def flat_field_of(fit: RadialFit, tiles: FlatTiles) -> RadialFlatField:
    """The fit as a flat field, in pixels."""
    scale = np.ones(_NUMBERS)
    scale[:2] = half_diagonal(tiles.width, tiles.height)
    numbers = fit.numbers * scale
    return RadialFlatField(
        tiles.width,
        tiles.height,
        numbers[:2] + np.array([tiles.width / 2, tiles.height / 2]),
        numbers[2:].reshape(3, ORDERS),
        fit.covariance * np.outer(scale, scale),
        fit.structured,
    )


def _turned(gradients: Floats) -> bool:
    """Whether the light's gradients (p, 2) differ from photograph to photograph, as they do if the camera is turned."""
    mean = gradients.mean(axis=0)
    scatter = np.sqrt(np.mean(np.sum((gradients - mean) ** 2, axis=1)))
    return len(gradients) > 1 and bool(scatter > _ALIKE * np.linalg.norm(mean))


def _richest(turned: bool) -> Iterator[RadialModel]:
    for free, per_channel, gradient in product((False, True), repeat=3):
        if turned or (free and gradient):
            yield RadialModel(ORDERS, free, per_channel, gradient)


def _simplest(fits: Sequence[RadialFit]) -> tuple[RadialFit, RadialFit]:
    """The simplest fit that isn't clearly worse than the best, and the best."""
    parameters = [fit.model.basis.shape[1] + fit.model.gradient for fit in fits]
    chosen = simplest([fit.held_out for fit in fits], parameters)
    return fits[chosen], min(fits, key=lambda fit: float(fit.held_out.mean()))


def _fit(tiles: FlatTiles, model: RadialModel, spread: Floats, wide: float) -> RadialFit:
    numbers, light, residual, derivatives = _solve(tiles, model, spread, wide)
    derivatives = derivatives.weighted(1 / spread)
    target = residual / spread
    normal, _ = derivatives.normal(target)
    inverse = np.asarray(np.linalg.inv(normal + derivatives.prior(model, wide)), float)
    k = model.basis.shape[1]
    # The sandwich over neighbourhoods, for misfit is alike in neighbours and in all photographs.
    scores = derivatives.scores(target)
    blocks = np.zeros((tiles.block.max() + 1, scores.shape[1]))
    np.add.at(blocks, tiles.block, scores)
    robust = inverse @ (blocks.T @ blocks) @ inverse
    plain = inverse[:k, :k]
    scale = max(1.0, float(np.trace(np.linalg.solve(plain, robust[:k, :k]))) / k)
    # A single shadow pulls at the light alone, which the mean over all numbers hides.
    rows = derivatives.mean_gradient
    gradient = max([rows @ (scale * inverse) @ rows.T, rows @ robust @ rows.T], key=np.trace)
    # A wall that is bent along one axis only is half saddle, half bowl.
    bowl = max(
        float(np.mean(np.sum(light[:, 2:] ** 2, axis=1)) - scale * derivatives.saddle_variance(inverse)), 0
    )
    a = np.column_stack([np.ones(3), numbers[2:].reshape(3, ORDERS)[:, :-1]])
    bent = np.concatenate([[0, 0], a.ravel()])
    excess = np.mean(np.where(np.isfinite(spread), residual**2 - tiles.relative_std**2, 0), axis=(0, 1))
    return RadialFit(
        model,
        numbers,
        model.basis @ (plain * scale) @ model.basis.T + bowl * np.outer(bent, bent),
        light,
        np.block([[gradient, np.zeros((2, 1))], [np.zeros(2), np.array([bowl])]]),
        residual,
        np.sqrt(np.maximum(excess, 0)),
        _held_out(tiles, derivatives, target, derivatives.prior(model, wide)),
    )


def _held_out(tiles: FlatTiles, derivatives: _Derivatives, target: Floats, prior: Floats) -> Floats:
    """Each tile's squared error when its fold of neighbourhoods is left out, by one step from the full fit."""
    full = derivatives.normal(target)[0] + prior
    error = np.empty(target.shape[1])
    fold = (tiles.block * 2 + tiles.block // 7) % _FOLDS
    for number in range(_FOLDS):
        out = fold == number
        part = derivatives.at(out)
        lost, slope = part.normal(target[:, out])
        # The full fit has no slope of its own beside its prior's: what is left is what the fold contributed.
        change = np.asarray(np.linalg.solve(full - lost, -slope), float)
        error[out] = ((target[:, out] - part.predict(change)) ** 2).mean(axis=(0, 2))
    return error


def _spread(tiles: FlatTiles, residual: Floats) -> Floats:
    """Standard deviation of each tile's logarithm: its noise, and what no model explains; infinite for outliers.

    An outlier (dust, a mark on the wall) differs from its neighbourhood; where the model as such doesn't fit,
    neighbours agree.
    """
    import cv2

    grid = residual.reshape(len(residual), *tiles.grid, 3).astype(np.float32)
    smooth = np.array([[cv2.medianBlur(photo[..., c].copy(), 5) for c in range(3)] for photo in grid])
    local = np.abs(grid - np.moveaxis(smooth, 1, -1)).reshape(residual.shape)
    scale = 1.4826 * np.median(local, axis=1, keepdims=True)
    outlier = local > _OUTLYING * np.maximum(scale, tiles.relative_std)
    # The skirts of a shadow, too faint to stand out, would still pull at centre and gradient: neighbours go along. Not
    # at the borders, where it may be the lens that falls off sharply.
    shape = (len(residual), *tiles.grid, 3)
    wider = np.array(
        [cv2.dilate(photo, np.ones((3, 3))) for photo in outlier.reshape(shape).astype(np.uint8)]
    )
    inside = np.s_[:, _BORDER:-_BORDER, _BORDER:-_BORDER]
    outlier = outlier.reshape(shape)
    outlier[inside] |= wider[inside] > 0
    outlier = outlier.reshape(residual.shape)
    misfit = np.mean(np.where(outlier, 0, residual**2 - tiles.relative_std**2))
    return np.where(outlier, np.inf, np.sqrt(tiles.relative_std**2 + max(float(misfit), 0)))


def _solve(
    tiles: FlatTiles, model: RadialModel, spread: Floats, wide: float
) -> tuple[Floats, Floats, Floats, _Derivatives]:
    """Gauss-Newton, the light's terms being around zero with deviation `wide`.

    Returns numbers (17,), light (p, 4), the residual (p, t, 3) and the derivatives of the logarithm.
    """
    basis = model.basis
    k, photos = basis.shape[1], len(tiles.signal)
    measured = np.log(tiles.signal)
    fitted, light = np.zeros(k), np.zeros((photos, TERMS))
    levels = np.median(measured, axis=1)
    # Undamped, not `capture.gaussnewton`: the logarithm is nearly linear in the numbers.
    for _ in range(20):
        predicted, derivatives = _log_model(tiles, basis @ fitted, light, model)
        residual = measured - levels[:, None] - predicted
        normal, slope = derivatives.weighted(1 / spread).normal(residual / spread)
        prior = derivatives.prior(model, wide)
        own = np.concatenate([levels * 0, light], axis=1) if model.gradient else levels * 0
        slope -= prior @ np.concatenate([fitted, own.ravel()])
        change = np.linalg.solve(normal + prior + 1e-12 * np.eye(len(slope)), slope)
        fitted = fitted + change[:k]
        own = change[k:].reshape(photos, -1)
        levels = levels + own[:, :3]
        if model.gradient:
            light = np.clip(light + own[:, 3:], -0.9, 0.9)
        if np.abs(change).max() < 1e-8:
            break
    predicted, derivatives = _log_model(tiles, basis @ fitted, light, model)
    return basis @ fitted, light, measured - levels[:, None] - predicted, derivatives


def _log_model(
    tiles: FlatTiles, numbers: Floats, light: Floats, model: RadialModel
) -> tuple[Floats, _Derivatives]:
    """The logarithm of each tile's mean (p, t, 3) at level 1, and its derivatives."""
    photos, count = len(light), len(tiles.position)
    terms = light_terms(tiles.position)
    offset = tiles.position - numbers[:2]
    squares = (offset**2).sum(axis=-1)[..., None]
    orders = np.arange(1, ORDERS + 1)
    powers = squares**orders
    a = numbers[2:].reshape(3, ORDERS)
    lens = np.maximum(1 + powers @ a.T, 1e-3)  # (t, 4, 3)
    inward = -2 * squares ** (orders - 1) @ (orders * a).T  # (t, 4, 3)
    lit = np.maximum(1 + np.einsum("tgi,pi->ptg", terms, light), 0.05)  # (p, t, 4)
    seen = np.einsum("ptg,tgc->ptc", lit, lens)
    full = np.zeros((photos, count, 3, _NUMBERS))
    full[..., :2] = np.einsum("ptg,tgc,tgi->ptci", lit, inward, offset, optimize=True)
    moments = np.einsum("ptg,tgk->ptk", lit, powers)
    for channel in range(3):
        full[:, :, channel, 2 + ORDERS * channel : 2 + ORDERS * (channel + 1)] = moments
    own = np.broadcast_to(np.eye(3), (photos, count, 3, 3))
    if model.gradient:
        towards = np.einsum("tgi,tgc->tci", terms, lens)
        own = np.concatenate([own, towards / seen[..., None]], axis=-1)
    # One product of matrices: of many small ones each takes its time.
    chosen = (full.reshape(-1, _NUMBERS) @ model.basis).reshape(photos, count, 3, -1)
    return np.log(seen / 4), _Derivatives(chosen / seen[..., None], own)


@dataclass(frozen=True, eq=False)
class _Derivatives:
    """Derivatives of each tile's logarithm: shared (p, t, 3, k) by the fitted numbers, own (p, t, 3, 3 or 7) by the
    photograph's levels and light. Numbers are ordered shared first, then photograph by photograph."""

    shared: Floats
    own: Floats

    def weighted(self, weight: Floats) -> _Derivatives:
        return _Derivatives(self.shared * weight[..., None], self.own * weight[..., None])

    def at(self, tiles: NDArray[np.bool_]) -> _Derivatives:
        return _Derivatives(self.shared[:, tiles], self.own[:, tiles])

    def normal(self, target: Floats) -> tuple[Floats, Floats]:
        """The normal matrix and its right side: an arrow, since photographs share nothing but the lens."""
        k, blocks = self.shared.shape[-1], self._blocks()
        matrix, vector = np.zeros((blocks[-1].stop,) * 2), np.zeros(blocks[-1].stop)
        for shared, own, aim, block in zip(self.shared, self.own, target, blocks, strict=True):
            lens, photo, aims = shared.reshape(-1, k), own.reshape(-1, own.shape[-1]), aim.ravel()
            matrix[:k, :k] += lens.T @ lens
            matrix[:k, block] = lens.T @ photo
            matrix[block, :k] = matrix[:k, block].T
            matrix[block, block] = photo.T @ photo
            vector[:k] += lens.T @ aims
            vector[block] = photo.T @ aims
        return matrix, vector

    def prior(self, model: RadialModel, wide: float) -> Floats:
        """The inverse variance of centre and light, both around zero, on the normal matrix's diagonal."""
        blocks = self._blocks()
        diagonal = np.zeros(blocks[-1].stop)
        diagonal[: 2 * model.free_centre] = _USUAL_CENTRE**-2
        for block in blocks:
            diagonal[block.start + 3 : block.stop] = wide**-2
        return np.diag(diagonal)

    @property
    def mean_gradient(self) -> Floats:
        """(2, k + ...): the mean of the photographs' gradients from the numbers; 0 where none were fitted."""
        blocks = self._blocks()
        rows = np.zeros((2, blocks[-1].stop))
        for block in blocks:
            columns = np.arange(block.start + 3, block.stop)[:2]
            rows[np.arange(len(columns)), columns] = 1 / len(blocks)
        return rows

    def saddle_variance(self, covariance: Floats) -> float:
        """The mean over the photographs of their saddles' variance, both terms together."""
        columns = np.concatenate([np.arange(block.start + 5, block.stop) for block in self._blocks()])
        return float(np.diag(covariance)[columns].sum()) / len(self.own)

    def scores(self, target: Floats) -> Floats:
        """(t, k + ...): what each tile contributes to the right side."""
        shared = np.einsum("ptci,ptc->ti", self.shared, target, optimize=True)
        own = np.einsum("ptci,ptc->tpi", self.own, target, optimize=True)
        return np.concatenate([shared, own.reshape(len(own), -1)], axis=1)

    def predict(self, change: Floats) -> Floats:
        """The change (p, t, 3) of the logarithm for a change of the numbers."""
        k = self.shared.shape[-1]
        own = np.einsum("ptci,pi->ptc", self.own, change[k:].reshape(len(self.own), -1))
        return np.asarray(self.shared @ change[:k] + own)

    def _blocks(self) -> list[slice]:
        k, size = self.shared.shape[-1], self.own.shape[-1]
        return [slice(k + size * photo, k + size * (photo + 1)) for photo in range(len(self.own))]

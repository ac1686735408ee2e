"""mu, sigma and the model of a textured object, from a subset of its points: each has a Kd, and a Ks, of its own.

Outside, a search over mu and sigma; inside, the tiny linear problems of all points [RH01, section 6.4]. Three questions
are the photographs': whether there is a specular part, whether it has a Fresnel factor, and whether its Ks varies too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from invrender.model.columns import specular_weights
from invrender.model.microfacet import Microfacet
from invrender.solve.evidence import Rung, choose, relative_rms
from invrender.solve.noise import NoiseModel, fit_noise
from invrender.solve.search import Estimate, Model, best_point
from invrender.texture.sums import PointValues, Sums, common_ks, solve_both, solve_kd

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# mu and sigma, as far as a model has them.
Numbers = tuple[float | None, float | None]

# Noise that the first fit takes for granted, relative and of the RMS radiance: it only has to weigh dark and bright.
_FIRST_NOISE = NoiseModel(0.01, 0.01)
# Rows of a photograph left out count for the evidence if the others predict them to this many times their own noise.
_PREDICTED = 1.0
# Step of the slopes, in log sigma and log(mu - 1).
_STEP = 0.02


@dataclass(frozen=True)
class TexturedModel(Model):
    """A rung: what varies over the surface besides Kd."""

    ks_varies: bool = False


LADDER = (
    TexturedModel("lambertian, Kd varies", specular=False, fresnel=False),
    TexturedModel("microfacet without Fresnel, Kd varies", specular=True, fresnel=False),
    TexturedModel("microfacet, Kd varies", specular=True, fresnel=True),
    TexturedModel("microfacet, Kd and Ks vary", specular=True, fresnel=True, ks_varies=True),
)


@dataclass(frozen=True, eq=False)
class Rows:
    """What a photograph says of the points that it sees.

    points : (r,), each once. columns : (channels, r, q), as of `PhotoColumns`. radiance : (r, 3); brightness : (r, 3),
    about the same, by which noise is judged. share : (r,), the variance of these interpolated numbers over that of a
    pixel, divided by how far its geometry is trusted. tiles : (r,), from 0, the tile of the photograph that each is in.
    """

    points: Ints
    columns: NDArray[np.float32]
    radiance: Floats
    brightness: Floats
    share: Floats
    tiles: Ints

    def transfers(self, mu: float | None, sigma: float | None) -> tuple[Floats, Floats]:
        """Diffuse and specular transfers (r, 3) at mu and sigma."""
        diffuse = self.columns[..., 0].T
        if sigma is None:
            specular = np.zeros_like(diffuse)
        else:
            specular = (self.columns[..., 1:] @ specular_weights(mu, sigma).astype(np.float32)).T
        shape = self.radiance.shape
        return np.broadcast_to(diffuse, shape).astype(float), np.broadcast_to(specular, shape).astype(float)


@dataclass(frozen=True, eq=False)
class TexturedFit:
    """What a subset of the points says of the whole.

    rungs, chosen : the ladder; an estimate's Kd and Ks are means over the points. covariance, fragility : of the
    logarithms of sigma and mu - 1, as far as the chosen model has them; as of `uncertainty.Uncertainty`.
    common_ks, common_ks_std : (3,), of all points where Ks doesn't vary.
    """

    rungs: tuple[Rung, ...]
    chosen: int
    noise: NoiseModel
    covariance: Floats
    fragility: Floats
    common_ks: Floats
    common_ks_std: Floats

    @property
    def model(self) -> TexturedModel:
        model = self.rungs[self.chosen].estimate.model
        assert isinstance(model, TexturedModel)
        return model

    @property
    def brdf(self) -> Microfacet:
        return self.rungs[self.chosen].estimate.brdf


def fit_textured(
    photos: Sequence[Rows], points: int, on_step: Callable[[], None] = lambda: None
) -> TexturedFit:
    """Fit the ladder to what photographs say of some points; `on_step` is called after each of its rungs."""
    scale = float(np.sqrt(np.mean(np.concatenate([rows.radiance for rows in photos]) ** 2)))
    richest = LADDER[-1]
    stack = _Stack.of(photos, points, NoiseModel(_FIRST_NOISE.floor * scale, _FIRST_NOISE.relative))
    noise = _noise(richest, stack, _search(richest, stack))
    stack = _Stack.of(photos, points, noise)
    fitted = [(model, _search(model, stack)) for model in LADDER]
    judged = _judged(richest, stack, len(photos), fitted[-1][1])
    rungs = []
    for model, point in fitted:
        rungs.append(_rung(model, stack, len(photos), point, judged))
        on_step()
    chosen = choose(rungs)
    model, point = fitted[chosen]
    ks = ks_std = np.zeros(3)
    if model.specular and not model.ks_varies:
        ks, ks_std = common_ks(stack.sums(_numbers(model, point)))
    covariance, fragility = _uncertainty(model, stack, point)
    return TexturedFit(tuple(rungs), chosen, noise, covariance, fragility, ks, ks_std)


def solved(model: TexturedModel, sums: Sums, ks: Floats | None = None) -> PointValues:
    """Kd and Ks of points under a model; ks : (3,), where it doesn't vary, as found by others."""
    if model.ks_varies:
        return solve_both(sums)
    if not model.specular:
        return solve_kd(sums, np.zeros(3))
    return solve_kd(sums, common_ks(sums)[0] if ks is None else ks)


def _numbers(model: Model, point: Floats) -> Numbers:
    """mu and sigma at the search's coordinates, log sigma and log(mu - 1)."""
    sigma = float(np.exp(point[0])) if model.specular else None
    return (1 + float(np.exp(point[1])) if model.fresnel else None), sigma


@dataclass(frozen=True, eq=False)
class _Stack:
    """The rows of all photographs together, sorted by point, and their weights under a noise.

    points : (p,), those seen; starts : (p,), their first rows. size : of all points. photo : (r,), the photograph of
    each row.
    """

    rows: Rows
    weight: Floats
    points: Ints
    starts: Ints
    size: int
    photo: Ints

    @classmethod
    def of(cls, photos: Sequence[Rows], size: int, noise: NoiseModel) -> _Stack:
        photo = np.repeat(np.arange(len(photos)), [len(rows.points) for rows in photos])
        first = np.cumsum([0, *(rows.tiles.max() + 1 for rows in photos)])
        points = np.concatenate([rows.points for rows in photos])
        order = np.argsort(points, kind="stable")

        def joined(name: str) -> NDArray[Any]:
            return np.concatenate([getattr(rows, name) for rows in photos])[order]

        tiles = np.concatenate([rows.tiles + start for rows, start in zip(photos, first, strict=False)])
        columns = np.concatenate([rows.columns for rows in photos], axis=1)[:, order]
        brightness, share = joined("brightness"), joined("share")
        rows = Rows(points[order], columns, joined("radiance"), brightness, share, tiles[order])
        weight = 1 / (noise.variance(brightness) * share[:, None])
        seen, starts = np.unique(rows.points, return_index=True)
        return cls(rows, weight, seen, starts, size, photo[order])

    def sums(self, numbers: Numbers, photo: int | None = None) -> Sums:
        """Normal equations of all points at mu and sigma, of all photographs or of one."""
        d, s = self.rows.transfers(*numbers)
        y, weight = self.rows.radiance, self.weight
        if photo is not None:
            weight = np.where((self.photo == photo)[:, None], weight, 0)
        parts = np.stack([d * d, d * s, s * s, d * y, s * y, y * y], axis=1) * weight[:, None]
        total = np.zeros((self.size, 6, 3))
        total[self.points] = np.add.reduceat(parts, self.starts)
        count = np.zeros(self.size)
        count[self.points] = np.add.reduceat((weight[:, 0] > 0).astype(float), self.starts)
        return Sums(*np.moveaxis(total, 1, 0).copy(), count)

    def predicted(self, values: PointValues, numbers: Numbers) -> Floats:
        """Radiance (r, 3) of the rows, of points with given values."""
        d, s = self.rows.transfers(*numbers)
        return values.kd[self.rows.points] * d + values.ks[self.rows.points] * s


def _search(model: TexturedModel, stack: _Stack) -> Floats:
    if not model.specular:
        return np.zeros(0)
    return best_point(
        model, lambda point: float(solved(model, stack.sums(_numbers(model, point))).cost.sum())
    )


def _noise(model: TexturedModel, stack: _Stack, point: Floats) -> NoiseModel:
    """The noise of a pixel, from what a fit leaves: more than that by what each point's own numbers take up."""
    numbers = _numbers(model, point)
    total = stack.sums(numbers)
    values = solved(model, total)
    at = stack.rows.points
    free = values.freedom[at] > 0
    taken = np.sqrt(total.count / np.maximum(values.freedom, 1))[at]
    predicted = stack.predicted(values, numbers)
    residual = (stack.rows.radiance - predicted) * (taken / np.sqrt(stack.rows.share))[:, None]
    return fit_noise([predicted[free]], [residual[free]])


def _judged(model: TexturedModel, stack: _Stack, photos: int, point: Floats) -> NDArray[np.bool_]:
    """Which rows (r,) the richest model predicts well enough from the other photographs to be judged by."""
    numbers = _numbers(model, point)
    total = stack.sums(numbers)
    d, s = stack.rows.transfers(*numbers)
    judged = np.zeros(len(d), bool)
    for photo in range(photos):
        own = np.flatnonzero(stack.photo == photo)
        rest = total - stack.sums(numbers, photo)
        dd, ds, ss = (part[stack.rows.points[own]] for part in (rest.dd, rest.ds, rest.ss))
        determinant = dd * ss - ds**2
        apart = determinant > 1e-6 * dd * ss
        gain = d[own] ** 2 * ss - 2 * d[own] * s[own] * ds + s[own] ** 2 * dd
        variance = gain / np.where(apart, determinant, 1)
        judged[own] = (apart & (variance * stack.weight[own] < _PREDICTED)).all(axis=1)
    return judged


def _rung(model: TexturedModel, stack: _Stack, photos: int, point: Floats, judged: NDArray[np.bool_]) -> Rung:
    """A rung with its evidence: each photograph predicted from Kd and Ks that the others give.

    mu and sigma are those of all photographs: two numbers that one of them moves but little.
    """
    numbers = _numbers(model, point)
    total = stack.sums(numbers)
    values = solved(model, total)
    seen = total.count > 0
    brdf = Microfacet(values.kd[seen].mean(axis=0), values.ks[seen].mean(axis=0), *numbers)
    errors = np.full(photos, np.nan)
    for photo in range(photos):
        use = judged & (stack.photo == photo)
        if use.any():
            unseen = solved(model, total - stack.sums(numbers, photo))
            radiance = stack.rows.radiance[use]
            errors[photo] = relative_rms(radiance - stack.predicted(unseen, numbers)[use], radiance)
    if np.isnan(errors).all():
        raise ValueError(
            "no point of the object is seen by enough photographs to tell how well others predict it; take more, from"
            " sides that overlap, or leave texture out"
        )
    # A photograph that shares no points with others has no say.
    errors = np.where(np.isnan(errors), np.nanmean(errors), errors)
    count = int(seen.sum()) * 3 * (1 + model.ks_varies) + 3 * (model.specular and not model.ks_varies)
    estimate = Estimate(model, brdf, {}, float(values.cost.sum()))
    return Rung(estimate, errors, np.zeros(1), count + model.specular + model.fresnel)


def _uncertainty(model: TexturedModel, stack: _Stack, point: Floats) -> tuple[Floats, Floats]:
    """Covariance (k, k) and fragility (k,) of the search's coordinates, as `uncertainty.uncertainty_of` has them.

    All points' own numbers are solved for anew as the coordinates move: what is left of the residuals' slopes is what
    tells of these alone. Clusters are tiles of photographs.
    """
    size = len(point)
    if not size:
        return np.zeros((0, 0)), np.zeros(0)
    root = np.sqrt(stack.weight)

    def predicted(at: Floats) -> Floats:
        numbers = _numbers(model, at)
        return stack.predicted(solved(model, stack.sums(numbers)), numbers) * root

    centre = predicted(point)
    slopes = []
    for axis in range(size):
        step = _STEP * np.eye(size)[axis]
        slopes.append((predicted(point + step) - predicted(point - step)) / (2 * _STEP))
    jacobian = np.stack(slopes, axis=-1)  # (rows, 3, k)
    residual = stack.rows.radiance * root - centre
    values = solved(model, stack.sums(_numbers(model, point)))
    freedom = 3 * float(np.maximum(values.freedom, 0).sum())
    reduced = float((residual**2).sum()) / max(freedom, 1)
    # A prior: what the photographs don't touch would have an infinite variance, and drag the other with it.
    inverse = np.linalg.inv(np.einsum("rci,rcj->ij", jacobian, jacobian) / reduced + np.eye(size))

    def pull(off: Floats) -> Floats:
        scores = np.einsum("rci,rc->ri", jacobian, off) / reduced
        by_tile = np.stack([np.bincount(stack.rows.tiles, column) for column in scores.T], axis=1)
        return np.sqrt(((by_tile @ inverse) ** 2).sum(axis=0))

    wider = np.maximum(pull(residual) / np.sqrt(np.diag(inverse)), 1)
    return inverse * np.outer(wider, wider), pull(centre)

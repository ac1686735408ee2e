"""What a fit leaves of photographs, thinned and weighted for a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as defaulted
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from invrender.brdf.microfacet import Microfacet
from invrender.estimate.clusters import tile_of
from invrender.transport.visibility import Shadows
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Samples of all photographs together that a diagnosis looks at, and those of maps of light, which take longer.
_SAMPLES, _SAMPLES_OF_MAPS = 8_000, 1_200
# Photographs, and samples of them, on which a search goes.
_FEW_PHOTOS, _FEW_SAMPLES = 12, 2_000
# Parts of the photographs that are left out in turn.
FOLDS = 4
# Points of the surface around each, from which its curvature is read.
_AROUND = 12
# A sample is alone if the most similar of so many neighbours differs by so many times the usual difference.
_NEIGHBOURS, _ALONE = 4, 8.0
# Part of the squared differences of neighbours that is looked at, and its mean over the variance of normal noise.
_KEPT, _KEPT_MEAN = 0.95, 0.759

Rest = Callable[[Microfacet, LightField], tuple[Floats, Floats]]
# Of the last so many BRDFs and fields of one lighting it is kept what they reflect: most alterations leave both alone.
_KEPT_RESTS = 4096
# Of the last so many BRDFs it is kept what a photograph shows.
_KEPT_BRDFS = 16


def remembered(rest: Rest) -> Rest:
    """The same, that keeps what it found; of the BRDF it must depend on form, mu, sigma, and whether Ks is zero."""
    found: dict[tuple[Any, ...], tuple[LightField, tuple[Floats, Floats]]] = {}

    def again(brdf: Microfacet, field: LightField) -> tuple[Floats, Floats]:
        # Kept with their result, arrays can't give their addresses to others.
        key = (
            brdf.form.name,
            *brdf.form.numbers.values(),
            brdf.mu,
            brdf.sigma,
            bool(brdf.ks.any()),
            id(field.normals),
            id(field.positions),
        )
        if key not in found:
            if len(found) >= _KEPT_RESTS:
                found.pop(next(iter(found)))
            found[key] = field, rest(brdf, field)
        return found[key][1]

    return again


@dataclass(frozen=True, eq=False)
class Remainder:
    """One photograph beside the light that a fit has on it.

    residual, weight : (n, 3) each, what the fit leaves, and the samples' inverse variance. directions, irradiances :
    (k, 3) each, of its sources. rest : what rays (m, 3) reflect of all other light per unit of Kd, and of Ks; None
    where there is no other. recovered : what of the lighting was found with the BRDF, of "irradiance", "ambient",
    "direction", "distance" and "sky". mapped : whether other light comes from a map, which takes long.
    """

    label: str
    lighting: str
    field: LightField
    residual: Floats
    weight: Floats
    directions: Floats
    irradiances: Floats
    rest: Rest | None
    recovered: frozenset[str] = frozenset()
    mapped: bool = False
    _unaltered: dict[tuple[Any, ...], tuple[Floats, Floats]] = defaulted(init=False, default_factory=dict)

    def unaltered(
        self, brdf: Microfacet, shown: Callable[[], tuple[Floats, Floats]]
    ) -> tuple[Floats, Floats]:
        """What samples show (n, 3) per unit of Kd, and of Ks, where nothing is altered, asked for once per BRDF.

        Most candidates begin there. It must depend on the BRDF's form, mu and sigma, and whether Ks is zero.
        """
        key = brdf.form, brdf.mu, brdf.sigma, bool(brdf.ks.any())
        if key not in self._unaltered:
            if len(self._unaltered) >= _KEPT_BRDFS:
                self._unaltered.pop(next(iter(self._unaltered)))
            self._unaltered[key] = shown()
        return self._unaltered[key]

    def where(self, keep: NDArray[np.bool_]) -> Remainder:
        """The samples marked by a mask (n,)."""
        return replace(
            self, field=self.field.where(keep), residual=self.residual[keep], weight=self.weight[keep]
        )

    @cached_property
    def curvature(self) -> Floats:
        """How normals vary with place on the surface, (m, 3, 3) 1/m, by least squares over the rays around each."""
        places, normals = self.field.positions, self.field.normals
        count = min(_AROUND, len(places))
        _, near = cKDTree(places).query(places, list(range(1, count + 1)))
        steps, turns = places[near] - places[:, None], normals[near] - normals[:, None]
        gram = np.einsum("mki,mkj->mij", steps, steps)
        # Across the surface there are no steps: what is added there keeps the inverse finite.
        gram += (1e-3 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-30) * np.eye(3)
        return np.asarray(np.einsum("mki,mkj,mjl->mil", turns, steps, np.linalg.inv(gram)))


@dataclass(frozen=True, eq=False)
class Remainders:
    """All fitted photographs of a set, and the BRDF that was fitted to them.

    centre, radius : of the object, metres. fold : (n,) per photograph, which part of it each sample belongs to.
    """

    photos: tuple[Remainder, ...]
    brdf: Microfacet
    shadows: Shadows | None
    centre: Floats
    radius: float
    fold: tuple[Ints, ...]

    @property
    def few(self) -> Remainders:
        """Some of the photographs and of their samples, enough to seek what is wrong with all of them."""
        step = -(-len(self.photos) // _FEW_PHOTOS)
        photos = self.photos[::step]
        stride = max(sum(len(photo.field) for photo in photos) // _FEW_SAMPLES, 1)
        keep = [np.arange(len(photo.field)) % stride == 0 for photo in photos]
        thin = [photo.where(own) for photo, own in zip(photos, keep, strict=True)]
        folds = [fold[own] for fold, own in zip(self.fold[::step], keep, strict=True)]
        return replace(self, photos=tuple(thin), fold=tuple(folds))

    def less(self, radiance: Sequence[Floats]) -> Remainders:
        """The same without a part (n, 3) of each photograph's radiance."""
        photos = [
            replace(photo, field=replace(photo.field, radiance=photo.field.radiance - own))
            for photo, own in zip(self.photos, radiance, strict=True)
        ]
        return replace(self, photos=tuple(photos))


def of_object(
    photos: Sequence[Remainder],
    trust: Sequence[Floats],
    brdf: Microfacet,
    shadows: Shadows | None,
    description: Mapping[str, Any],
) -> Remainders:
    """Photographs thinned to what a diagnosis needs, and cut into parts that are left out in turn.

    trust : (n, 3) per photograph, how far the fit trusts each sample, 0 to 1. Single outliers stay distrusted;
    where neighbours deviate alike the model may be wrong, and they count in full. description : of the object, with its
    centre and radius.
    """
    total = sum(len(photo.field) for photo in photos)
    most = _SAMPLES_OF_MAPS if any(photo.mapped for photo in photos) else _SAMPLES
    step = max(round(total / most), 1)
    thin, folds = [], []
    for number, (photo, trusted) in enumerate(zip(photos, trust, strict=True)):
        alone = _alone(photo.field, photo.residual * np.sqrt(photo.weight))
        weight = np.minimum(photo.weight, _certainty_of_the_dark(photo))
        weight = np.where(alone[:, None], weight * trusted, weight)
        keep = np.arange(len(photo.field)) % step == 0
        thin.append(replace(photo, weight=weight).where(keep))
        tiles = np.unique(tile_of(thin[-1].field), return_inverse=True)[1]
        turn = np.random.default_rng(number).permutation(int(tiles.max(initial=0)) + 1)
        folds.append(turn[tiles] % FOLDS)
    centre, radius = np.array(description["centre"], float), float(description["radius"])
    return Remainders(tuple(thin), brdf, shadows, centre, radius, tuple(folds))


def noise_energy(field: LightField, deviations: Floats) -> float:
    """The sum of squares that noise alone would leave of deviations (n, 3), from differences between neighbours."""
    if len(field) < 2:
        return float((deviations**2).sum())
    near = _neighbours(field, 1)[:, 0]
    squares = (deviations - deviations[near]) ** 2 / 2
    kept = squares <= np.quantile(squares, _KEPT, axis=0)
    return float((np.where(kept, squares, 0).sum(axis=0) / kept.sum(axis=0)).sum() * len(field) / _KEPT_MEAN)


def _certainty_of_the_dark(photo: Remainder) -> Floats:
    """Inverse variance (n, 3) of dark samples by how neighbours differ, infinite elsewhere.

    A fit reads noise off medians, and half of what files hold of black may be cut off at zero.
    """
    if len(photo.field) < 2:
        return np.full(photo.residual.shape, np.inf)
    apart = photo.residual - photo.residual[_neighbours(photo.field, 1)[:, 0]]
    shown = photo.field.radiance - photo.residual
    dark = shown <= np.median(shown, axis=0)
    variance = np.where(dark, apart**2, 0).sum(axis=0) / (2 * dark.sum(axis=0))
    return np.where(dark, 1 / np.maximum(variance, 1e-300), np.inf)


def _alone(field: LightField, deviations: Floats) -> NDArray[np.bool_]:
    if len(field) <= _NEIGHBOURS:
        return np.zeros(len(field), bool)
    mean = deviations.mean(axis=1)
    apart = np.abs(mean[:, None] - mean[_neighbours(field, _NEIGHBOURS)]).min(axis=1)
    return np.asarray(apart > _ALONE * np.median(apart))


def _neighbours(field: LightField, count: int) -> Ints:
    places = np.stack([field.rows, field.columns], axis=-1)
    _, near = cKDTree(places).query(places, list(range(2, count + 2)))
    return np.asarray(near)

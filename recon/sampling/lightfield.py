"""Light-field samples: radiance with the geometry that it belongs to, photo by photo."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from capture.arrays import frozen_array
from capture.lighting import cosines, seen_from
from capture.polarisation import Polariser

Floats = NDArray[np.float64]

# Cosine to a source within which its disc may be cut by the horizon: a lamp of a degree's radius.
_PENUMBRA = 0.02
# Rays along the side of a pixel from which on one of each row and column may do.
_FEW_ALONG = 4
# Rays that are worked on at once: fewer take numpy as long.
_POOL = 6000
_INTEGERS = {
    "rows": np.int64,
    "columns": np.int64,
    "ray_sample": np.int64,
    "faces": np.int64,
    "place": np.int64,
}
_BOOLEANS = {"reflected_visible": np.bool_, "sources_visible": np.bool_}
# What belongs to samples; the rest belongs to rays.
_OF_SAMPLES = ("rows", "columns", "radiance", "variance", "weight", "stands_for", "place", "lobe_share")


@dataclass(frozen=True, eq=False)
class LightField:
    """Samples of one photograph. A sample is a pixel; where the surface curves within it, several rays.

    rows, columns : (n,) int, the pixels.
    radiance, variance : (n, 3) float64, linear.
    weight : (n,) 0 to 1, how far the pixel's geometry is to be trusted: less at grazing angles and near edges.
    ray_sample : (m,) int, ascending: the sample that each ray belongs to; a sample is its rays' mean.
    positions : (m, 3) metres, in the world. normals, views : (m, 3) unit; outward, of the smooth surface, and towards
        the camera.
    reflected_visible : (m,) bool, whether the mirror direction of the view is free of the object itself.
    sources_visible : (m, k) bool, whether each source is. Both count what is below the horizon as hidden.
    faces : (m,) triangle of a mesh, and corner_weights : (m, 3) of its corners: what belongs to vertices or to a
        texture is blended by these. None of both on a sphere.
    footprints : (m, 2, 3) metres on a mesh's facet, across a ray's part of its pixel, to the right and down; zero where
        it is seen edge on. None where nobody asks what varies within.
    stands_for : (n,) what each sample counts for in sums over the surface, 1 on average: less where it was the likelier
        drawn. None where all count alike.
    place : (n,) int, of the points of the surface that photographs are compared at, the one that a sample shows. None
        where samples lie anywhere.
    lobe_share : (n,) what a polarising filter passes of the lobe's light over what it passes of the base's, by which
        radiance is divided. None without filters, where it is 1.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    radiance: Floats
    variance: Floats
    weight: Floats
    ray_sample: NDArray[np.int64]
    positions: Floats
    normals: Floats
    views: Floats
    reflected_visible: NDArray[np.bool_]
    sources_visible: NDArray[np.bool_]
    faces: NDArray[np.int64] | None = None
    corner_weights: Floats | None = None
    footprints: Floats | None = None
    stands_for: Floats | None = None
    place: NDArray[np.int64] | None = None
    lobe_share: Floats | None = None

    def __post_init__(self) -> None:
        for name in (entry.name for entry in fields(self)):
            values = getattr(self, name)
            if values is None:
                continue
            count = len(self.rows if name in _OF_SAMPLES else self.ray_sample)
            if len(values) != count:
                what = "samples" if name in _OF_SAMPLES else "rays"
                raise ValueError(f"{name} has {len(values)} entries for {count} {what}; lengths must agree")
            dtype = (_INTEGERS | _BOOLEANS).get(name, np.float64)
            object.__setattr__(self, name, frozen_array(values, dtype))

    def __len__(self) -> int:
        return len(self.rows)

    def less(self, radiance: Floats) -> LightField:
        """The same samples without a part (n, 3) of their radiance."""
        return replace(self, radiance=self.radiance - radiance)

    def through(self, polariser: Polariser | None) -> LightField:
        """The same samples, taken through a filter; as they are where there is none."""
        if polariser is None:
            return self
        return replace(self, lobe_share=np.full(len(self), polariser.lobe_share))

    def filtered(self, lobe: NDArray[Any]) -> NDArray[Any]:
        """What filters show of the lobe's light, of samples (n, ...) or of rays (m, ...)."""
        if self.lobe_share is None:
            return lobe
        share = self.lobe_share if len(lobe) == len(self) else self.lobe_share[self.ray_sample]
        return lobe * share.reshape(-1, *np.ones(lobe.ndim - 1, int)).astype(lobe.dtype)

    @property
    def shares(self) -> Floats:
        """What each sample counts for (n,), 1 on average."""
        return np.ones(len(self)) if self.stands_for is None else self.stands_for

    def mean_over_rays(
        self, values: NDArray[np.floating], factor: NDArray[np.floating] | None = None
    ) -> NDArray[np.floating]:
        """Means (n, ...) over each sample's rays of per-ray values (m, ...), times a factor (m,) of each ray's."""
        if len(values) == len(self) and factor is None:
            return values
        own, means = values.shape[1:], self.means
        if factor is not None:
            means = csr_array((means.data * factor, means.indices, means.indptr), shape=means.shape)
        found = means.astype(values.dtype, copy=False) @ values.reshape(len(values), prod(own))
        return np.asarray(found.reshape(len(self), *own))

    @cached_property
    def means(self) -> csr_array:
        """The matrix (n, m) that takes means over rays; as one, it takes a thirtieth of `np.add.reduceat`'s time."""
        counts = np.bincount(self.ray_sample, minlength=len(self))
        ends = np.concatenate([[0], np.cumsum(counts)])
        shares = 1 / counts[self.ray_sample]
        return csr_array((shares, np.arange(len(shares)), ends), shape=(len(self), len(shares)))

    def where(self, keep: NDArray[np.bool_]) -> LightField:
        """The samples marked by a mask (n,)."""
        return self._kept(keep, keep[self.ray_sample])

    def thinned(self, rays: int) -> LightField:
        """The same samples with so many rays at most, drawn from theirs."""
        order = np.lexsort((np.random.default_rng(0).random(len(self.ray_sample)), self.ray_sample))
        first = np.searchsorted(self.ray_sample, np.arange(len(self)))
        kept = np.zeros(len(order), bool)
        kept[order[np.arange(len(order)) - first[self.ray_sample] < rays]] = True
        return self._kept(np.ones(len(self), bool), kept)

    def merged(self, turn: float) -> LightField:
        """The same samples with the mean of neighbouring rays for one, where the normal turns less across their square.

        turn : radians. Of smooth bodies: rays on a mesh's faces stay as they are, and those that are no grid.
        """
        means = None if self.faces is not None else self.neighbours(turn)
        return self if means is None else self.averaged(means)

    def neighbours(self, turn: float) -> csr_array | None:
        """Weights (k, m) that take the mean of neighbouring rays, as of `merged`; None where each stays as it is."""
        counts = np.bincount(self.ray_sample, minlength=len(self))
        side = np.sqrt(counts).round().astype(np.int64)
        if (side == 1).all() or (side**2 != counts).any():
            return None
        middle = self.sample_normals
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        away = np.zeros(len(self))
        np.maximum.at(away, self.ray_sample, np.linalg.norm(self.normals - middle[self.ray_sample], axis=1))
        # The outermost rays lie half a square of theirs within the pixel's corners.
        across = np.sqrt(2) * away * side / np.maximum(side - 1, 1)
        fewer = np.minimum(2 ** np.ceil(np.log2(np.maximum(across / turn, 1))).astype(np.int64), side)
        ends = np.cumsum(fewer**2)
        which = np.arange(len(self.ray_sample)) - (np.cumsum(counts) - counts)[self.ray_sample]
        wide, narrow = side[self.ray_sample], fewer[self.ray_sample]
        place = (which // wide * narrow // wide) * narrow + which % wide * narrow // wide
        target = (ends - fewer**2)[self.ray_sample] + place
        size = np.bincount(target)
        return csr_array((1 / size[target], (target, np.arange(len(target)))), shape=(len(size), len(target)))

    def averaged(self, means: csr_array) -> LightField:
        """The same samples by means of rays as of `neighbours`, without what says where on a mesh rays are."""
        target = means.tocsc().indices
        rays = np.zeros(len(target), bool)
        rays[np.unique(target, return_index=True)[1]] = True
        bare = replace(self, faces=None, corner_weights=None, footprints=None)
        merged = bare._kept(np.ones(len(self), bool), rays)
        normals, views = means @ self.normals, means @ self.views
        return replace(
            merged,
            ray_sample=self.ray_sample[means.indices[means.indptr[:-1]]],
            positions=means @ self.positions,
            normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
            views=views / np.linalg.norm(views, axis=1, keepdims=True),
        )

    def with_few_rays(self) -> LightField:
        """The same samples of a mesh; of grids of four by four rays and more, one ray of each row and column.

        Those of smooth bodies stay as they are: `merged` makes fewer of them, and takes them for whole grids.
        """
        counts = np.bincount(self.ray_sample, minlength=len(self))
        side = np.sqrt(counts).round().astype(np.int64)
        if self.faces is None or (side < _FEW_ALONG).all() or (side**2 != counts).any():
            return self
        wide = side[self.ray_sample]
        which = np.arange(len(self.ray_sample)) - (np.cumsum(counts) - counts)[self.ray_sample]
        # Steps of two around an odd number of columns meet each once, the last of which isn't there.
        latin = which % wide == (2 * (which // wide) + 1) % (wide + 1)
        return self._kept(np.ones(len(self), bool), (wide < _FEW_ALONG) | latin)

    def _kept(self, keep: NDArray[np.bool_], rays: NDArray[np.bool_]) -> LightField:
        """Samples (n,) and rays (m,) that are marked; each kept sample keeps a ray."""
        kept: dict[str, Any] = {}
        for name in (entry.name for entry in fields(self)):
            values = getattr(self, name)
            kept[name] = None if values is None else values[keep if name in _OF_SAMPLES else rays]
        kept["ray_sample"] = (np.cumsum(keep) - 1)[kept["ray_sample"]]
        return LightField(**kept)

    @cached_property
    def ray_cosines(self) -> Floats:
        """Cosine of the exitant angle of each ray, (m,)."""
        return np.asarray((self.normals * self.views).sum(axis=1))

    @property
    def cos_exitant(self) -> Floats:
        """Cosine of the exitant angle, (n,), mean over the pixel."""
        return np.asarray(self.mean_over_rays(self.ray_cosines))

    @property
    def mirrored(self) -> Floats:
        """Mirror direction of each ray's view, (m, 3) unit."""
        return np.asarray(2 * self.ray_cosines[:, None] * self.normals - self.views)

    @property
    def sample_normals(self) -> Floats:
        """Mean normal of each sample, (n, 3), not renormalised."""
        return np.asarray(self.mean_over_rays(self.normals))


def joined(photos: Sequence[LightField]) -> LightField:
    """Samples of several photographs as those of one; rows and columns no longer identify pixels."""
    if len(photos) == 1:
        return photos[0]
    before = np.cumsum([0, *(len(photo) for photo in photos[:-1])])
    together: dict[str, Any] = {}
    for name in (entry.name for entry in fields(LightField)):
        values = [getattr(photo, name) for photo in photos]
        if name == "ray_sample":
            values = [own + first for own, first in zip(values, before, strict=True)]
        if name == "stands_for" and any(own is not None for own in values):
            # A photograph of which every pixel is taken needs none.
            values = [photo.shares for photo in photos]
        together[name] = None if values[0] is None else np.concatenate(values)
    return LightField(**together)


def blocks(field: LightField, rays: int) -> Iterator[tuple[slice, LightField]]:
    """Samples in turn, of about so many rays each, and which they are: what is made of each ray then stays small."""
    if not len(field):
        return
    last = np.cumsum(np.bincount(field.ray_sample, minlength=len(field)))
    ends = np.searchsorted(last, np.arange(rays, last[-1], rays))
    place = np.arange(len(field))
    for start, stop in pairwise(np.unique([0, *ends, len(field)]).tolist()):
        whole = stop - start == len(field)
        yield slice(start, stop), field if whole else field.where((place >= start) & (place < stop))


def pools(photos: Sequence[LightField], lightings: Sequence[Any]) -> list[list[int]]:
    """Places of photographs to work on at once, those under one lighting, by its name or number, with each other."""
    places: dict[Any, list[int]] = {}
    for k, lighting in enumerate(lightings):
        places.setdefault(lighting, []).append(k)
    found = []
    for mine in places.values():
        rays = np.cumsum([len(photos[k].ray_sample) for k in mine])
        # A pool is full with the photograph that fills it.
        pool = np.concatenate([[0], rays[:-1]]) // _POOL
        if photos[mine[0]].place is not None:
            # Samples of a place belong together.
            pool[:] = 0
        found += [
            [k for k, own in zip(mine, pool, strict=True) if own == number] for number in np.unique(pool)
        ]
    return found


def off_terminators(field: LightField, sources: Floats) -> LightField:
    """The samples in which none of the sources, (k, 3) or (k, 4), rises, sets or goes behind the object.

    There the light is neither on nor off: a source has a size, a pixel a width, and the model's highlight
    ends abruptly [RH01, eq. 23 has no shadowing term], so that dim pixels would carry large errors.
    """
    return field.where(clear_of_terminators(field, sources)) if len(sources) else field


def clear_of_terminators(field: LightField, sources: Floats) -> NDArray[np.bool_]:
    """Which samples (n,) `off_terminators` keeps."""
    cos = cosines(field.normals, seen_from(sources, field.positions)[0])
    lit_share = np.asarray(field.mean_over_rays(((cos > 0) & field.sources_visible).astype(float)))
    at_horizon = np.abs(field.mean_over_rays(cos)) < _PENUMBRA
    return np.asarray(~(((lit_share > 0) & (lit_share < 1)) | at_horizon).any(axis=1))

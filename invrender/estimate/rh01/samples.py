"""Samples as RH01's inverse lighting looks at them: rows over coefficients for the diffuse part, over a map's nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack
from scipy.sparse.linalg import splu

from capture.lighting import latlong_directions
from invrender.brdf.fresnel import normalised_fresnel
from invrender.estimate.rh01.nodes import bilinear, laplacian
from invrender.estimate.rh01.simplex import root_weight
from invrender.theory.operator import irradiance_operator
from invrender.transport.visibility import Shadows
from recon.harmonics.basis import degree_of, evaluate_harmonics
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Of a node's own equation: by which it follows its neighbours.
_SMOOTH = 1e-4


@dataclass(frozen=True, eq=False)
class Reflections:
    """Samples of a photograph.

    diffuse : (n, (l + 1)^2), rows over the light's coefficients, which yield the irradiance [eq. 21].
    mirrored : (n, P), sparse rows over a map's nodes: the light in the mirror direction, none where a mesh hides it.
    """

    field: LightField
    shadows: Shadows | None
    diffuse: Floats
    mirrored: csr_array

    @staticmethod
    def of(field: LightField, height: int, degree: int, shadows: Shadows | None = None) -> Reflections:
        """height : of the map. degree : of the coefficients. shadows : of a mesh on itself [section 6.4]."""
        diffuse = field.mean_over_rays(irradiance_operator(field.normals, degree))
        nodes, weights = bilinear(field.mirrored, height)
        if shadows is not None:
            diffuse = diffuse - shadows.hidden_rows(field, degree)
            weights = weights * field.reflected_visible[:, None]
        rays = len(field.ray_sample)
        lookup = csr_array(
            (weights.ravel(), (np.repeat(np.arange(rays), 4), nodes.ravel())), shape=(rays, 2 * height**2)
        )
        return Reflections(field, shadows, np.asarray(diffuse, float), field.means @ lookup)

    @property
    def mirrored_harmonics(self) -> Floats:
        """Rows (n, (l + 1)^2) over the light's coefficients: the light in the mirror direction, where none hides it."""
        rows = evaluate_harmonics(self.field.mirrored, degree_of(self.diffuse.shape[1]))
        if self.shadows is not None:
            rows *= self.field.reflected_visible[:, None]
        return np.asarray(self.field.mean_over_rays(rows), float)

    def fresnel(self, mu: float | None) -> Floats:
        """Fresnel's factor (n,), mean over rays."""
        cos = np.einsum("nk,nk->n", self.field.normals, self.field.views)
        return np.asarray(self.field.mean_over_rays(normalised_fresnel(mu, cos)))


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples of all photographs, and which of them the error is of.

    judged : (n,). height : of the map that the rows of `mirrored` are over.
    """

    photos: tuple[Reflections, ...]
    height: int
    judged: NDArray[np.bool_]

    @staticmethod
    def of(photos: Sequence[LightField], height: int, degree: int, shadows: Shadows | None = None) -> Samples:
        seen = tuple(Reflections.of(photo, height, degree, shadows) for photo in photos)
        return Samples(seen, height, np.ones(sum(map(len, photos)), bool))

    @cached_property
    def root(self) -> Floats:
        """Roots (n,) of the weights."""
        return np.concatenate([root_weight(one.field) for one in self.photos])

    @cached_property
    def radiance(self) -> Floats:
        return np.concatenate([one.field.radiance for one in self.photos])

    @cached_property
    def cos(self) -> Floats:
        """Cosines (n,) of the exitant angle."""
        return np.concatenate([one.field.cos_exitant for one in self.photos])

    @cached_property
    def diffuse(self) -> Floats:
        return np.concatenate([one.diffuse for one in self.photos])

    @cached_property
    def mirrored(self) -> csr_array:
        return csr_array(vstack([one.mirrored for one in self.photos]))

    @cached_property
    def mirrored_harmonics(self) -> Floats:
        return np.concatenate([one.mirrored_harmonics for one in self.photos])

    def fresnel(self, mu: float | None) -> Floats:
        return np.concatenate([one.fresnel(mu) for one in self.photos])

    def mirror_map(
        self, known: Floats, mu: float | None, likeness: Floats | None = None, smooth: float = _SMOOTH
    ) -> Floats:
        """The maps (P, k) whose light in the mirror direction, times Fresnel's factor, is known (n, k): least squares.

        likeness : (n,), by which samples count besides their weights. smooth : weight of differences between
        neighbours, over the mean of a node's own; nodes that no reflection reaches follow their neighbours.
        """
        root = self.root if likeness is None else self.root * np.sqrt(likeness)
        rows = csr_array(self.mirrored.multiply((root * self.fresnel(mu))[:, None]))
        gram = rows.T @ rows
        held = smooth * gram.trace() / gram.shape[0] * laplacian(self.height)
        # The ordering for symmetric matrices leaves a third of the default one's fill.
        factors = splu((gram + held).tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return np.asarray(factors.solve(rows.T @ (root[:, None] * known)))

    def looking_outside(self, region: NDArray[np.bool_], margin: float) -> NDArray[np.bool_]:
        """Which samples (n,) mirror no node within margin, radians, of a region (H, 2H) of the map."""
        grid = latlong_directions(self.height).reshape(-1, 3)
        nearest = (grid @ grid[region.ravel()].T).max(axis=1, initial=-1.0)
        # Rounding leaves a node's own cosine a little under 1.
        near = region.ravel() | (nearest >= np.cos(margin))
        return np.asarray(self.mirrored @ near.astype(float) == 0)

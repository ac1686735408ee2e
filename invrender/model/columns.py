"""The reflected light field as linear columns per photograph, whatever mu and sigma turn out to be.

[RH01, eq. 24] for one channel and one photograph is

    B = sum_e x_e ( Kd d_e + Ks sum_kj a_k(mu) c_j(sigma) m_ekj )

with lighting elements e of strength x_e, diffuse transfers d_e and specular transfers m_ekj that hold
neither mu nor sigma: Fresnel's factor is a short sum in k, the lobe is interpolated between nodes j.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from invrender.model.fresnel import FresnelBasis
from invrender.model.microfacet import sigma_nodes, sigma_weights
from invrender.model.transfer import LightElement, specular_transfer
from invrender.model.visibility import Shadows, seen_diffuse, seen_specular
from recon.lightfield import LightField

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PhotoColumns:
    """The columns of one photograph's samples.

    lighting : name of its lighting. elements : names of the lighting's elements.
    columns : (channels, n, elements, 1 + rank * nodes) float32; channels is 1 where all share them.
        The first of the last axis is d, then m with j fastest.
    field : the samples.
    """

    lighting: str
    elements: tuple[str, ...]
    columns: NDArray[np.float32]
    field: LightField

    @property
    def radiance(self) -> Floats:
        return self.field.radiance


@lru_cache(maxsize=1)
def fresnel_basis() -> FresnelBasis:
    """The one basis that columns and weights share."""
    return FresnelBasis()


def photo_columns(
    lighting: str, elements: Sequence[LightElement], field: LightField, shadows: Shadows | None = None
) -> PhotoColumns:
    """Columns of a photograph's samples under a lighting given by its elements; shadows : of a mesh, if it has any."""
    basis, nodes = fresnel_basis(), sigma_nodes()
    cos = (field.normals * field.views).sum(axis=1)
    fresnel = basis.functions(cos).astype(np.float32)
    channels = max(element.channels for element in elements)
    columns = np.empty((channels, len(field), len(elements), 1 + basis.rank * len(nodes)), np.float32)
    for e, element in enumerate(elements):
        sight = None if shadows is None else shadows.sight(element, field)
        diffuse = field.mean_over_rays(seen_diffuse(element, field.normals, sight))
        columns[:, :, e, 0] = diffuse.T
        specular = seen_specular(
            element,
            sight,
            lambda part, rays: specular_transfer(part, field.normals[rays], field.views[rays], nodes),
        ).astype(np.float32)
        for k in range(basis.rank):
            product = field.mean_over_rays(specular * fresnel[:, k, None, None])
            first = 1 + k * len(nodes)
            columns[:, :, e, first : first + len(nodes)] = product.transpose(2, 0, 1)
    return PhotoColumns(lighting, tuple(element.name for element in elements), columns, field)


def specular_weights(mu: float | None, sigma: float) -> Floats:
    """a_k(mu) c_j(sigma) in the columns' order, (rank * nodes,)."""
    return np.outer(fresnel_basis().coefficients(mu), sigma_weights(sigma)).ravel()

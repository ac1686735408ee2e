"""What visibility does to transfer: a mesh keeps light from itself [RH01, section 6.4].

Three parts of the reflected light field, three rules:

- light of a directional source, diffuse and specular, counts where the ray towards it is free;
- the irradiance from all else is that of the clear sky at the normal, less what the mesh hides of it: its shadow, known
  per vertex and degree (`recon.transfer`) and blended between vertices. What varies with the normal is thus exact at
  each ray, and only the shadow is interpolated;
- the lobe's integral over all else counts where the mirrored ray is free. RH01's approximation takes one ray for the
  whole lobe: it is weak where an edge stands in part of the lobe, within about 2 sigma of the mirrored direction, and
  there the light is either all counted or not at all.

What hides light counts as black: light from one part of the object to another is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.model.transfer import LightElement, diffuse_transfer, specular_transfer
from recon.bodies import MeshBody, blended
from recon.harmonics import clamped_cosine_transfer, evaluate_harmonics, to_degree
from recon.lightfield import LightField
from recon.transfer import TransferVectors

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Shadows:
    """A mesh in the world, and what it hides of the sky.

    body : the mesh. shadow : (v, (l + 1)^2) per vertex, transfer of each harmonic without the mesh less that with it.
    """

    body: MeshBody
    shadow: NDArray[np.float32]

    @classmethod
    def of(cls, body: MeshBody, transfer: TransferVectors) -> Shadows:
        """The shadows of a mesh whose transfer vectors, in the world's axes, are known."""
        l_max = transfer.l_max
        per_degree = np.repeat(clamped_cosine_transfer(l_max), 2 * np.arange(l_max + 1) + 1)
        clear = per_degree * evaluate_harmonics(body.mesh.normals, l_max)
        return cls(body, (clear - transfer.coefficients).astype(np.float32))

    def sight(self, element: LightElement, field: LightField) -> Sight:
        """What the rays of a photograph's samples see of an element's light."""
        assert field.faces is not None
        assert field.corner_weights is not None
        facets = self.body.facets[field.faces]
        sources = np.zeros((len(field.faces), len(element.directions)), bool)
        for k, direction in enumerate(element.directions):
            towards = np.broadcast_to(direction, facets.shape)
            sources[:, k] = self.body.visible(field.positions, facets, towards)
        hidden = None
        coefficients = _sky(element, round(np.sqrt(self.shadow.shape[1])) - 1)
        if coefficients is not None:
            at_vertices = self.shadow @ coefficients.astype(np.float32)
            corners = self.body.mesh.faces[field.faces]
            hidden = blended(at_vertices, corners, field.corner_weights)
        return Sight(sources, field.reflected_visible, hidden)


@dataclass(frozen=True, eq=False)
class Sight:
    """What m rays see of an element's light.

    sources : (m, k), whether each of its directional sources. mirrored : (m,), whether the mirror direction of the view
    is free. hidden : (m, channels), irradiance that the mesh keeps off, of all but the sources; None without such light.
    """

    sources: Mask
    mirrored: Mask
    hidden: Floats | None


def seen_diffuse(element: LightElement, normals: Floats, sight: Sight | None) -> Floats:
    """`diffuse_transfer` under visibility, (m, channels); sight : None where nothing is hidden."""
    if sight is None:
        return diffuse_transfer(element, normals)
    cos = np.maximum(normals @ element.directions.T, 0) * sight.sources
    total = cos @ element.irradiances
    if sight.hidden is not None:
        # Below zero only by rounding, and by harmonics that end at some degree.
        total += np.maximum(diffuse_transfer(element.without_sources, normals) - sight.hidden, 0)
    return np.asarray(total)


def seen_specular(
    element: LightElement, normals: Floats, views: Floats, sigmas: Floats, sight: Sight | None
) -> Floats:
    """`specular_transfer` under visibility, (m, sigmas, channels); sight : None where nothing is hidden."""
    if sight is None:
        return specular_transfer(element, normals, views, sigmas)
    total = np.zeros((len(normals), len(np.atleast_1d(sigmas)), element.channels))
    if sight.hidden is not None:
        rays = np.flatnonzero(sight.mirrored)
        total[rays] = specular_transfer(element.without_sources, normals[rays], views[rays], sigmas)
    for k, visible in enumerate(sight.sources.T):
        rays = np.flatnonzero(visible)
        source = _source(element, k)
        total[rays] += specular_transfer(source, normals[rays], views[rays], sigmas)
    return total


def _sky(element: LightElement, l_max: int) -> Floats | None:
    """Harmonic coefficients ((l_max + 1)^2, channels) of all of an element's light but its sources; None if none."""
    if element.diffuse_coefficients is None and not element.uniform:
        return None
    result = np.zeros(((l_max + 1) ** 2, element.channels))
    if element.diffuse_coefficients is not None:
        result += to_degree(element.diffuse_coefficients, l_max)
    result[0] += np.sqrt(4 * np.pi) * element.uniform
    return result


def _source(element: LightElement, k: int) -> LightElement:
    one = slice(k, k + 1)
    return LightElement(element.name, element.directions[one], element.irradiances[one])

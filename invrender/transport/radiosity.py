"""Light that bounces between the parts of a mesh, as matte surfaces of the BRDF's albedo send it [Goral et al. 1984].

    E = D + G L,    L = (a / pi) E

with the irradiance D of the vertices by the lighting itself, the exchange G (`recon.mesh.exchange`), and the albedo a
of the whole BRDF under light from all around: what leaves the surface counts as the same in all directions, so that
highlights that light other parts are spread out, and an interface lets all of it in alike. Towards the camera the matte
part reflects the irradiance G L, and the lobe the radiance of the one point that the mirrored ray meets, as it sees the
lighting where that ray is free (`visibility`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from invrender.brdf.microfacet import Microfacet
from invrender.transport.diffuse_base import base_irradiance, interface_transmittance
from invrender.transport.form_transfer import OneIndex, form_transfer
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Shadows
from recon.mesh.bodies import MeshBody
from recon.mesh.exchange import face_exchange
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

_UNIFORM = LightElement("uniform", np.zeros((0, 3)), np.zeros((0, 1)), uniform=1.0)
# Cosines of views by which the albedo is averaged.
_VIEWS = 64
# No surface sends back more than it receives; and what further reflections would add below this share is left out.
BRIGHTEST, _NEGLIGIBLE, _MOST = 0.99, 1e-5, 100
# Steradian; of shadows in single precision, turned into the world. One ray that is met weighs a hundred times as much.
_ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class ConcaveMesh:
    """A mesh that sees itself. exchange : (v, f), steradian, as `face_exchange` has it."""

    shadows: Shadows
    exchange: csr_array

    @classmethod
    def of(cls, shadows: Shadows) -> ConcaveMesh | None:
        """The parts of a mesh; None of a convex one, at no cost."""
        concave = np.abs(shadows.shadow).max(axis=1) > _ROUNDING
        if not concave.any():
            return None
        exchange = face_exchange(shadows.body, concave)
        return cls(shadows, exchange) if exchange.nnz else None

    @property
    def body(self) -> MeshBody:
        return self.shadows.body

    def bounced(
        self,
        elements: Sequence[LightElement],
        strengths: Floats,
        brdf: Microfacet,
        share: Floats | None = None,
    ) -> Bounced:
        """What bounces under a lighting.

        strengths : (elements, 3). brdf : its kd and ks may be each face's, (f, 3). share : (3,), albedo of a BRDF that
        is known up to a scale; None for the BRDF's own.
        """
        mesh = self.body.mesh
        direct = np.zeros((len(mesh.vertices), 3))
        for element, strength in zip(elements, strengths, strict=True):
            visible = self.shadows.of_vertices(element)
            here = element.at(mesh.vertices)
            direct += strength * base_irradiance(brdf.form, brdf.mu, here, mesh.normals, visible)
        return self.exchanged(direct, albedo(brdf) if share is None else share)

    def exchanged(self, direct: Floats, albedo: Floats) -> Bounced:
        """What bounces where light itself sends vertices an irradiance (v, 3); albedo : (3,) or each face's (f, 3)."""
        # A recovered strength may be negative; light isn't.
        direct = np.maximum(direct, 0)
        share = np.minimum(albedo, BRIGHTEST) / np.pi
        mesh = self.body.mesh
        exchanged, sent = np.zeros_like(direct), np.zeros((len(mesh.faces), 3))
        for _ in range(_MOST):
            sent = share * (direct + exchanged)[mesh.faces].mean(axis=1)
            before, exchanged = exchanged, self.exchange @ sent
            if np.abs(exchanged - before).max() <= _NEGLIGIBLE * direct.max():
                break
        return Bounced(self.shadows, exchanged, sent)


@dataclass(frozen=True, eq=False)
class Bounced:
    """What parts of a mesh send each other under a lighting.

    irradiance : (v, 3) of vertices by the mesh. sent : (f, 3), radiance of faces by all light.
    """

    shadows: Shadows
    irradiance: Floats
    sent: Floats

    def radiance(self, field: LightField, brdf: Microfacet) -> Floats:
        """Radiance (n, 3) of samples by light that other parts sent; kd and ks may be those of each ray, (m, 3)."""
        diffuse, specular = self.reflected(field, brdf)
        return np.asarray(field.mean_over_rays(brdf.kd * diffuse + brdf.ks * specular))

    def reflected(self, field: LightField, brdf: Microfacet) -> tuple[Floats, Floats]:
        """What rays (m, 3) reflect of it per unit of Kd, and of Ks: zero where `brdf` has no specular part."""
        cos = np.clip(field.ray_cosines, 0, 1)
        diffuse = (
            self.shadows.at_rays(self.irradiance, field)
            * interface_transmittance(brdf.form, brdf.mu, cos)[:, None]
        )
        specular = np.zeros_like(diffuse)
        if brdf.sigma is not None and brdf.ks.any():
            blocked = np.flatnonzero(~field.reflected_visible)
            specular[blocked] = self._mirrored(field, blocked, brdf)
        return diffuse, specular

    def _mirrored(self, field: LightField, rays: NDArray[np.int64], brdf: Microfacet) -> Floats:
        """What the lobe gathers per unit of Ks (r, 3), along mirrored rays that aren't free."""
        assert field.faces is not None
        normals, views = field.normals[rays], field.views[rays]
        body = self.shadows.body
        towards = 2 * (normals * views).sum(axis=1)[:, None] * normals - views
        met = body.tracer.first_hits(field.positions[rays], towards, body.facets[field.faces[rays]]).faces
        front = (met >= 0) & ((body.facets[met] * towards).sum(axis=1) < 0)
        return np.where(front[:, None], self.sent[met], 0) * _lobe_albedo(brdf, normals, views)[:, None]


def albedo(brdf: Microfacet) -> Floats:
    """Share, as of kd and ks, reflected of light from all around; more than 1 for BRDFs that aren't physical."""
    total = np.pi * brdf.kd
    if brdf.sigma is None:
        return total
    cos = np.sqrt((np.arange(_VIEWS) + 0.5) / _VIEWS)
    views = np.stack([np.sqrt(1 - cos**2), np.zeros_like(cos), cos], axis=-1)
    normals = np.broadcast_to([0.0, 0.0, 1.0], views.shape)
    return np.asarray(total + brdf.ks * _lobe_albedo(brdf, normals, views).mean())


def _lobe_albedo(brdf: Microfacet, normals: Floats, views: Floats) -> Floats:
    """What the lobe sends of uniform unit radiance, (m,), per unit of Ks."""
    assert brdf.sigma is not None
    sigma, fresnel = np.array([brdf.sigma]), OneIndex(brdf.mu)
    return np.asarray(form_transfer(brdf.form, _UNIFORM, normals, views, sigma, fresnel)[:, 0, 0, 0], float)

"""What planned photographs show, and its Jacobian, both from a fit's own columns and rows at the scene's truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.jacobian import jacobians
from invrender.estimate.unknown_light.lamp_frame import LampFrame
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.rows import rows_of, slopes_of
from invrender.estimate.unknown_light.state import BlindState
from invrender.plan.experiment import PlannedLight
from invrender.plan.unknowns import Unknowns
from invrender.transport.column_basis import around
from invrender.transport.columns import PhotoColumns, all_columns, photo_columns
from invrender.transport.predict import predict, predict_columns
from invrender.transport.transfer import LightElement, light_elements
from invrender.transport.visibility import Shadows
from recon.mesh.bodies import Body, MeshBody
from recon.mesh.transfer import transfer_vectors
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Rays per vertex that look for shadows of the sky: what is planned needs no more.
_RAYS = 96
# Name of the one lighting whose strength an estimate gives.
_LIGHT = "light"


@dataclass(frozen=True, eq=False)
class ShownSamples:
    """What samples show, (n, 3), and the Jacobian: over their lighting (3, n, p), and over what all share (3, n, t)."""

    radiance: Floats
    lit: Floats
    shared: Floats

    def where(self, keep: NDArray[np.bool_]) -> ShownSamples:
        """The samples marked by a mask (n,)."""
        return ShownSamples(self.radiance[keep], self.lit[:, keep], self.shared[:, keep])

    def under_more(self, further: ShownSamples) -> ShownSamples:
        """The same samples with what they show of further, known light."""
        return replace(self, radiance=self.radiance + further.radiance, shared=self.shared + further.shared)


class PlannedObject:
    """An object of known BRDF under lights.

    shadows : of a mesh, up to the degree of unknown light and not below 8; None of a sphere. frame : that near sources'
    closeness counts in.
    """

    def __init__(self, body: Body, lights: Sequence[PlannedLight], unknowns: Unknowns, degree: int) -> None:
        self.unknowns = unknowns
        self.brdf = unknowns.estimate.brdf
        self.lights = tuple(lights)
        self.frame = LampFrame(body.centre, body.size / 2)
        self.degree = degree
        self.elements = [
            light_elements(replace(light.lighting, recover_irradiance=False, recover_ambient=False))
            for light in lights
        ]
        self.shadows: Shadows | None = None
        if isinstance(body, MeshBody):
            self.shadows = Shadows.of(body, transfer_vectors(body.mesh, max(degree, 8), _RAYS))

    def radiance(self, light: int, field: LightField) -> Floats:
        """Radiance (n, 3) of samples."""
        return predict(self.brdf, self.elements[light], np.ones((1, 3)), field, self.shadows)

    def shown(self, light: int, fields: Sequence[LightField]) -> Iterator[ShownSamples]:
        """What photographs under one of the lights show, one after the other."""
        names, elements = [_LIGHT] * len(fields), {_LIGHT: self.elements[light]}
        basis = around(self.brdf.mu, self.brdf.sigma)
        for photo in all_columns(names, elements, fields, shadows=self.shadows, basis=basis):
            seen = self._over_brdf(photo, np.ones((1, 3)))
            own = self.unknowns.lights[light]
            if own.size:
                lit, turned = self._over_light(light, photo.field)
                seen.shared[:, :, own.moves] = turned
                seen = replace(seen, lit=lit)
            yield seen

    def under_lamp(self, direction: Floats, irradiance: Floats, field: LightField) -> ShownSamples:
        """What samples show of a known lamp alone: direction (3,) unit, irradiance (3,)."""
        lamp = LightElement("lamp", direction[None], np.ones((1, 1)))
        basis = around(self.brdf.mu, self.brdf.sigma)
        photo = photo_columns(_LIGHT, (lamp,), field, shadows=self.shadows, basis=basis)
        return self._over_brdf(photo, irradiance[None])

    def _over_brdf(self, photo: PhotoColumns, strengths: Floats) -> ShownSamples:
        """Radiance and Jacobian over the BRDF's numbers, under the true light: elements times strengths (1, 3)."""
        unknowns, count = self.unknowns, len(photo.field)
        shared = np.zeros((3, count, len(unknowns.std)))
        truth = replace(unknowns.estimate, strengths={_LIGHT: strengths})
        by_brdf = np.stack(jacobians(photo, unknowns.brdf, truth))
        shared[:, :, : by_brdf.shape[2]] = by_brdf
        radiance = predict_columns(photo, self.brdf, strengths)
        return ShownSamples(radiance, np.zeros((3, count, 0)), shared)

    def _over_light(self, light: int, field: LightField) -> tuple[Floats, Floats]:
        """Jacobian over the numbers of an unknown lighting (3, n, p), and over its sources' moves (3, n, 2 k + near).

        Rows are those of the gauge Kd + Ks = 1: light counts for as many times as much as this is.
        """
        lighting, brdf = self.lights[light].lighting, self.brdf
        gauge = np.maximum(brdf.kd + brdf.ks, 1e-300)
        owners = np.zeros(len(lighting.directions), int)
        closeness = None if lighting.closeness is None else self.frame.radius * lighting.closeness
        state = BlindState(
            brdf.ks / gauge, brdf.mu, brdf.sigma, lighting.directions, owners=owners, closeness=closeness
        )
        design = LightingDesign.of([field], self.degree, shadows=self.shadows, settled=True, frame=self.frame)
        rows = rows_of(design, state, self.degree)
        lit = np.stack(
            [of * rows.of_channel(share) for of, share in zip(gauge, state.specular_share, strict=True)]
        )
        # Slopes in mu and sigma are the columns', under all degrees of the light: the sources are asked for alone.
        sent = np.zeros((lit.shape[2], 3))
        sent[lit.shape[2] - len(owners) :] = gauge * lighting.irradiances
        slopes = slopes_of(design, state, rows, sent)
        return lit, slopes[:, :, slopes.shape[2] - state.numbers_of_sources :].transpose(1, 0, 2)

"""Samples that a single source lights: what they received, and what a lobe sends back from them.

A source at a distance D from the object's centre c lights a point p from D d - (p - c), with an irradiance that falls
off as the square of that distance; D's inverse, the closeness, is 0 of a source that counts as infinitely far away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, csr_array

from capture.lighting import cosines, seen_from
from invrender.brdf.fresnel import normalised_fresnel
from invrender.inverse_brdf.halfangles import HalfAngles, half_angles
from invrender.theory.specialcases import lobe
from recon.sampling.lightfield import LightField, off_terminators

Floats = NDArray[np.float64]

# Light more grazing than this share of the source's irradiance carries little information and divides by almost
# nothing.
_MIN_COS_INCIDENT = 0.05


@dataclass(frozen=True, eq=False)
class Source:
    """A photograph's only source, as the object's centre sees it.

    direction : (3,) unit, towards it. irradiance : (3,), > 0, on a plane there that faces it.
    """

    direction: Floats
    irradiance: Floats

    def at(self, centre: Floats, closeness: float) -> Floats:
        """The source (1, 4) as `seen_from` has it, so close (1/m) to the object's centre (3,)."""
        return np.append(self.direction + closeness * centre, closeness)[None]


@dataclass(frozen=True, eq=False)
class LitSamples:
    """n lit samples of m rays, a sample being its rays' mean.

    angles : (n,) each. radiance, irradiance : (n, 3), the latter of the source at the object's centre. received : (n,),
    of that share, what the surface receives. geometry : (n, 3), means of cos theta_i, 1 / cos theta_o and theta_h.
    weight : (n,). means : (n, m), takes means over rays. theta_h, cos_exitant, falloff : (m,), of the rays.
    """

    angles: HalfAngles
    radiance: Floats
    irradiance: Floats
    received: Floats
    geometry: Floats
    weight: Floats
    means: csr_array
    theta_h: Floats
    cos_exitant: Floats
    falloff: Floats

    def __len__(self) -> int:
        return len(self.weight)

    def lobes(self, mu: float | None, sigma: float) -> Floats:
        """Radiance (n,) per unit of Ks and irradiance, F(mu, theta_o) S(theta_h) / (4 cos theta_o) [RH01, sec. 5.2]."""
        facing = normalised_fresnel(mu, self.cos_exitant) * lobe(self.theta_h, sigma) / (4 * self.cos_exitant)
        return np.asarray(self.means @ (self.falloff * facing))


def lit_fields(
    fields: Sequence[LightField], sources: Sequence[Source], centre: Floats, closeness: float = 0.0
) -> list[LightField]:
    """Of each photograph the samples that its source lights, none at a terminator; the rest as of `lit_samples`."""
    lit = []
    for field, source in zip(fields, sources, strict=True):
        place = source.at(centre, closeness)
        cos = cosines(field.normals, seen_from(place, field.positions)[0])[:, 0]
        above = np.asarray(field.mean_over_rays(cos)) > _MIN_COS_INCIDENT
        lit.append(off_terminators(field.where(above & (field.weight > 0)), place))
    return lit


def lit_samples(
    fields: Sequence[LightField], sources: Sequence[Source], centre: Floats, closeness: float = 0.0
) -> LitSamples:
    """The samples of `lit_fields` under their sources, all so close (1/m) to the object's centre (3,)."""
    parts = [
        _of_photo(field, source, centre, closeness)
        for field, source in zip(fields, sources, strict=True)
        if len(field)
    ]
    if not parts:
        raise ValueError(
            "no sample is lit by its source: directions point from the object to the light; check them"
        )

    def joined(name: str) -> Floats:
        return np.concatenate([getattr(part, name) for part in parts])

    return LitSamples(
        angles=HalfAngles(*(np.concatenate([part.angles[k] for part in parts]) for k in range(3))),
        means=csr_array(block_diag([part.means for part in parts], format="csr")),
        **{
            name: joined(name)
            for name in (
                "radiance",
                "irradiance",
                "received",
                "geometry",
                "weight",
                "theta_h",
                "cos_exitant",
                "falloff",
            )
        },
    )


def _of_photo(field: LightField, source: Source, centre: Floats, closeness: float) -> LitSamples:
    towards, factors = seen_from(source.at(centre, closeness), field.positions)
    incident, falloff = towards[:, 0], factors[:, 0]
    angles = half_angles(field.normals, incident, field.views)
    cos_exitant = field.ray_cosines
    cos_incident = np.maximum((field.normals * incident).sum(axis=1), 0)
    # Across a grazing pixel light and view turn; the surface receives the mean, and radiance goes with 1 / cos theta_o.
    rays = np.column_stack([cos_incident, 1 / cos_exitant, angles.theta_h])
    means = field.means
    return LitSamples(
        angles=HalfAngles(*(means @ angle for angle in angles)),
        radiance=field.radiance,
        irradiance=np.broadcast_to(source.irradiance, field.radiance.shape),
        received=means @ (cos_incident * falloff),
        geometry=means @ rays,
        weight=field.weight,
        means=means,
        theta_h=angles.theta_h,
        cos_exitant=cos_exitant,
        falloff=falloff,
    )

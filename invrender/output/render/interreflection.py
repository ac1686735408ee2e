"""Light that the parts of what is rendered send each other, under light that may turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.output.render.subject import Subject
from invrender.result.reflectance import Reflectance
from invrender.transport.radiosity import Bounced, ConcaveMesh
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Shadows

Floats = NDArray[np.float64]


def bounces_of(
    subject: Subject, reflectance: Reflectance, albedo: Floats | None = None
) -> Callable[[LightElement], Bounced | None]:
    """What bounces under an element of known strength, the last one's kept; nothing on a body that doesn't see itself.

    albedo : (3,), of a reflectance that is known up to a scale; None of one that is absolute. Where the photographs
    left Kd and Ks open, their means are taken: what is there sends light, too.
    """
    parts = None if subject.shadows is None else _concave(subject.shadows)
    if parts is None:
        return lambda element: None
    brdf = reflectance.brdf
    if reflectance.textures is not None:
        reflectances = subject.face_reflectance(reflectance.textures)
        known = reflectances.known[:, None]
        brdf = replace(
            brdf, kd=np.where(known, reflectances.kd, brdf.kd), ks=np.where(known, reflectances.ks, brdf.ks)
        )

    return lru_cache(maxsize=1)(partial(_under, parts, brdf, albedo))


@lru_cache(maxsize=1)
def _concave(shadows: Shadows) -> ConcaveMesh | None:
    """The parts of a mesh that see each other, which no light changes; the last mesh's are kept."""
    return ConcaveMesh.of(shadows)


def _under(parts: ConcaveMesh, brdf: Microfacet, albedo: Floats | None, element: LightElement) -> Bounced:
    return parts.bounced([element], np.ones((1, 3)), brdf, albedo)

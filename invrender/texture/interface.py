"""What a diffuse base under a smooth interface would make of mu and sigma of a textured object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.solve.interface import NOTABLE, ROUNDS, USUAL_MU
from invrender.texture.search import TexturedModel, cost_at, search_point
from invrender.texture.stack import Stack

Floats = NDArray[np.float64]


def behind_interface(model: TexturedModel, stack: Stack, point: Floats) -> Floats | None:
    """log sigma and log(mu - 1) were the base under an interface, as of plastic; None if that explains no more.

    As `interface.under_interface` has it of one BRDF: what an interface keeps of grazing light may hide the lobe's
    Fresnel factor, too.
    """
    if not model.specular or not model.form.has_fresnel:
        return None
    richer = replace(model, fresnel=True)
    usual = np.append(point[:1], np.log(USUAL_MU - 1))
    plain = point if model.fresnel else search_point(richer, stack, usual)
    # A base that darkens towards grazing may have driven mu far off.
    found = min((_agreed(richer, stack, start) for start in (plain, usual)), key=lambda answer: answer[1])
    return found[0] if NOTABLE * found[1] < cost_at(richer, stack, plain) else None


def _agreed(model: TexturedModel, stack: Stack, found: Floats) -> tuple[Floats, float]:
    """Where base and lobe come to one mu, from somewhere near, and the cost there."""
    cost = np.inf
    for _ in range(ROUNDS):
        behind = stack.behind_interface(1 + float(np.exp(found[1])))
        found = search_point(model, behind, found)
        cost = cost_at(model, behind, found)
    return found, cost

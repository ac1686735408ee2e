"""A rough dielectric under light that grows softer: photographs as they are, and as many through polarising filters."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.atlas.stage import AREA, Finding, Stage, expected, fitted
from benchmarks.atlas.sweep import Boundary
from synthetic.lights.arealight import AreaLight
from synthetic.materials.microfacet import MicrofacetMaterial

_ROUGH = MicrofacetMaterial(np.full(3, 0.2), np.full(3, 0.03), mu=1.5, sigma=0.3)
# Few samples of much noise, where what light hides counts.
_SAMPLES, _NOISE = 400, 0.05


def soft_stage(width_deg: float, polarised: bool) -> Stage:
    """The dielectric in known light of a width."""
    light = AreaLight(AREA.axis, AREA.radiance, float(np.radians(width_deg)))
    return Stage(_ROUGH, (light,), (), True, samples=_SAMPLES, relative=_NOISE, polarised=polarised)


def soft_draw(width_deg: float, number: int, polarised: bool = False) -> dict[str, Finding]:
    stage = soft_stage(width_deg, polarised)
    return fitted(stage, stage.drawn(number))


def soft_theory(width_deg: float, polarised: bool = False) -> dict[str, Finding]:
    return expected(soft_stage(width_deg, polarised))


SOFT = Boundary(
    "soft-light",
    "A rough dielectric in soft, known light, without filters",
    "width of the light [degrees]",
    (15.0, 30.0, 60.0, 90.0, 120.0),
    (0, 4),
    soft_draw,
    soft_theory,
    "The softer the light, the more the lobe looks like the base.",
)
PAIRS = replace(
    SOFT,
    name="soft-light-filters",
    title="The same, as many photographs, half of them through crossed filters",
    draw=partial(soft_draw, polarised=True),
    theory=partial(soft_theory, polarised=True),
    says="Crossed filters take the lobe away, so that its share shows in any light.",
)

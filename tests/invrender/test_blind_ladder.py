"""How far the ladder of models climbs under unknown light."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from invrender.estimate.unknown_light import factorize_blind
from synthetic.lights.arealight import AreaLight
from synthetic.render.lobes import reflected_radiance

from .test_blind import TEFLON, noisy


@pytest.mark.parametrize(("width_rad", "degree", "highest"), [(0.25, 12, 16), (0.5, 6, 12)])
def test_finer_light_is_tried_as_long_as_photographs_ask_for_it(
    bench: SimpleNamespace, few_forms: None, width_rad: float, degree: int, highest: int
):
    # Windows whose light ends at degree 2 / width or so.
    windows = [
        AreaLight(bench.direction(*way), np.array([1.5, 1.6, 1.8]), width_rad)
        for way in ((110, 40), (20, 60))
    ]
    photos = []
    for angle in (0, 80, 160, 240):
        field = bench.sphere_field(angle, 250, 90.0)
        radiance = reflected_radiance(TEFLON, windows, [], field.normals, field.views)
        photos.append(replace(field, radiance=field.mean_over_rays(radiance)))
    found = factorize_blind(noisy(photos, np.random.default_rng(1)), orders=[6, 12, 16])
    assert found.model.startswith(f"microfacet, lighting of degree {degree}, ")
    assert max(candidate.fit.l_max for candidate in found.candidates) == highest
    mu = found.quantities["mu"]
    # 0.009 is what noise does; degree 6 alone states 1.92 ± 0.23 of the narrow ones.
    assert abs(mu.value[0] - TEFLON.mu) < 3 * mu.std[0] < 0.036

"""How far the ladder of models climbs under unknown light."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from capture.progress import unwatched
from invrender.brdf.lobes import GGX_FORM
from invrender.brdf.richer import extended
from invrender.estimate.unknown_light import factorize_blind
from invrender.estimate.unknown_light.cross_validation import BlindCandidate, cross_validate, simplest
from invrender.estimate.unknown_light.ladder import climb, model_name
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import BlindFit, light_scale
from invrender.estimate.unknown_light.start import NOTHING, Search
from synthetic.lights.arealight import AreaLight
from synthetic.render.lobes import reflected_radiance

from .test_blind import TEFLON, noisy, share


@pytest.mark.parametrize(
    ("width_rad", "degree", "highest"), [pytest.param(0.25, 12, 16, marks=pytest.mark.sweep), (0.5, 6, 12)]
)
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


def test_a_lobe_with_more_numbers_must_be_clearly_better() -> None:
    # The scatter between photographs is 1; the difference is the same in each but for 0.01.
    scatter, unequal = np.array([1.0, 2.0, 3.0, 4.0]), 0.01 * np.array([1, -1, 1, -1])
    hazy = next(iter(extended(GGX_FORM)))

    def candidates(better_by: float) -> list[BlindCandidate]:
        plain = SimpleNamespace(parameters=5, state=SimpleNamespace(form=GGX_FORM))
        richer = SimpleNamespace(parameters=7, state=SimpleNamespace(form=hazy))
        losses = (scatter + better_by + unequal, scatter)
        return [
            BlindCandidate("", cast(BlindFit, fit), scatter, loss)
            for fit, loss in zip((plain, richer), losses, strict=True)
        ]

    # The standard error of the best's own mean is 0.65, that of the paired difference 0.006.
    assert [simplest(candidates(by)) for by in (0.01, 0.5, 0.8)] == [0, 0, 1]
    # Where only such a one is left, it is taken.
    assert simplest(candidates(0.8)[1:]) == 0


def test_other_forms_keep_no_source_that_the_chosen_one_does_without(bench: SimpleNamespace) -> None:
    """A source stood for what RH01's form lacks; it stayed with all forms but the chosen one, at next to no light."""
    photos = []
    for angle in (0, 80, 160, 240):
        field = bench.sphere_field(angle, 250, 90.0)
        radiance = reflected_radiance(TEFLON, [bench.area_light], [], field.normals, field.views)
        photos.append(replace(field, radiance=field.mean_over_rays(radiance)))
    designs = [LightingDesign.of(noisy(photos, np.random.default_rng(1)), 4)]
    weights = [1 / (0.01 * design.radiance) ** 2 for design in designs]
    search = Search(designs, weights, [np.ones_like(weight) for weight in weights], light_scale(designs))
    found = search.fit(replace(NOTHING, specular_share=share(TEFLON), mu=TEFLON.mu, sigma=TEFLON.sigma), 4)
    first = cross_validate(model_name(found), search, found)
    other = found.state.with_form(GGX_FORM).with_source(bench.direction(20, 60))
    candidates = climb(search, search, None, first, [4], [other], unwatched)
    assert [own.name for own in candidates if own.name.startswith("GGX")] == [
        "GGX, lighting of degree 4, 0 sources"
    ]

"""Lobes of any form as filters of light: against RH01's table, the reflection integral and the renderer's materials."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.brdf.form import LobeForm
from invrender.brdf.fresnel import normalised_fresnel
from invrender.brdf.lobes import BECKMANN, GGX_FORM, PHONG, RH01_FORM
from invrender.brdf.phong import phong_exponent
from invrender.theory.operator import view_frames
from invrender.transport.form_table import form_radiance, form_rows
from invrender.transport.lobe_table import specular_rows
from recon.harmonics.basis import evaluate_harmonics, sphere_directions
from recon.sampling.draw import MIN_COS_EXITANT
from synthetic.materials import facets
from synthetic.materials.material import Material
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.smith import SmithMaterial

from .quadrature import hemisphere_grid, reflected

ZERO, ONE = np.zeros(3), np.ones(3)


@pytest.mark.parametrize("sigma", [0.03, 0.12, 0.5])
def test_rows_of_the_form_as_printed_are_those_of_its_own_table(bench, sigma: float):
    field = bench.sphere_field(40.0, samples=60)
    fresnel = normalised_fresnel(1.5, np.einsum("nk,nk->n", field.normals, field.views))
    rows, by_sigma, _ = form_rows(field, 8, RH01_FORM, 1.5, sigma)
    expected = map(field.mean_over_rays, specular_rows(field, 8, sigma))
    for found, per_fresnel in zip((rows, by_sigma), expected, strict=True):
        means = field.mean_over_rays(found / fresnel[:, None])
        # Single precision; slopes of narrow lobes are small differences of what is as large as rows.
        assert_allclose(means, per_fresnel, atol=4e-6 * np.abs(rows).max())


@pytest.mark.parametrize(
    ("form", "mu", "material"),
    [
        (BECKMANN, 1.5, lambda sigma: SmithMaterial(ZERO, ONE, 1.5, facets.BeckmannSlopes(sigma, sigma))),
        (BECKMANN, None, lambda sigma: SmithMaterial(ZERO, ONE, None, facets.BeckmannSlopes(sigma, sigma))),
        (GGX_FORM, 1.5, lambda sigma: SmithMaterial(ZERO, ONE, 1.5, facets.GGXSlopes(sigma, sigma))),
        (PHONG, None, lambda sigma: PhongMaterial(ZERO, ONE, float(phong_exponent(sigma)))),
    ],
)
def test_rows_yield_what_the_renderers_materials_reflect(bench, form: LobeForm, mu: float | None, material):
    field, sigma, light = bench.sphere_field(40.0, samples=12), 0.15, bench.area_light
    grid = sphere_directions(20000)
    lighting = 4 * np.pi / len(grid) * evaluate_harmonics(grid, 15).T @ light.radiance_from(grid)
    lobe: Material = material(sigma)
    cos = np.einsum("nk,nk->n", field.normals, field.views)
    frames = view_frames(field.normals, field.views)
    expected = reflected(
        lambda wi, wo: lobe.lobe(wi, wo)[:, 0],
        lambda ways: light.profile(ways @ light.axis),
        frames,
        np.einsum("nkj,nk->nj", frames, field.views),
        hemisphere_grid(120, 300),
    )
    found = form_radiance(field, lighting, form, mu, sigma)
    # Of rays so steep that no table holds them, of which samples at the outline have some.
    assert_allclose(found, expected[:, None] * light.radiance, atol=1e-3 * expected.max())
    usual = cos > MIN_COS_EXITANT
    # The light beyond degree 15, and the sum over the hemisphere.
    assert_allclose(found[usual], (expected[:, None] * light.radiance)[usual], atol=5e-5 * expected.max())


@pytest.mark.parametrize("form", [BECKMANN, GGX_FORM, PHONG])
def test_slopes_are_those_of_differences(bench, form: LobeForm):
    field, mu, sigma, step = bench.sphere_field(40.0, samples=20), 1.6, 0.2, 1e-2
    given = mu if form.has_fresnel else None
    _, by_sigma, by_mu = form_rows(field, 4, form, given, sigma)
    narrow, wide = (form_rows(field, 4, form, given, sigma * np.exp(way))[0] for way in (-step, step))
    # Differences of the third order in their step.
    assert_allclose(by_sigma, (wide - narrow) / (2 * step), atol=3e-4 * np.abs(by_sigma).max())
    if given is None:
        assert not by_mu.any()
    else:
        less, more = (
            form_rows(field, 4, form, 1 + (mu - 1) * np.exp(way), sigma)[0] for way in (-step, step)
        )
        assert_allclose(by_mu, (more - less) / (2 * step), atol=3e-4 * np.abs(by_mu).max())

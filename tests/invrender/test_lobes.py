"""Forms of the specular part against the renderer's own materials, which share no code with them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.brdf.form import Angles, LobeForm
from invrender.brdf.lobes import BECKMANN, FORMS, GGX_FORM, PHONG, RH01_FORM
from invrender.brdf.phong import phong_exponent
from recon.harmonics.basis import sphere_directions
from synthetic.materials import facets
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.smith import SmithMaterial

ZERO, ONE = np.zeros(3), np.ones(3)
UP = np.array([0.0, 0.0, 1.0])


def _pairs(sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (n, 3) each: within the highlight, and anywhere."""
    rng = np.random.default_rng(0)
    wo = sphere_directions(4000)
    wi = wo[rng.permutation(len(wo))]
    wi[::2] = wo[::2] * [-1, -1, 1] + sigma * rng.standard_normal((2000, 3))
    return wi / np.linalg.norm(wi, axis=1, keepdims=True), wo


@pytest.mark.parametrize("sigma", [0.03, 0.15, 0.6])
@pytest.mark.parametrize(
    ("form", "mu"),
    [(form, mu) for form in FORMS.values() for mu in (None, 1.5) if mu is None or form.has_fresnel],
)
def test_forms_are_the_materials_of_the_renderer(form: LobeForm, mu: float | None, sigma: float) -> None:
    material: Material = {
        RH01_FORM: lambda: MicrofacetMaterial(ZERO, ONE, mu, sigma),
        BECKMANN: lambda: SmithMaterial(ZERO, ONE, mu, facets.BeckmannSlopes(sigma, sigma)),
        GGX_FORM: lambda: SmithMaterial(ZERO, ONE, mu, facets.GGXSlopes(sigma, sigma)),
        PHONG: lambda: PhongMaterial(ZERO, ONE, float(phong_exponent(sigma))),
    }[form]()
    wi, wo = _pairs(sigma)
    expected = material.lobe(wi, wo)[:, 0] * np.maximum(wi[:, 2], 0)
    found = form.reflected(Angles.between(UP, wi, wo), mu, sigma)
    assert (expected > 0).sum() > 900
    # Half vectors' angles to 1e-16 rad of rounding, times a lobe's slope.
    assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * expected.max(), equal_nan=False)


@pytest.mark.parametrize(
    ("form", "tail"), [(RH01_FORM, 0.02), (BECKMANN, 0.02), (PHONG, 0.02), (GGX_FORM, 0.2)]
)
def test_one_sigma_is_one_width_of_the_highlight(form: LobeForm, tail: float) -> None:
    sigma = 0.05
    theta = 2 * np.array([0.0, 0.5]) * sigma
    wi = np.stack([np.sin(theta), np.zeros(2), np.cos(theta)], axis=-1)
    value = form.reflected(Angles.between(UP, wi, UP), None, sigma)
    # To the first order in sigma squared; GGX falls off as 1 / (1 + t)^2 instead of exp(-t).
    assert_allclose(value[0], 1 / (4 * np.pi * sigma**2), rtol=0.02)
    assert_allclose(value[1] / value[0], np.exp(-0.25), rtol=tail)

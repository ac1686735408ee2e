"""A diffuse base under an interface, which no model has: mu is doubted by as much as it misleads."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.model.columns import PhotoColumns
from invrender.solve.factorize import factorize
from synthetic.materials.fresnel import fresnel_dielectric
from synthetic.materials.microfacet import Microfacet

MU = 1.5
MATTE = Microfacet(np.array([0.1, 0.07, 0.05]), np.zeros(3), MU, 0.1)
GLOSS = Microfacet(np.zeros(3), np.full(3, 0.04), MU, 0.1)


def layered(
    bench: SimpleNamespace, base: Microfacet, gloss: Microfacet, turn_deg: float, covered: bool = True
) -> list[PhotoColumns]:
    """Ten photographs of gloss above a base, or of an interface above it."""
    angles = np.linspace(0, turn_deg, 10)
    below, above = (bench.photograph(material, angles, samples=300) for material in (base, gloss))
    photos = []
    for deep, top in zip(below, above, strict=True):
        passed = 1 - fresnel_dielectric(MU, deep.field.cos_exitant) if covered else np.ones(len(deep.field))
        photos.append(top.less(-passed[:, None] * deep.radiance))
    return photos


@pytest.mark.parametrize("covered", [True, False])
def test_mu_is_doubted_where_the_base_is_under_an_interface(
    bench: SimpleNamespace, rng: np.random.Generator, covered: bool
) -> None:
    photos = layered(bench, MATTE, GLOSS, 180, covered)
    found = factorize(bench.with_noise(photos, rng), [bench.known_lighting()])
    mu = found.quantities["mu"]
    assert mu.value is not None
    assert mu.std is not None
    off = abs(mu.value[0] - MU)
    if covered:
        assert off > 0.05
        assert found.interface is not None
        assert found.interface.mu == pytest.approx(MU, abs=0.02)
        assert off < 2 * mu.std[0]
    else:
        assert found.interface is None
        assert off < 4 * mu.std[0] < 0.1


def test_ks_is_doubted_where_the_interface_hides_the_lobes_fresnel_factor(
    bench: SimpleNamespace, rng: np.random.Generator
) -> None:
    base = Microfacet(np.array([0.3, 0.21, 0.15]), np.zeros(3), MU, 0.2)
    gloss = Microfacet(np.zeros(3), np.full(3, 0.04), MU, 0.2)
    photos = layered(bench, base, gloss, 60)
    found = factorize(bench.with_noise(photos, rng), [bench.known_lighting()])
    # What grazing views lack of the base cancels what they have of the lobe.
    assert not found.rungs[found.chosen].estimate.model.fresnel
    assert found.interface is not None
    assert found.interface.mu == pytest.approx(MU, abs=0.02)
    assert found.interface.ks is not None
    assert_allclose(found.interface.ks, 0.04, rtol=0.1)
    assert found.interface.sigma == pytest.approx(0.2, rel=0.05)
    ks = found.quantities["ks"]
    assert ks.value is not None
    assert ks.std is not None
    off = np.abs(ks.value - 0.04)
    assert (off > 0.04).all()
    assert (off < 2 * ks.std).all()

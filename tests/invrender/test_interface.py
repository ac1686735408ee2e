"""A diffuse base under an interface, which no model has: mu is doubted by as much as it misleads."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from invrender.solve.factorize import factorize
from synthetic.materials.fresnel import fresnel_dielectric
from synthetic.materials.microfacet import Microfacet

MU = 1.5
MATTE = Microfacet(np.array([0.1, 0.07, 0.05]), np.zeros(3), MU, 0.1)
GLOSS = Microfacet(np.zeros(3), np.full(3, 0.04), MU, 0.1)


@pytest.mark.parametrize("covered", [True, False])
def test_mu_is_doubted_where_the_base_is_under_an_interface(
    bench: SimpleNamespace, rng: np.random.Generator, covered: bool
) -> None:
    angles = np.linspace(0, 180, 10)
    base, gloss = (bench.photograph(material, angles, samples=300) for material in (MATTE, GLOSS))
    photos = []
    for below, above in zip(base, gloss, strict=True):
        passed = 1 - fresnel_dielectric(MU, below.field.cos_exitant) if covered else np.ones(len(below.field))
        photos.append(above.less(-passed[:, None] * below.radiance))
    found = factorize(bench.with_noise(photos, rng), [bench.known_lighting()])
    mu = found.quantities["mu"]
    assert mu.value is not None
    assert mu.std is not None
    off = abs(mu.value[0] - MU)
    if covered:
        assert off > 0.05
        assert found.interface_mu == pytest.approx(MU, abs=0.02)
        assert off < 2 * mu.std[0]
    else:
        assert found.interface_mu is None
        assert off < 4 * mu.std[0] < 0.1

"""Distributions of microfacets against the integrals that define them, by quadrature over the hemisphere."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from synthetic.materials.facets import BeckmannSlopes, Facets, GGXSlopes

DISTRIBUTIONS = [
    kind(along, across)
    for kind in (BeckmannSlopes, GGXSlopes)
    for along, across in ((0.03, 0.03), (0.4, 0.4), (0.15, 0.6), (1.5, 0.7))
]


def facets_and_weights(facets: Facets) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (n, 3) of the upper hemisphere and their solid angles (n,), dense where slopes are likely.

    In slopes stretched to a circle, (x, y) = tan theta_h (cos / along, sin / across); the radius is tan of an angle.
    """
    node, weight = np.polynomial.legendre.leggauss(400)
    angle, weight = (node + 1) * np.pi / 4, weight * np.pi / 4
    phi = np.arange(256) * 2 * np.pi / 256
    radius = np.tan(angle)[:, None]
    slopes = np.stack(
        [facets.along * radius * np.cos(phi), facets.across * radius * np.sin(phi), np.ones((400, 256))], -1
    )
    length = np.linalg.norm(slopes, axis=-1)
    area = radius * (weight / np.cos(angle) ** 2)[:, None] * 2 * np.pi / 256 * facets.along * facets.across
    # Solid angle per area of slopes: cos^3.
    return (slopes / length[..., None]).reshape(-1, 3), (area / length**3).ravel()


@pytest.mark.parametrize("facets", DISTRIBUTIONS, ids=str)
def test_facets_cover_the_surface_once(facets: Facets) -> None:
    half, solid_angle = facets_and_weights(facets)
    covered = (facets.density(half) * half[:, 2]) @ solid_angle
    # Beckmann counts cosines below 1e-6 as 1e-6; the rest is rounding.
    assert_allclose(covered, 1.0, rtol=1e-9)


@pytest.mark.parametrize("facets", DISTRIBUTIONS, ids=str)
@pytest.mark.parametrize("theta_deg", [0.0, 25.0, 60.0, 85.0, 89.9])
def test_hidden_area_is_what_smith_defines(facets: Facets, theta_deg: float) -> None:
    # Facets towards a viewer show cos + hidden: the integral of D max(0, w.h).
    theta, phi = np.radians(theta_deg), 0.7
    w = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    half, solid_angle = facets_and_weights(facets)
    shown = (facets.density(half) * np.maximum(half @ w, 0)) @ solid_angle
    # The kink at w.h = 0 costs the quadrature up to 1e-5.
    assert_allclose(w[2] + facets.hidden(w), shown, rtol=3e-5)


@pytest.mark.parametrize("kind", [BeckmannSlopes, GGXSlopes])
def test_equal_widths_give_the_textbooks_isotropic_density(
    kind: type[Facets], rng: np.random.Generator
) -> None:
    alpha = 0.35
    half = rng.normal(size=(100, 3))
    half[:, 2] = np.abs(half[:, 2])
    cos = half[:, 2] / np.linalg.norm(half, axis=1)
    t = (1 - cos**2) / cos**2 / alpha**2
    bell = np.exp(-t) if kind is BeckmannSlopes else 1 / (1 + t) ** 2
    # Any length will do: the vectors are not unit.
    assert_allclose(kind(alpha, alpha).density(half), bell / (np.pi * alpha**2 * cos**4), rtol=1e-10)


@pytest.mark.parametrize("value", [0.0, -0.1, np.inf, np.nan])
def test_impossible_widths_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match="roughness across the tangent is"):
        GGXSlopes(0.1, value)

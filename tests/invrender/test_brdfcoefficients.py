"""Coefficients of BRDFs against sums over pairs of directions, and against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.theory.brdfcoefficients import (
    anisotropic_coefficients,
    fixed_exitant_coefficients,
    isotropic_coefficients,
    outgoing_coefficients,
)
from recon.harmonics.basis import clamped_cosine_transfer, degrees, orders
from synthetic.materials.facets import BeckmannSlopes, GGXSlopes
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.smith import SmithMaterial

from .quadrature import hemisphere_grid, scipy_complex, scipy_harmonics


def matte(incident, exitant):
    return np.full(np.broadcast_shapes(incident.shape[:-1], exitant.shape[:-1]), 0.25)


def glossy(incident, exitant):
    """Smooth and reciprocal: a function of half the angle between mirror direction and view."""
    aligned = exitant[..., 2] * incident[..., 2] - exitant[..., 0] * incident[..., 0]
    aligned = aligned - exitant[..., 1] * incident[..., 1]
    return 0.1 + np.exp(4 * (aligned - 1))


def brushed(incident, exitant):
    """Smooth, reciprocal and anisotropic."""
    across = (incident[..., 0] + exitant[..., 0]) ** 2 + 0.2 * (incident[..., 1] + exitant[..., 1]) ** 2
    return 0.05 + np.exp(-1.5 * across)


def rh01(sigma: float, mu: float | None = 1.5):
    material = MicrofacetMaterial(np.zeros(3), np.ones(3), mu, sigma)
    return lambda incident, exitant: material.lobe(incident, exitant)[..., 0]


def by_pairs(brdf, l_max: int, p_max: int, power: int = 0) -> np.ndarray:
    """rho^_ln,pq by summing over all pairs of directions; times cos theta_o to a power."""
    directions, weight = hemisphere_grid(24, 40)
    incident = scipy_complex(directions, l_max) * (weight * directions[:, 2])[:, None]
    exitant = scipy_complex(directions, p_max).conj() * (weight * directions[:, 2] ** power)[:, None]
    return incident.T @ brdf(directions[:, None], directions[None]) @ exitant


@pytest.mark.parametrize("brdf", [matte, glossy])
@pytest.mark.parametrize("reciprocal", [False, True])
def test_isotropic_coefficients_are_the_sums_over_pairs_of_directions(brdf, reciprocal: bool):
    found = isotropic_coefficients(brdf, 4, 3, reciprocal)
    pairs = by_pairs(brdf, 4, 3, power=int(reciprocal))
    expected = np.zeros((25, 16), complex)
    for lm, (l, n) in enumerate(zip(degrees(4), orders(4), strict=True)):
        for pq, (p, q) in enumerate(zip(degrees(3), orders(3), strict=True)):
            expected[lm, pq] = found[l, p, abs(q)] if n == q and abs(q) <= min(l, p) else 0.0
    # Isotropy leaves n = q only [R02, eq. 2.47].
    assert_allclose(pairs, expected, atol=1e-10)


def test_reciprocity_makes_coefficients_symmetric():
    # [R02, eq. 2.58]: only once both cosines are in.
    both = isotropic_coefficients(glossy, 5, 5, reciprocal=True)
    assert_allclose(both, both.transpose(1, 0, 2), atol=1e-11)
    one = isotropic_coefficients(glossy, 5, 5)
    assert np.abs(one - one.transpose(1, 0, 2)).max() > 0.01


@pytest.mark.parametrize("reciprocal", [False, True])
def test_anisotropic_coefficients_are_the_sums_over_pairs_of_directions(reciprocal: bool):
    found = anisotropic_coefficients(brushed, 3, 2, reciprocal)
    assert_allclose(found, by_pairs(brushed, 3, 2, power=int(reciprocal)), atol=1e-10)
    if reciprocal:
        l, n, p, q = degrees(3), orders(3), degrees(2), orders(2)
        common = found[l <= 2]
        sign = (-1.0) ** (n[l <= 2][:, None] + q)
        mirrored_rows, mirrored_columns = (p * p + p - q), (p * p + p - q)
        # rho~_ln,pq = conj of rho~_pq,ln, which for a real function is that of the negative orders.
        assert_allclose(common, sign * common[np.ix_(mirrored_rows, mirrored_columns)].conj(), atol=1e-11)
        assert_allclose(common, common.T.conj(), atol=1e-11)


MATERIALS = [
    (Lambertian(np.full(3, 0.2)), 1e-9),
    (MicrofacetMaterial(np.full(3, 0.1), np.full(3, 0.3), 1.5, 0.3), 1e-9),
    # Phong's lobe ends in a kink where R.L = 0, shadowing-masking has a root at the horizon: rules for smooth functions
    # converge slowly there.
    (PhongMaterial(np.full(3, 0.1), np.full(3, 0.3), 20.0), 1e-6),
    (SmithMaterial(np.full(3, 0.1), np.full(3, 0.3), None, BeckmannSlopes(0.4, 0.4)), 1e-5),
    (SmithMaterial(np.full(3, 0.1), np.full(3, 0.3), 1.5, GGXSlopes(0.3, 0.3)), 1e-5),
]


@pytest.mark.parametrize(("material", "tolerance"), MATERIALS)
def test_every_isotropic_material_has_coefficients(material: Material, tolerance: float):
    def brdf(incident, exitant):
        return material.kd[0] + material.ks[0] * material.lobe(incident, exitant)[..., 0]

    found = isotropic_coefficients(brdf, 3, 2, reciprocal=True, tolerance=tolerance)
    directions, weight = hemisphere_grid(120, 240)
    incident = scipy_complex(directions, 3) * (weight * directions[:, 2])[:, None]
    node, share = np.polynomial.legendre.leggauss(40)
    theta = (node + 1) * np.pi / 4
    views = np.stack([np.sin(theta), np.zeros(40), np.cos(theta)], axis=1)
    local = brdf(directions, views[:, None]) @ incident
    exitant = scipy_complex(views, 2).conj() * (share * np.pi / 4 * np.sin(theta) * np.cos(theta))[:, None]
    expected = 2 * np.pi * local.T @ exitant
    for lm, (l, n) in enumerate(zip(degrees(3), orders(3), strict=True)):
        for pq, (p, q) in enumerate(zip(degrees(2), orders(2), strict=True)):
            if n == q and q >= 0:
                # The witness's own rule meets highlights at grazing angles with few azimuths.
                assert abs(found[l, p, q] - expected[lm, pq]) < 5e-4 * np.abs(expected).max()


def test_a_brushed_material_has_coefficients():
    material = SmithMaterial(np.full(3, 0.1), np.full(3, 0.3), 1.5, GGXSlopes(0.5, 0.9))

    def brdf(incident, exitant):
        return material.kd[0] + material.ks[0] * material.lobe(incident, exitant)[..., 0]

    found = anisotropic_coefficients(brdf, 2, 2, reciprocal=True, tolerance=1e-3)
    pairs = by_pairs(brdf, 2, 2, power=1)
    assert np.abs(pairs[3, 1]) > 0.003  # n != q: brushed indeed
    assert_allclose(found, pairs, atol=2e-3 * np.abs(pairs).max())


def test_an_isotropic_brdf_is_a_special_anisotropic_one():
    general, special = anisotropic_coefficients(glossy, 2, 2), isotropic_coefficients(glossy, 2, 2)
    for lm, (l, n) in enumerate(zip(degrees(2), orders(2), strict=True)):
        for pq, (p, q) in enumerate(zip(degrees(2), orders(2), strict=True)):
            expected = special[l, p, abs(q)] if n == q and abs(q) <= min(l, p) else 0.0
            assert abs(general[lm, pq] - expected) < 1e-11


def test_a_matte_surface_has_the_coefficients_of_the_clamped_cosine():
    found = outgoing_coefficients(matte, 8, [1.0, 0.3])
    expected = 0.25 * clamped_cosine_transfer(8) * np.sqrt((2 * np.arange(9) + 1) / (4 * np.pi))
    l = np.arange(9)
    for row in found:
        assert_allclose(row[l * l + l], expected, atol=1e-12)
        assert_allclose(np.delete(row, l * l + l), 0, atol=1e-12)


# Where the horizon cuts the lobe, sums over half-vectors end within a cell: the larger tolerances are theirs.
@pytest.mark.parametrize(
    ("sigma", "cos", "tolerance"),
    [(0.1, 0.9, 1e-9), (0.01, 0.9, 1e-9), (0.1, 0.15, 1e-3), (0.03, 0.15, 1e-3)],
)
def test_sharp_and_grazing_lobes_are_integrated(sigma: float, cos: float, tolerance: float):
    found = outgoing_coefficients(rh01(sigma), 6, [cos])[0]
    # By half-vectors: dwi = 4 (wo.h) dh, on rings around the normal as fine as the lobe.
    view = np.array([np.sqrt(1 - cos**2), 0.0, cos])
    tilt, weight = np.polynomial.legendre.leggauss(300)
    reach = min(8 * sigma, 1.55)
    tilt, weight = (tilt[:, None] + 1) / 2 * reach, weight[:, None] / 2 * reach
    azimuth = np.arange(300) * 2 * np.pi / 300
    rings = [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt) + 0 * azimuth]
    half = np.stack(rings, axis=-1)
    toward = half @ view
    incident = 2 * toward[..., None] * half - view
    lit = (toward > 0) & (incident[..., 2] > 0)
    measure = (weight * np.sin(tilt) * 2 * np.pi / 300 * 4 * toward)[lit]
    incident = incident[lit]
    values = rh01(sigma)(incident, view) * incident[:, 2] * measure
    expected = values @ scipy_harmonics(incident, 6)
    assert_allclose(found, expected, atol=tolerance * np.abs(expected).max())


def test_one_exitant_angle_has_the_coefficients_of_the_expansion_at_it():
    found = fixed_exitant_coefficients(outgoing_coefficients(glossy, 3, [0.7])[0])
    directions, weight = hemisphere_grid(24, 40)
    view = np.array([np.sqrt(1 - 0.49), 0.0, 0.7])
    values = glossy(directions, view) * directions[:, 2] * weight
    expected = np.sqrt(2 * np.pi) * values @ scipy_complex(directions, 3)
    l, q = degrees(3), orders(3)
    # [R02, eq. 2.56]: the product with exp(i q phi_o) / sqrt(2 pi), here at phi_o = 0.
    assert_allclose(np.where(q < 0, (-1.0) ** q, 1) * found[l, np.abs(q)], expected, atol=1e-11)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: outgoing_coefficients(matte, -1, [0.5]), "l_max is -1"),
        (lambda: outgoing_coefficients(matte, 2, [0.0, 0.5]), r"\[0.  0.5\]; they must be in \(0, 1\]"),
        (lambda: outgoing_coefficients(lambda i, o: i, 2, [0.5]), "values for"),
        (lambda: outgoing_coefficients(lambda i, o: np.nan * i[..., 0] * o[..., 0], 2, [0.5]), "not finite"),
        # A lobe over cos theta_o: its integral over exitant angles has no limit.
        (lambda: isotropic_coefficients(rh01(0.3), 2, 2), "unbounded"),
        (
            lambda: outgoing_coefficients(rh01(3e-4), 2, [0.5]),
            "at cos theta_o = 0.5, still change.*too narrow",
        ),
    ],
)
def test_bad_input_gets_a_sentence(call, message: str):
    with pytest.raises(ValueError, match=message):
        call()

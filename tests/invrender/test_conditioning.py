"""Conditioning of special cases as the papers state it, and of operators against numpy's decompositions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.theory.conditioning import (
    Conditioning,
    Determination,
    Information,
    factorization,
    information,
    inverse_brdf,
    inverse_filter,
    inverse_lighting,
)
from invrender.theory.convolution import isotropic_light_field
from invrender.theory.explicit import factor_light_field
from recon.harmonics.basis import clamped_cosine_transfer, degrees, evaluate_harmonics, sphere_directions
from recon.harmonics.complex import to_complex

from .quadrature import sphere_grid

Floats = np.ndarray


def test_a_lambertian_surface_shows_light_of_degrees_0_to_2_well_and_odd_ones_above_not_at_all():
    found = inverse_filter(clamped_cosine_transfer(7))
    # pi, 2 pi / 3, pi / 4, 0, -pi / 24, 0, pi / 64, 0 [RH01, eq. 16].
    assert_allclose(found.condition, [1, 1.5, 4, np.inf, 24, np.inf, 64, np.inf], rtol=1e-12)
    assert found.well_posed.tolist() == [True, True, True, False, True, False, True, False]
    assert found.highest_degree(0.1) == 2
    assert found.highest_degree(1e-6) == 2
    assert found.highest_degree(0.5) == 1
    assert found.highest_degree(2) is None
    assert found.determined(0.02).tolist() == [True, True, True, False, True, False, False, False]


def test_a_mirror_shows_all_degrees_alike():
    rho = np.zeros((9, 9, 9))
    for l in range(9):
        rho[l, l, : l + 1] = (-1.0) ** np.arange(l + 1)  # [RH01, eq. 14]
    found = inverse_lighting(rho)
    assert_allclose(found.gains, np.sqrt(4 * np.pi), rtol=1e-12)
    assert found.highest_degree(0.999) == 8


@pytest.mark.parametrize(("sigma", "ratio"), [(0.1, 0.01), (0.2, 1e-4), (0.05, 0.1)])
def test_a_microfacet_lobe_shows_light_up_to_the_root_of_the_logarithm_over_its_width(
    sigma: float, ratio: float
):
    found = inverse_filter(np.exp(-((sigma * np.arange(60)) ** 2)))  # [RH01, eq. 20]
    assert found.highest_degree(ratio) == int(np.sqrt(np.log(1 / ratio)) / sigma)


def test_a_source_shows_all_degrees_of_the_brdf_and_uniform_light_one():
    source = evaluate_harmonics([[0.36, -0.48, 0.8]], 12)[0]
    # Sum over m of Y_lm^2 is (2 l + 1) / (4 pi): Lambda_l^2 times that is 1.
    assert_allclose(inverse_brdf(source).gains, 1, rtol=1e-12)
    assert_allclose(inverse_brdf(to_complex(source)).gains, 1, rtol=1e-12)
    uniform = inverse_brdf(np.eye(1, 25)[0])
    assert uniform.well_posed.tolist() == [True, False, False, False, False]
    assert uniform.condition.tolist() == [1, np.inf, np.inf, np.inf, np.inf]


def some_factors(rng: np.random.Generator, l_max: int) -> tuple[Floats, Floats]:
    real = rng.normal(size=(l_max + 1) ** 2)
    real[0] = np.sqrt(1 / (4 * np.pi))
    rho = rng.normal(size=(l_max + 1,) * 3)
    rho = rho + rho.transpose(1, 0, 2)
    rho[0, 0, 0] = 4
    l, p, q = np.indices(rho.shape)
    return to_complex(real), np.where(q <= np.minimum(l, p), rho, 0)


def test_gains_are_singular_values_of_the_convolution(rng):
    lighting, rho = some_factors(rng, 3)
    by_light, by_brdf = inverse_lighting(rho).gains, inverse_brdf(lighting).gains
    for l in range(4):
        band = range(l * l, (l + 1) ** 2)
        columns = [isotropic_light_field(np.eye(16)[k], rho).ravel() for k in band]
        assert_allclose(np.linalg.svd(columns, compute_uv=False), by_light[l], rtol=1e-12)
        columns = []
        for p in range(4):
            unit = np.zeros_like(rho)
            unit[l, p, 0] = 1
            columns.append(isotropic_light_field(lighting, unit).ravel())
        assert_allclose(np.linalg.svd(columns, compute_uv=False), by_brdf[l], rtol=1e-12)


def test_factorization_is_never_better_conditioned_than_inverse_lighting(rng):
    lighting, rho = some_factors(rng, 4)
    rho[3, :3], rho[:3, 3], rho[3, 4], rho[4, 3] = 0, 0, 0, 0
    field = isotropic_light_field(lighting, rho)
    known = inverse_lighting(rho)
    found = factorization(factor_light_field(field, 1e-6), 1e-6)
    assert found.well_posed.tolist() == [True, True, True, False, True]
    assert found.condition[3] == np.inf
    assert np.all(found.gains <= known.gains * (1 + 1e-9))
    # Noise comes out as a share of what it was: gains don't depend on it.
    assert_allclose(factorization(factor_light_field(field, 1e-5), 1e-5).gains, found.gains, rtol=1e-4)


def some_operator(rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Rows, noise and prior: of very different size, and fewer rows than unknowns."""
    return rng.normal(size=(12, 16)), np.exp(rng.normal(size=12)), np.exp(rng.normal(size=16))


def test_singular_values_and_posterior_are_those_of_numpy(rng):
    rows, noise, prior = some_operator(rng)
    found = information(rows, noise).against(prior)
    values = np.linalg.svd(rows * prior / noise[:, None], compute_uv=False)
    # Squares are right to rounding of the largest, 1e-15 of it; of one that is 0 its root is left.
    assert_allclose(found.singular_values[:12], values, rtol=1e-9)
    assert_allclose(found.singular_values[12:], 0, atol=1e-7 * values[0])
    posterior = np.linalg.inv(np.diag(prior**-2) + rows.T @ np.diag(noise**-2) @ rows)
    assert_allclose(found.posterior_std, np.sqrt(np.diag(posterior)), rtol=1e-9, equal_nan=False)
    # Degrees of freedom as the trace of the influence of the data on their own prediction.
    influence = rows @ posterior @ rows.T @ np.diag(noise**-2)
    assert_allclose(found.effective_rank, np.trace(influence), rtol=1e-9)
    assert found.rank_beyond_prior == np.sum(values > 1)
    assert_allclose(found.shares, 1 - np.diag(posterior) / prior**2, atol=1e-12, equal_nan=False)
    assert_allclose(found.shares.sum(), found.effective_rank, rtol=1e-9)
    per_degree = [found.shares[l * l : (l + 1) ** 2].mean() for l in range(4)]
    assert_allclose(found.share_per_degree(), per_degree, rtol=1e-12)


def test_information_adds_up_over_photographs(rng):
    rows, noise, prior = some_operator(rng)
    whole = information(rows, noise).against(prior)
    parts = [information(rows[part], noise[part]) for part in (slice(0, 5), slice(5, 6), slice(6, 12))]
    found = (parts[0] + parts[1] + parts[2]).against(prior)
    assert_allclose(found.singular_values[:12], whole.singular_values[:12], rtol=1e-9)
    assert_allclose(found.posterior_std, whole.posterior_std, rtol=1e-12, equal_nan=False)


def test_without_photographs_nothing_is_known_beyond_the_prior():
    nothing = information(np.zeros((0, 9)), 1.0).against(2.0)
    assert nothing.effective_rank == 0
    assert nothing.posterior_std.tolist() == [2.0] * 9
    assert nothing.share_per_degree().tolist() == [0, 0, 0]


def test_on_the_whole_sphere_singular_values_are_those_of_theory():
    transfer = clamped_cosine_transfer(4)[degrees(4)]
    normals, weights = sphere_grid(5)  # exact for products of two of degree 4
    found = information(evaluate_harmonics(normals, 4) * transfer, 1 / np.sqrt(weights)).against(1.0)
    expected = np.sort(np.abs(transfer))[::-1]
    assert_allclose(found.singular_values, expected, atol=1e-7)  # the root of rounding, where theory says 0
    # Spread evenly: n / (4 pi) of them to a steradian. A spiral of 2000 is a rule to about 1e-4.
    normals = sphere_directions(2000)
    found = information(evaluate_harmonics(normals, 4) * transfer, 0.1).against(1.0)
    theory = expected * np.sqrt(2000 / (4 * np.pi)) / 0.1
    assert_allclose(found.singular_values, theory, atol=1e-3 * theory[0])


def test_a_cap_of_normals_determines_less_than_the_whole_sphere():
    def photograph(reach: float) -> Determination:
        normals = sphere_directions(500)
        z = 1 - (1 - normals[:, 2]) * (1 - np.cos(reach)) / 2
        ring = np.sqrt((1 - z**2) / (1 - normals[:, 2] ** 2))
        normals = np.column_stack([normals[:, :2] * ring[:, None], z])
        rows = evaluate_harmonics(normals, 4) * clamped_cosine_transfer(4)[degrees(4)]
        return information(rows, 0.3).against(1.0)

    whole, half, cap = photograph(np.pi), photograph(np.pi / 2), photograph(0.35)
    # Degree 3 doesn't reflect, which leaves 18 of 25, degree 4 weakly.
    assert 16 < whole.effective_rank < 18
    assert cap.effective_rank < 0.7 * half.effective_rank < 0.7 * whole.effective_rank
    assert cap.rank_beyond_prior < half.rank_beyond_prior <= whole.rank_beyond_prior == 18
    for found in (whole, half, cap):
        assert_allclose(found.share_per_degree()[3], 0, atol=1e-12)
    assert np.all(np.delete(cap.share_per_degree(), 3) < np.delete(whole.share_per_degree(), 3))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: inverse_lighting(np.ones((3, 3))), "rho has 2 axes; it must have 3"),
        (lambda: inverse_filter([1.0, np.nan]), "transfer: 1 of 2 values are not finite"),
        (lambda: inverse_brdf(np.ones(7)), "there are 7 coefficients"),
        (lambda: Conditioning(np.array([1.0, -1.0])), "must be finite and >= 0"),
        (lambda: Conditioning(np.ones(2)).determined(0.0), "noise_to_signal is 0.0"),
        (lambda: information(np.ones((3, 4)), [1.0, 0.0, 1.0]), "noise_std holds 0 to 1"),
        (
            lambda: information(np.ones((3, 4)), np.ones(4)),
            r"noise_std is \(4,\); it must be one number or \(3,\)",
        ),
        (lambda: information(np.full((3, 4), np.inf), 1.0), "rows: 12 of 12 values are not finite"),
        (lambda: Information(np.ones((2, 3))), r"must be \(k, k\)"),
        (
            lambda: Information(np.eye(2)) + Information(np.eye(3)),
            "of 2 unknowns can't be added to that of 3",
        ),
        (lambda: Information(np.eye(2)).against(-1.0), "prior_std holds -1 to -1"),
        (lambda: Information(np.eye(5)).against(1.0).share_per_degree(), "there are 5 coefficients"),
    ],
)
def test_what_is_no_operator_and_no_noise_is_refused(call, message: str):
    with pytest.raises(ValueError, match=message):
        call()

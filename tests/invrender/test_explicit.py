"""Light fields made of lighting and BRDF, factored back; one of them by brute-force integration."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from invrender.theory.explicit import LightFieldFactors, factor_light_field, printed_factors
from recon.harmonics.basis import clamped_cosine_transfer, degrees, orders
from recon.harmonics.complex import to_complex, to_real
from recon.harmonics.rotations import wigner_D

from .quadrature import angles, hemisphere_grid, scipy_complex, sphere_grid

Floats = np.ndarray


def light_field(lighting: Floats, rho: Floats) -> Floats:
    """Lambda_l L_lm rho_lp|q|, coefficient by coefficient."""
    l_max, p_max = (count - 1 for count in rho.shape[:2])
    field = np.zeros((len(lighting), (p_max + 1) ** 2), complex)
    for l in range(l_max + 1):
        for p in range(p_max + 1):
            for q in range(-min(l, p), min(l, p) + 1):
                band = slice(l * l, (l + 1) ** 2)
                field[band, p * p + p + q] = (
                    np.sqrt(4 * np.pi / (2 * l + 1)) * lighting[band] * rho[l, p, abs(q)]
                )
    return field


def some_lighting(rng: np.random.Generator, l_max: int) -> Floats:
    real = rng.normal(size=(l_max + 1) ** 2)
    real[0] = np.sqrt(1 / (4 * np.pi))
    return to_complex(real)


def some_rho(rng: np.random.Generator, l_max: int, p_max: int) -> Floats:
    """Random coefficients of a reciprocal BRDF; that of degree 0, which all hangs on, isn't small."""
    most = max(l_max, p_max)
    rho = rng.normal(size=(most + 1,) * 3)
    rho = rho + rho.transpose(1, 0, 2)
    rho[0, 0, 0] = 4
    l, p, q = np.indices(rho.shape)
    return np.where(q <= np.minimum(l, p), rho, 0)[: l_max + 1, : p_max + 1, : min(l_max, p_max) + 1]


def white_noise(rng: np.random.Generator, l_max: int, p_max: int) -> Floats:
    """Coefficients of real white noise: E|n|^2 = 1 of each, n_l-mp-q = (-1)^m conj(n_lmpq)."""
    shape = ((l_max + 1) ** 2, (p_max + 1) ** 2)
    noise = rng.normal(size=(2, *shape), scale=0.5)
    noise = noise[0] + 1j * noise[1]
    m, q = orders(l_max), orders(p_max)
    mirrored = noise[np.arange(shape[0]) - 2 * m][:, np.arange(shape[1]) - 2 * q]
    noise = noise + (-1.0) ** m[:, None] * mirrored.conj()
    noise[np.abs(q) > degrees(l_max)[:, None]] = 0
    return noise


def without(rho: Floats, l: int, p: int) -> Floats:
    """The BRDF with nothing between degrees l and p."""
    rho = rho.copy()
    rho[l, p], rho[p, l] = 0, 0
    return rho


def assert_found(found: LightFieldFactors, lighting: Floats, rho: Floats) -> None:
    # Rounding, amplified by what is divided by; the smallest amplitudes here are about 1e-2 of the largest.
    assert_allclose(found.lighting, lighting, atol=1e-8, equal_nan=False)
    assert_allclose(found.rho, rho, atol=1e-8, equal_nan=False)
    assert found.lighting_determined.all()
    assert found.brdf_determined.all()
    assert not any(found.reasons)


@pytest.mark.parametrize("l_max", range(9))
@pytest.mark.parametrize("more", [0, 2])
def test_random_light_fields_factor_back(l_max: int, more: int, rng):
    lighting, rho = some_lighting(rng, l_max), some_rho(rng, l_max, l_max + more)
    field = light_field(lighting, rho)
    assert_found(factor_light_field(field), lighting, rho)
    printed = printed_factors(field)
    assert_allclose(printed[0], lighting, atol=1e-8, equal_nan=False)
    assert_allclose(printed[1], rho, atol=1e-8, equal_nan=False)


def test_the_scale_is_a_gauge(rng):
    lighting, rho = some_lighting(rng, 3), some_rho(rng, 3, 3)
    assert_found(factor_light_field(light_field(-7 * lighting, rho)), lighting, -7 * rho)


def test_a_light_field_integrated_by_brute_force_factors_into_what_it_was_made_of(rng):
    lighting = some_lighting(rng, 3)
    # With one rule for both sides the sums are as reciprocal as the integrals.
    local, weights = hemisphere_grid(10, 16)
    half = local[None] + local[:, None]
    brdf = 0.2 + 0.6 * (half[..., 2] / np.linalg.norm(half, axis=-1)) ** 6
    cosines, basis = local[:, 2] * weights, scipy_complex(local, 3)
    l_of, m, q = degrees(3), orders(3), orders(3)

    # Over all normals, exact for products of two of degree 3, against C_lmpq = D^l_mq Y_pq / Lambda_l [R02, eq. 2.51].
    field = np.zeros((16, 16), complex)
    normals, areas = sphere_grid(4)
    for (alpha, beta), area in zip(np.transpose(angles(normals)), areas, strict=True):
        frame = Rotation.from_euler("ZY", [beta, alpha]).as_matrix()
        light = (scipy_complex(local @ frame.T, 3) @ lighting).real
        waves = basis.conj().T @ (cosines * (brdf @ (cosines * light)))
        turned = np.zeros((16, 16), complex)
        for l, matrix in enumerate(wigner_D(3, alpha, beta)):
            rows, columns = l_of == l, np.abs(q) <= l
            scale = np.sqrt((2 * l + 1) / (4 * np.pi))
            turned[np.ix_(rows, columns)] = scale * matrix[m[rows][:, None] + l, q[columns] + l]
        field += area * turned.conj() * waves

    # rho~ = sum of rho~_lpq conj(Y_lq(incident)) Y_pq(exitant) [R02, eq. 2.53].
    overlap = (basis.conj().T @ (cosines[:, None] * brdf * cosines) @ basis).real
    rho = np.zeros((4, 4, 4))
    for l, p in np.ndindex(4, 4):
        q = np.arange(min(l, p) + 1)
        rho[l, p, q] = overlap[p * p + p + q, l * l + l + q]
    # Rounding of the sums, amplified by what is divided by: rho~_33q are about 1e-2 of rho~_000.
    found = factor_light_field(field)
    assert_allclose(found.lighting, lighting, atol=1e-10, equal_nan=False)
    assert_allclose(found.rho, rho, atol=1e-12, equal_nan=False)


def test_other_p_and_q_serve_where_the_printed_formula_divides_by_zero(rng):
    lighting = some_lighting(rng, 5)
    rho = without(without(some_rho(rng, 5, 5), 2, 0), 5, 0)
    field = light_field(lighting, rho)
    printed = printed_factors(field)
    undefined = np.isin(degrees(5), [2, 5])
    assert_allclose(np.isnan(printed[0]), undefined)
    assert_allclose(printed[0][~undefined], lighting[~undefined], atol=1e-8, equal_nan=False)
    assert_found(factor_light_field(field), lighting, rho)


def test_ties_are_chained(rng):
    lighting, rho = some_lighting(rng, 4), some_rho(rng, 4, 4)
    # Scales far from each other: no fit could make up for a wrong start.
    lighting *= np.array([1, 100, 0.03, 30, 0.01])[degrees(4)]
    for p in (0, 1, 4):
        rho = without(rho, 3, p)
    assert_found(factor_light_field(light_field(lighting, rho)), lighting, rho)
    # Degree 1 only by 4, 4 only by 2, and 3 too.
    for pair in ((1, 0), (1, 2), (4, 0)):
        rho = without(rho, *pair)
    assert_found(factor_light_field(light_field(lighting, rho)), lighting, rho)


def test_degrees_without_ties_have_no_numbers_but_a_reason(rng):
    lighting, rho = some_lighting(rng, 3), some_rho(rng, 3, 3)
    for p in (0, 1, 2):
        rho = without(rho, 3, p)
    found = factor_light_field(light_field(lighting, rho))
    assert found.lighting_determined.tolist() == [True, True, True, False]
    assert found.brdf_determined.tolist() == [True, True, True, False]
    assert "degree 3 are known up to a common scale" in found.reasons[3]
    assert not any(found.reasons[:3])
    assert_allclose(np.isnan(found.lighting), degrees(3) == 3)
    assert_allclose(np.isnan(found.lighting_std), degrees(3) == 3)
    # What remains of the BRDF is what its reciprocal shows: all but rho~_33q.
    assert np.argwhere(np.isnan(found.rho)).tolist() == [[3, 3, q] for q in range(4)]
    assert_allclose(found.rho[:3], rho[:3], atol=1e-8, equal_nan=False)


def test_degrees_beyond_the_exitant_ones_have_nothing_to_be_tied_with(rng):
    lighting, rho = some_lighting(rng, 4), some_rho(rng, 4, 2)
    found = factor_light_field(light_field(lighting, rho))
    assert found.lighting_determined.tolist() == [True, True, True, False, False]
    assert "ends at degree 2" in found.reasons[4]
    assert_allclose(found.lighting[:9], lighting[:9], atol=1e-8, equal_nan=False)


@pytest.mark.parametrize("noise_std", [0.0, 1e-3])
def test_light_that_a_lambertian_surface_does_not_reflect_is_undetermined(noise_std: float, rng):
    lighting = some_lighting(rng, 5)
    cosine = clamped_cosine_transfer(5) * np.sqrt((2 * np.arange(6) + 1) / (4 * np.pi))
    rho = np.zeros((6, 6, 6))
    rho[:, :, 0] = np.outer(cosine, cosine)
    found = factor_light_field(light_field(lighting, rho) + noise_std * white_noise(rng, 5, 5), noise_std)
    assert found.lighting_determined.tolist() == [True, True, True, False, True, False]
    assert "could be anything" in found.reasons[3]
    seen = ~np.isin(degrees(5), [3, 5])
    assert_allclose(found.lighting[seen], lighting[seen], atol=1e-8 + 100 * noise_std, equal_nan=False)


def test_light_that_is_not_there_is_seen_not_to_be(rng):
    lighting, rho = some_lighting(rng, 4), some_rho(rng, 4, 4)
    lighting[degrees(4) == 3] = 0
    scores = []
    for _ in range(100):
        found = factor_light_field(light_field(lighting, rho) + 0.01 * white_noise(rng, 4, 4), 0.01)
        assert found.lighting_determined.all()
        assert found.brdf_determined.tolist() == [True, True, True, False, True]
        dark = degrees(4) == 3
        scores.append(to_real(found.lighting)[dark] / found.lighting_std[dark])
    assert "lighting of degree 3 doesn't stand out" in found.reasons[3]
    # As many as 700 independent numbers: 3 standard errors of their root mean square.
    assert abs(np.sqrt(np.mean(np.square(scores))) - 1) < 3 / np.sqrt(1400)
    # The BRDF is known from other degrees, all but rho~_33q, and its errors don't matter where there is no light.
    others = np.delete(rho[3], 3, axis=0)
    gain = np.sqrt(4 * np.pi / 7) * np.sqrt((others**2 * [1, 2, 2, 2, 2]).sum())
    assert_allclose(found.lighting_std[dark], 0.01 / gain, rtol=0.02)  # as rho~ was found, to a percent


@pytest.mark.parametrize(("tie", "determined"), [(0.02, False), (0.3, True)])
def test_ties_count_if_they_stand_out_of_the_noise(tie: float, determined: bool, rng):
    lighting, rho = some_lighting(rng, 4), some_rho(rng, 4, 4)
    for p in (0, 1, 2, 4):
        rho[3, p] *= tie
        rho[p, 3] *= tie
    field = light_field(lighting, rho)
    scores, dark = [], degrees(4) == 3
    for _ in range(100):
        found = factor_light_field(field + 0.05 * white_noise(rng, 4, 4), 0.05)
        assert found.brdf_determined[3] == determined
        assert found.lighting_determined[[0, 1, 2, 4]].all()
        scores.append((to_real(found.lighting) - to_real(lighting))[dark] / found.lighting_std[dark])
    # The scale is common to the degree's seven numbers: as few as 100 independent ones, 3 standard errors.
    assert not determined or abs(np.sqrt(np.mean(np.square(scores))) - 1) < 3 / np.sqrt(200)


@pytest.mark.parametrize("uneven", [False, True])
def test_errors_are_as_large_as_stated(uneven: bool, rng):
    l_max = 4
    lighting, rho = some_lighting(rng, l_max), some_rho(rng, l_max, l_max)
    field = light_field(lighting, rho)
    noise_std = np.full(field.shape, 0.01)
    if uneven:
        order = np.abs(orders(l_max))
        noise_std *= np.exp(rng.normal(size=(l_max + 1,) * 4))[
            degrees(l_max)[:, None], order[:, None], degrees(l_max), order
        ]
    light_scores, rho_scores, misfits = [], [], []
    for _ in range(200):
        found = factor_light_field(field + noise_std * white_noise(rng, l_max, l_max), noise_std)
        assert found.brdf_determined.all()
        assert found.lighting_std[0] == 0
        light_scores.append((to_real(found.lighting) - to_real(lighting))[1:] / found.lighting_std[1:])
        free = found.rho_std > 0
        rho_scores.append((found.rho - rho)[free] / found.rho_std[free])
        misfits.append(found.misfit)
    for scores in (np.array(light_scores), np.array(rho_scores)):
        # A degree's scale is common to its numbers: 200 draws of at least four of them, 3 standard errors of 0.025.
        assert 0.9 < np.sqrt(np.mean(scores**2)) < 1.1
        assert 0.9 < np.mean(np.abs(scores) < 1.96) < 0.99
    # Chi-square of some 350 numbers, over 200 draws.
    assert_allclose(np.mean(misfits), 1, atol=0.02)


def test_brdfs_that_are_not_reciprocal_or_not_isotropic_misfit(rng):
    lighting, rho = some_lighting(rng, 4), some_rho(rng, 4, 4)
    rho[1, 3, 1] += 0.5
    noise = 0.01 * white_noise(rng, 4, 4)
    assert factor_light_field(light_field(lighting, rho) + noise, 0.01).misfit > 10
    field = light_field(lighting, some_rho(rng, 4, 4))
    # Odd in q, real, of degree 2 in light and view.
    field[4:9, 4 + 2 + 1] += 0.5j * lighting[4:9]
    field[4:9, 4 + 2 - 1] -= 0.5j * lighting[4:9]
    assert factor_light_field(field + noise, 0.01).misfit > 10


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda field: field[:8], "there are 8 coefficients"),
        (lambda field: field[0], "two axes"),
        (lambda field: field + np.where(np.arange(9) == 4, np.nan, 0), "9 of 81 coefficients .* not finite"),
        (lambda field: field + 1, r"12 coefficients with \|q\| > l are not zero"),
        (lambda field: field * 1j, "not those of a real function"),
        (lambda field: 0 * field, "B_0000 is 0: there is no light"),
    ],
)
def test_what_is_no_light_field_is_refused(change, message: str, rng):
    field = light_field(some_lighting(rng, 2), some_rho(rng, 2, 2))
    with pytest.raises(ValueError, match=message):
        factor_light_field(change(field))


@pytest.mark.parametrize(
    ("noise_std", "message"),
    [
        (-0.1, "-0.1 to -0.1; standard deviations"),
        (np.nan, "standard deviations"),
        (10.0, "B_0000 is .* with a standard deviation of 10"),
        (np.ones(9), r"noise_std is \(9,\); it must be one number"),
        (np.tile(np.arange(1.0, 10), (9, 1)), "differs between m and -m or q and -q"),
    ],
)
def test_noise_that_is_none_or_hides_all_is_refused(noise_std, message: str, rng):
    field = light_field(some_lighting(rng, 2), some_rho(rng, 2, 2))
    with pytest.raises(ValueError, match=message):
        factor_light_field(field, noise_std)

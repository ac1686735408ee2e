"""Light recovered from brute-force photographs of spheres of known BRDF, by both methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.brdf.microfacet import Microfacet
from invrender.inverse_lighting.coefficients import (
    DETERMINED,
    UNDETERMINED,
    LightCoefficients,
    check_samples,
    estimate_coefficients,
)
from invrender.inverse_lighting.dual import estimate_dual
from invrender.inverse_lighting.known_brdf import known_brdf
from invrender.transport.harmonic_rows import PhotoRows, lobe_blur, mirrored_views, photo_rows
from invrender.transport.lobe_table import TRANSFERS, Transfer
from recon.harmonics.basis import degrees, sphere_directions
from recon.harmonics.latlong import synthesise_latlong
from synthetic.materials.microfacet import MicrofacetMaterial as Truth
from synthetic.render.lobes import reflected_radiance

from .quadrature import scipy_harmonics

# Views all around, so that reflections reach every direction.
AROUND = tuple(range(0, 360, 40))
ROUGH = 0.25


def true_coefficients(bench: SimpleNamespace, l_max: int) -> np.ndarray:
    """Of the bench's area light, by a plain sum over evenly spread directions and scipy's harmonics."""
    directions = sphere_directions(40_000)
    weights = 4 * np.pi / len(directions)
    return weights * scipy_harmonics(directions, l_max).T @ bench.area_light.radiance_from(directions)


def photographs(
    bench: SimpleNamespace,
    brdf: Microfacet,
    angles: Sequence[float] = AROUND,
    l_max: int = 11,
    transfer: Transfer = "exact",
    samples: int = 150,
) -> list[PhotoRows]:
    """Rows of photographs without noise under the bench's area light; radiance summed over incident directions."""
    # The lobe of a diffuse surface is any, times zero.
    truth = Truth(brdf.kd, brdf.ks, brdf.mu, brdf.sigma or 0.1)
    photos = []
    for angle in angles:
        field = bench.sphere_field(angle, samples)
        rays = reflected_radiance(truth, [bench.area_light], [], field.normals, field.views)
        field = replace(field, radiance=field.mean_over_rays(rays))
        photos.append(photo_rows(field, brdf, l_max, transfer))
    return photos


def noisy(photos: Sequence[PhotoRows], rng: np.random.Generator) -> list[PhotoRows]:
    """1% of the radiance, and 1% of its mean."""
    made = []
    for photo in photos:
        seen = photo.field.radiance
        deviation = 0.01 * np.hypot(seen, seen.mean())
        made.append(
            replace(
                photo, field=replace(photo.field, radiance=seen + deviation * rng.standard_normal(seen.shape))
            )
        )
    return made


def first_nine_error(found: LightCoefficients, truth: np.ndarray) -> float:
    return float(np.abs((found.values[:9] - truth[:9]) / truth[0]).max())


@pytest.fixture(scope="module")
def glossy(bench: SimpleNamespace) -> SimpleNamespace:
    """A sphere with both parts, its photographs without noise, and the light."""
    brdf = known_brdf([0.1], [0.2], 1.5, ROUGH)
    return SimpleNamespace(
        brdf=brdf, photos=photographs(bench, brdf, samples=300), truth=true_coefficients(bench, 11)
    )


def test_coefficients_are_within_their_deviations_which_cover_them(glossy, rng):
    errors, z, inside = [], [], []
    for _ in range(12):
        found = estimate_coefficients(noisy(glossy.photos, rng), glossy.brdf, 11)
        off = (found.values - glossy.truth) / found.std
        known = found.shares >= DETERMINED
        z.append(off[known])
        inside.append(np.abs(off[known]) < 1.96)
        errors.append(first_nine_error(found, glossy.truth))
    # Each estimate's deviations are the larger of two, so a little wide: 0.8 to 1.05 for 1.
    assert 0.8 < np.sqrt(np.mean(np.concatenate(z) ** 2)) < 1.05
    # 12 draws of hundreds of coefficients, correlated within a draw.
    assert 0.94 < np.mean(np.concatenate(inside)) < 0.99
    assert max(errors) < 0.003


@pytest.mark.sweep
def test_95_percent_intervals_of_the_first_nine_cover_them_in_95_of_100_draws(bench, rng):
    brdf = known_brdf([0.1], [0.2], None, 0.5)
    photos = photographs(bench, brdf, l_max=6, samples=60)
    truth = true_coefficients(bench, 6)
    inside = []
    for _ in range(100):
        found = estimate_coefficients(noisy(photos, rng), brdf, 6)
        inside.append(np.abs(found.values - truth)[:9] < 1.96 * found.std[:9])
    covered = np.mean(inside, axis=0)
    assert 0.94 < covered.mean() < 0.99
    # Each number by itself: 95 of 100 is within 6.5 at three deviations.
    assert covered.min() > 0.87


def test_a_diffuse_sphere_determines_no_odd_degree_above_one(bench, rng):
    brdf = known_brdf([0.2], [0], None, None)
    photos = photographs(bench, brdf, l_max=8)
    found = estimate_coefficients(noisy(photos, rng), brdf)
    shares = found.share_per_degree
    assert (shares[:3] >= DETERMINED).all()
    assert (shares[3::2] < 1e-3).all()
    # What isn't determined stays as wide as before, about 0: no number is made up.
    odd = np.isin(degrees(found.degree), [3, 5, 7])
    assert_allclose(found.std[odd], np.broadcast_to(found.prior_std, found.std[odd].shape), rtol=1e-3)
    # Of degree 2 it passes a fourth of what it passes of degree 0.
    assert first_nine_error(found, true_coefficients(bench, 2)) < 0.01


def test_the_exact_transfer_beats_the_filtered_one_and_that_the_mirror(bench):
    brdf = known_brdf([0.02], [0.2], None, 0.3)
    truth = true_coefficients(bench, 8)
    errors = {}
    for transfer in TRANSFERS:
        photos = photographs(bench, brdf, l_max=8, transfer=transfer, samples=80)
        found = estimate_coefficients(photos, brdf, 8)
        # Where the lobe leaves something of the light, degrees up to 1 / sigma.
        errors[transfer] = np.sqrt(np.mean((found.values - truth)[:16] ** 2)) / truth[0].max()
    assert errors["exact"] < 0.003
    assert errors["exact"] < errors["filtered"] / 5
    assert errors["filtered"] < errors["mirror"]


def test_the_default_degree_is_of_the_order_of_one_over_sigma(bench, rng):
    found = {}
    for sigma in (0.25, 0.6):
        brdf = known_brdf([0.1], [0.2], None, sigma)
        photos = photographs(bench, brdf, l_max=11, samples=100)
        found[sigma] = estimate_coefficients(noisy(photos, rng), brdf).degree
    assert 1 <= found[0.25] * 0.25 <= 3
    assert found[0.6] < found[0.25]


def test_views_from_one_side_leave_directions_unreached_and_the_map_uncertain_there(bench, rng):
    brdf = known_brdf([0.0], [0.2], None, 0.12)
    # Of a sphere's middle, reflections within some 50 degrees of the camera.
    photos = []
    for photo in photographs(bench, brdf, [60.0, 80.0], l_max=8, samples=600):
        field = photo.field.where(photo.field.cos_exitant > 0.9)
        photos.append(photo_rows(field, brdf, 8))
    direct = estimate_coefficients(noisy(photos, rng), brdf, 8)
    dual = estimate_dual(photos, brdf, direct)
    assert 0.1 < dual.coverage < 0.4
    reach = np.concatenate([mirrored_views(photo.field) for photo in photos])
    assert (reach @ bench.direction(70, 0)).min() > 0.4
    assert dual.std[~dual.reached].mean() > 20 * dual.std[dual.reached].mean()
    # Many combinations of the coefficients are those of the directions that aren't seen.
    assert direct.rank.max() < 0.75 * len(direct.values)
    assert (direct.share_per_degree < UNDETERMINED).any()


@pytest.fixture(scope="module")
def narrow(bench: SimpleNamespace) -> SimpleNamespace:
    """A sphere with a narrow highlight, with every direction reflected."""
    brdf = known_brdf([0.05], [0.2], 1.5, 0.15)
    photos = photographs(bench, brdf, l_max=14, samples=400)
    return SimpleNamespace(brdf=brdf, photos=photos, truth=true_coefficients(bench, 14))


def test_the_dual_map_is_the_light_blurred_by_the_lobe(bench, narrow, rng):
    photos = noisy(narrow.photos, rng)
    direct = estimate_coefficients(photos, narrow.brdf, 14)
    dual = estimate_dual(photos, narrow.brdf, direct)
    assert dual.coverage > 0.98
    blur = lobe_blur(narrow.brdf, 14)[degrees(14), None]
    expected = synthesise_latlong(narrow.truth * blur, len(dual.radiance))
    off = dual.radiance - expected
    assert np.sqrt(np.mean(off[dual.reached] ** 2)) < 0.02 * expected.max()
    # Deviations are those of the noise: pixels share samples, but there are thousands.
    assert 0.8 < np.sqrt(np.mean((off / dual.std)[dual.reached] ** 2)) < 1.2
    assert np.abs((dual.nine - narrow.truth[:9]) / narrow.truth[0]).max() < 0.005
    assert np.sqrt(np.mean(((dual.nine - narrow.truth[:9]) / dual.nine_std) ** 2)) < 1.6


def test_the_papers_own_consistency_condition_holds_for_a_mirror(bench):
    # Light of degree 2 on a mirror with a diffuse part, as the paper's model has it: the nine equations are exact.
    brdf = known_brdf([0.3], [0.2], 1.5, 0.12)
    light = np.random.default_rng(3).normal(size=(9, 3)) + np.eye(9, 1) * 8
    photos = []
    for angle in AROUND:
        photo = photo_rows(bench.sphere_field(angle, 800), brdf, 4, "mirror")
        seen = photo.predict(brdf, light)
        photos.append(replace(photo, field=replace(photo.field, radiance=seen)))
    direct = estimate_coefficients(photos, brdf, 2)
    # Of it the mirror's transfer takes what no reflection reaches, and no more.
    dual = estimate_dual(photos, brdf, direct, "mirror")
    assert dual.coverage > 0.98
    # Directions are means over pixels of 2.8 degrees and their neighbourhood.
    assert np.abs(dual.nine - light).max() < 0.01 * light[0].max()


def test_what_cannot_be_solved_is_said():
    with pytest.raises(ValueError, match=r"degree 5 has 36 unknown coefficients .* only 30 samples"):
        check_samples(5, 30)
    with pytest.raises(ValueError, match="degree is -1; it must be an integer >= 0"):
        check_samples(-1, 30)
    with pytest.raises(ValueError, match="degrees up to 30"):
        check_samples(31, 10_000)


@pytest.mark.parametrize(
    ("kd", "ks", "mu", "sigma", "message"),
    [
        ([0], [0], None, None, "reflects nothing"),
        ([0, 0.1, 0.1], [0, 0.1, 0.1], None, 0.1, "reflects nothing"),
        ([0.1], [0.1], None, None, "sigma isn't given"),
        ([0.1], [0.1], None, 0.9, "sigma is 0.9; roughnesses are 0.005 to 0.7"),
        ([0.1], [0.1], 0.9, 0.1, "mu is 0.9"),
        ([0.1, 0.2], [0.1], None, 0.1, "one number, or three"),
        ([-0.1], [0.1], None, 0.1, "finite and >= 0"),
        ([float("nan")], [0.1], None, 0.1, "finite and >= 0"),
    ],
)
def test_no_brdf_is_an_error(kd, ks, mu, sigma, message):
    with pytest.raises(ValueError, match=message):
        known_brdf(kd, ks, mu, sigma)


def test_a_diffuse_object_has_no_dual_map(bench):
    brdf = known_brdf([0.2], [0], None, None)
    photos = photographs(bench, brdf, [0.0, 90.0], l_max=3, samples=50)
    with pytest.raises(ValueError, match="no specular part"):
        estimate_dual(photos, brdf, estimate_coefficients(photos, brdf, 2))


def test_black_photographs_are_an_error(glossy):
    black = [
        replace(photo, field=replace(photo.field, radiance=0 * photo.field.radiance))
        for photo in glossy.photos
    ]
    with pytest.raises(ValueError, match=r"mean radiance .* must be > 0"):
        estimate_coefficients(black, glossy.brdf, 2)

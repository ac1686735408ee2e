"""What photographs cannot tell is said to be undetermined, with the reason and the remedy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from capture.lighting import Lighting
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.estimate.identifiability import (
    Scalar,
    assess_linear,
    assess_mu,
    assess_sigma,
    lighting_degree,
)
from invrender.estimate.solution import factorize
from invrender.transport.columns import PhotoColumns
from synthetic.lights.arealight import AreaLight
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric

TEFLON = radiometric(RH01_MATERIALS["teflon"])
SOFT = AreaLight(np.array([-0.3, 0.8, 0.5]), np.array([1.5, 1.6, 1.8]), 1.2)
UNIFORM = AreaLight(np.array([-0.3, 0.8, 0.5]), np.ones(3), 1e6)


def within(photo: PhotoColumns, degrees: float) -> PhotoColumns:
    """The samples whose exitant angle is below a limit."""
    keep = photo.field.cos_exitant > np.cos(np.radians(degrees))
    return replace(photo, columns=photo.columns[:, keep], field=photo.field.where(keep))


def test_degree_of_light(bench):
    assert lighting_degree([bench.known_lighting([SOFT], [])]) == 2
    # Width 0.35: the power of degree l falls as exp(-(0.35 l)^2) (2 l + 1), 99% of it by degree 6 [RH01, section 6].
    assert lighting_degree([bench.known_lighting([bench.area_light], [])]) in (5, 6)
    assert lighting_degree([bench.known_lighting([SOFT])]) is None  # with a source: all degrees
    # The best-suited lighting counts; light from all sides has no varying part, in any rounding.
    assert lighting_degree([bench.known_lighting([UNIFORM], []), bench.known_lighting([SOFT], [])]) == 2
    assert lighting_degree([bench.known_lighting([UNIFORM], [])]) == 0
    coarse = np.ones((64, 128, 3), np.float32)
    assert lighting_degree([Lighting("white", coarse, np.zeros((0, 3)), np.zeros((0, 3)))]) == 0
    assert lighting_degree([bench.known_lighting([], [], recover_ambient=True)]) == 0


def test_roughness_is_not_claimed_in_soft_light_until_a_source_is_added(bench, few_forms):
    # Degrees up to 2 pass a lobe of 0.1 rad all but unchanged: exp(-(0.1 l)^2) takes 4% of the second
    # [RH01, eq. 20]. Grazing views are left out: there the horizon cuts the lobe, and shows its width in any light.
    metal = MicrofacetMaterial(np.full(3, 0.1), np.full(3, 0.1), None, 0.1)
    angles = np.linspace(0, 180, 6)
    soft = [within(p, 60) for p in bench.photograph(metal, angles, [SOFT], [], samples=60)]
    reasons = []
    for seed in range(2):
        noisy = bench.with_noise(soft, np.random.default_rng(seed), relative=0.02)
        found = factorize(noisy, [bench.known_lighting([SOFT], [])]).quantities["sigma"]
        assert found.status != "determined"
        assert "small, bright source" in found.remedy
        if found.status == "undetermined":
            assert found.value is found.std is None
            reasons.append(found.reason)
        else:
            assert abs(found.value[0] - metal.sigma) < 3 * found.std[0]
    assert reasons
    assert all("degrees up to 2; lobes narrower than about 0.50 rad" in why for why in reasons)

    lit = [within(p, 60) for p in bench.photograph(metal, angles, [SOFT], samples=60)]
    noisy = bench.with_noise(lit, np.random.default_rng(0), relative=0.02)
    found = factorize(noisy, [bench.known_lighting([SOFT])]).quantities["sigma"]
    assert found.status == "determined"
    assert abs(found.value[0] - metal.sigma) < 3 * found.std[0] < 0.01


def test_refractive_index_is_not_claimed_without_grazing_views(bench, rng, few_forms):
    # Highlights up to 25 degrees, where Fresnel's factor changes by less than 2% between all indices.
    angles = [-20.0, -10.0, 0.0, 10.0]
    photos = [within(p, 25) for p in bench.photograph(TEFLON, angles, samples=300)]
    solution = factorize(bench.with_noise(photos, rng), [bench.known_lighting()])
    mu = solution.quantities.get("mu")
    assert mu is None or mu.status == "undetermined" or mu.std[0] > abs(mu.value[0] - TEFLON.mu) / 3
    assert mu is None or mu.status != "determined"
    # What doesn't hang on it is determined all the same.
    for name, truth in (("kd", TEFLON.kd), ("ks", TEFLON.ks)):
        found = solution.quantities[name]
        assert found.status == "determined"
        assert (np.abs(found.value - truth) < 4 * found.std).all()


# (std, fragility) that leave a number of 0.5 or more, with a prior of 0.8 or more, undetermined: 0.005 of the
# model's radiance moves it by more than a quarter of its value; NaN is no knowledge.
HOPELESS = [(0.6, 0.0), (0.01, 60.0), (np.nan, 0.0), (0.01, np.nan)]


@pytest.mark.parametrize(("std", "fragility"), HOPELESS)
def test_wide_posterior_leaves_mu_undetermined(std: float, fragility: float, bench):
    photo = bench.photograph(TEFLON, [0.0], samples=50)[0]
    found = assess_mu(Scalar(1.8, std, fragility), [photo.field], 0.11)
    assert (found.status, found.value, found.std) == ("undetermined", None, None)
    assert f"{np.degrees(np.arccos(photo.field.cos_exitant.min())):.0f} degrees" in found.reason
    assert "grazing" in found.remedy


@pytest.mark.parametrize(("std", "fragility"), [(0.13, 0.0), (0.001, 20.0), (np.nan, 0.0), (0.001, np.nan)])
def test_wide_posterior_leaves_sigma_undetermined(std: float, fragility: float, bench):
    found = assess_sigma(
        Scalar(0.12, std, fragility), lighting_degree([bench.known_lighting([SOFT], [])]), 0.11
    )
    assert (found.status, found.value, found.std) == ("undetermined", None, None)
    assert "degrees up to 2" in found.reason
    assert "small, bright source" in found.remedy
    # Where the light is good, the highlight must be too faint.
    found = assess_sigma(Scalar(0.12, std, fragility), lighting_degree([bench.known_lighting([SOFT])]), 0.11)
    assert "specular share is only 0.110" in found.reason
    assert "highlight" in found.remedy


def test_a_fit_at_the_edge_of_its_range_is_no_value(bench):
    photo = bench.photograph(TEFLON, [0.0], samples=50)[0]
    for value in (*MU_RANGE, np.nan):
        found = assess_mu(Scalar(value, 0.01, 0.0), [photo.field], 0.11)
        assert found.status == "undetermined"
        assert "edge of its range, 1.1 to 4" in found.reason
    for value in (*SIGMA_RANGE, np.nan):
        found = assess_sigma(Scalar(value, 0.001, 0.0), lighting_degree([bench.known_lighting()]), 0.11)
        assert found.status == "undetermined"
        assert "edge of its range, 0.005 to 0.7" in found.reason


def test_a_tenth_of_the_value_parts_weak_from_determined(bench):
    photo = bench.photograph(TEFLON, [0.0], samples=50)[0]
    for std, status in [(0.17, "determined"), (0.19, "weak")]:
        mu = assess_mu(Scalar(1.8, std, 0.0), [photo.field], 0.11)
        sigma = assess_sigma(Scalar(0.18, std / 10, 0.0), lighting_degree([bench.known_lighting()]), 0.11)
        for found, value, deviation in ((mu, 1.8, std), (sigma, 0.18, std / 10)):
            assert (found.status, found.value[0], found.std[0]) == (status, value, deviation)
            assert bool(found.reason) == bool(found.remedy) == (status == "weak")


@pytest.mark.parametrize(
    ("std", "status"), [(0.04, "determined"), (0.1, "weak"), (0.6, "undetermined"), (np.nan, "undetermined")]
)
def test_kd_and_ks_are_judged_against_their_sum(std: float, status: str):
    value = np.array([0.5, 0.5, 0.6])
    found = assess_linear(value, np.array([0.01, 0.01, std]), np.ones(3), "Kd")
    assert found.status == status
    assert (found.value is None) == (status == "undetermined")
    assert bool(found.reason) == bool(found.remedy) == (status != "determined")


def test_an_index_beyond_glass_is_told_to_be_a_metals(bench):
    photo = bench.photograph(TEFLON, [0.0], samples=50)[0]
    # Diamond's; and what copper comes out as.
    for value, status in [(2.42, "determined"), (3.76, "weak")]:
        found = assess_mu(Scalar(value, 0.05, 0.0), [photo.field], 0.11)
        assert (found.status, found.value[0], found.std[0]) == (status, value, 0.05)
        assert ("no refractive index" in found.reason) == ("Ks" in found.remedy) == (status == "weak")
    # Where photographs tell none, that is all that is said.
    assert "grazing" in assess_mu(Scalar(3.76, 3.0, 0.0), [photo.field], 0.11).reason

"""What photographs cannot tell is said to be undetermined, with the reason and the remedy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from capture.lighting import Lighting
from invrender.model.columns import PhotoColumns
from invrender.model.fresnel import MU_RANGE
from invrender.model.microfacet import SIGMA_RANGE
from invrender.solve.factorize import factorize
from invrender.solve.identifiability import assess_linear, assess_mu, assess_sigma, lighting_degree
from synthetic.lighting import AreaLight
from synthetic.materials import RH01_MATERIALS, radiometric

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
    coarse = np.ones((16, 32, 3), np.float32)
    assert lighting_degree([Lighting("white", coarse, np.zeros((0, 3)), np.zeros((0, 3)))]) == 0
    assert lighting_degree([bench.known_lighting([], [], recover_ambient=True)]) == 0


def test_roughness_is_undetermined_in_soft_light_until_a_source_is_added(bench, rng):
    # Degrees up to 2 pass a lobe of 0.12 rad, which takes away (0.12 l)^2 of them, 6% of an eleventh; grazing views,
    # where the horizon cuts the lobe, are left out.
    angles = np.linspace(0, 180, 6)
    soft = [within(p, 60) for p in bench.photograph(TEFLON, angles, [SOFT], [], samples=60)]
    noisy = bench.with_noise(soft, rng, relative=0.03)
    found = factorize(noisy, [bench.known_lighting([SOFT], [])]).quantities["sigma"]
    assert (found.status, found.value, found.std) == ("undetermined", None, None)
    assert "degrees up to 2" in found.reason
    assert "lobes narrower than about 0.50 rad" in found.reason
    assert "small, bright source" in found.remedy

    lit = [within(p, 60) for p in bench.photograph(TEFLON, angles, [SOFT], samples=60)]
    noisy = bench.with_noise(lit, rng, relative=0.03)
    found = factorize(noisy, [bench.known_lighting([SOFT])]).quantities["sigma"]
    assert found.status == "determined"
    assert abs(found.value[0] - TEFLON.sigma) < 3 * found.std[0] < 0.02


def test_refractive_index_is_not_claimed_without_grazing_views(bench, rng):
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


def test_wide_posterior_or_edge_of_the_range_leaves_mu_undetermined(bench):
    photo = bench.photograph(TEFLON, [0.0], samples=50)[0]
    steepest = f"{np.degrees(np.arccos(photo.field.cos_exitant.min())):.0f} degrees"
    for value, std, what in [
        (1.8, 0.6, "known to +-0.60 only"),
        (MU_RANGE[0], 0.01, "edge of the range"),
        (MU_RANGE[1], 0.01, "edge of the range"),
        (np.nan, 0.01, "edge of the range"),
        (1.8, np.nan, "only"),
    ]:
        found = assess_mu(value, std, [photo], 0.11)
        assert (found.status, found.value, found.std) == ("undetermined", None, None)
        assert what in found.reason
        assert steepest in found.reason
        assert "grazing" in found.remedy
    assert assess_mu(1.8, 0.3, [photo], 0.11).status == "weak"
    sure = assess_mu(1.8, 0.1, [photo], 0.11)
    assert (sure.status, sure.value[0], sure.std[0], sure.reason, sure.remedy) == ("determined", 1.8, 0.1, "", "")


def test_wide_posterior_or_edge_of_the_range_leaves_sigma_undetermined(bench):
    soft, sharp = bench.known_lighting([SOFT], []), bench.known_lighting([SOFT])
    for value, std, what in [
        (0.12, 0.13, "known to +-0.13 only"),  # as wide as its value
        (0.5, 0.15, "known to +-0.15 only"),  # as wide as half of the prior, 0.2 / 2
        (SIGMA_RANGE[0], 0.001, "edge of the range"),
        (SIGMA_RANGE[1], 0.001, "edge of the range"),
        (0.12, np.nan, "only"),
    ]:
        found = assess_sigma(value, std, [soft], 0.11)
        assert (found.status, found.value, found.std) == ("undetermined", None, None)
        assert what in found.reason
        assert "degrees up to 2" in found.reason
        found = assess_sigma(value, std, [sharp], 0.11)
        assert "specular share is only 0.110" in found.reason
        assert "highlight" in found.remedy
    assert assess_sigma(0.12, 0.02, [soft], 0.11).status == "weak"
    assert assess_sigma(0.12, 0.01, [soft], 0.11).status == "determined"


@pytest.mark.parametrize(
    ("std", "status"), [(0.04, "determined"), (0.1, "weak"), (0.6, "undetermined"), (np.nan, "undetermined")]
)
def test_kd_and_ks_are_judged_against_their_sum(std: float, status: str):
    value = np.array([0.5, 0.5, 0.6])
    found = assess_linear(value, np.array([0.01, 0.01, std]), np.ones(3), "Kd")
    assert found.status == status
    assert (found.value is None) == (status == "undetermined")
    assert bool(found.reason) == bool(found.remedy) == (status != "determined")

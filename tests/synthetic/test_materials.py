"""The microfacet BRDF against values that can be had by hand, and its validity limits."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from synthetic.materials.fresnel import fresnel_dielectric
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric

UP = np.array([0.0, 0.0, 1.0])
ROUNDING = 1e-12


def tilted(angle: float, azimuth: float = 0.0) -> np.ndarray:
    return np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])


def test_fresnel_at_normal_incidence_brewsters_angle_and_grazing() -> None:
    mu = 1.5
    assert_allclose(fresnel_dielectric(mu, 1.0), 0.04, rtol=ROUNDING)  # ((mu - 1) / (mu + 1))^2
    # At Brewster's angle the parallel part vanishes; the other is ((mu^2 - 1) / (mu^2 + 1))^2.
    brewster = np.cos(np.arctan(mu))
    assert_allclose(fresnel_dielectric(mu, brewster), ((mu**2 - 1) / (mu**2 + 1)) ** 2 / 2, rtol=ROUNDING)
    assert_allclose(fresnel_dielectric(mu, 0.0), 1.0, rtol=ROUNDING)


def test_lobe_peaks_at_the_mirror_direction_with_the_value_of_the_equation() -> None:
    material = MicrofacetMaterial(np.zeros(3), np.array([0.1, 0.2, 0.3]), None, 0.12)
    angle = 0.7
    # theta_h = 0, so rho = Ks / (pi sigma^2) / (4 cos^2).
    expected = material.ks / (np.pi * 0.12**2) / (4 * np.cos(angle) ** 2)
    # arccos near 1 loses half the digits: theta_h is zero to 1e-8 only.
    assert_allclose(material.evaluate(UP, tilted(angle), tilted(-angle)), expected, rtol=1e-10)


def test_lobe_falls_to_1_over_e_where_the_half_vector_tilts_by_sigma() -> None:
    material = MicrofacetMaterial(np.zeros(3), np.ones(3), None, 0.2)
    peak = material.evaluate(UP, UP, UP)
    # Viewer at the normal, light at 2 sigma: theta_h = sigma, and 1 / cos_i remains.
    tilt = material.evaluate(UP, tilted(0.4), UP)
    assert_allclose(tilt / peak * np.cos(0.4), np.full(3, np.exp(-1)), rtol=1e-10)


def test_fresnel_is_taken_at_the_viewer() -> None:
    material = MicrofacetMaterial(np.zeros(3), np.ones(3), 1.78, 0.12)
    without = MicrofacetMaterial(np.zeros(3), np.ones(3), None, 0.12)
    light, viewer = tilted(0.9, 0.3), tilted(-1.2)
    ratio = material.evaluate(UP, light, viewer) / without.evaluate(UP, light, viewer)
    expected = fresnel_dielectric(1.78, np.cos(1.2)) / fresnel_dielectric(1.78, 1.0)
    assert_allclose(ratio, np.full(3, expected), rtol=ROUNDING)


def test_without_fresnel_it_is_reciprocal(rng: np.random.Generator) -> None:
    material = radiometric(RH01_MATERIALS["bronze"])
    angles = rng.uniform(0, np.pi / 2, (2, 200))
    azimuths = rng.uniform(0, 2 * np.pi, (2, 200))
    a, b = (tilted(t, p).T for t, p in zip(angles, azimuths, strict=True))
    assert_allclose(material.evaluate(UP, a, b), material.evaluate(UP, b, a), rtol=1e-9)


def test_nothing_is_reflected_below_the_horizon() -> None:
    material = radiometric(RH01_MATERIALS["teflon"])
    below = tilted(1.7)
    for light, viewer in ((below, UP), (UP, below), (-UP, UP), (UP, -UP), (below, below)):
        assert (material.evaluate(UP, light, viewer) == 0).all()


def test_directions_broadcast() -> None:
    material = radiometric(RH01_MATERIALS["painted"])
    lights = np.stack([tilted(t) for t in (0.1, 0.5, 1.0)])
    viewers = np.stack([tilted(-t) for t in (0.2, 0.9)])
    grid = material.evaluate(UP, lights[:, None], viewers[None])
    assert grid.shape == (3, 2, 3)
    assert_allclose(grid[2, 1], material.evaluate(UP, lights[2], viewers[1]), rtol=ROUNDING)
    assert material.evaluate(np.empty((0, 3)), UP, UP).shape == (0, 3)


@pytest.mark.parametrize("name", RH01_MATERIALS)
def test_rows_of_fig_11_are_normalised_and_scale_to_possible_materials(name: str) -> None:
    row = RH01_MATERIALS[name]
    sums = np.array(row.kd) + np.array(row.ks)
    assert_allclose(sums.max(), 1.0, atol=0.005)  # printed to two digits
    material = radiometric(row)
    # The lobe alone returns about Ks at normal exitance, so pi Kd + Ks bounds what comes back.
    assert (np.pi * material.kd + material.ks < 1).all()
    assert_allclose(material.kd * np.array(row.ks), material.ks * np.array(row.kd), rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kd": np.full(3, 0.89)}, r"albedo pi kd of 2\.80"),
        ({"kd": np.array([0.1, -0.1, 0.1])}, "kd is"),
        ({"ks": np.array([0.1, np.nan, 0.1])}, "ks is"),
        ({"mu": 1.0}, "mu is 1"),
        ({"sigma": 0.0}, "sigma is 0"),
        ({"sigma": np.nan}, "sigma is nan"),
    ],
)
def test_impossible_materials_are_refused_by_name(change: dict[str, object], message: str) -> None:
    keys = {"kd": np.full(3, 0.2), "ks": np.full(3, 0.1), "mu": 1.5, "sigma": 0.1} | change
    with pytest.raises(ValueError, match=message):
        MicrofacetMaterial(**keys)  # type: ignore[arg-type]

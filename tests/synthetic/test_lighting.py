"""Lights with a formula: their energy by degree, and their lat-long maps."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import latlong_directions, latlong_solid_angles
from synthetic.demo import demo_staging
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map
from synthetic.lights.sources import DirectionalSource

WIDE = AreaLight(np.array([0.3, -0.5, 0.8]), np.array([1.0, 2.0, 3.0]), 0.35)


def zonal_energies(light: AreaLight, l_max: int) -> np.ndarray:
    """Share of the light's energy in each degree: zonal coefficients by Gauss-Legendre in the cosine."""
    node, weight = np.polynomial.legendre.leggauss(400)
    profile = light.profile(node)
    legendre = np.polynomial.legendre.legvander(node, l_max)
    norm = (2 * np.arange(l_max + 1) + 1) / (4 * np.pi)
    coefficients = 2 * np.pi * np.sqrt(norm) * (legendre * (weight * profile)[:, None]).sum(axis=0)
    return coefficients**2 / (2 * np.pi * (weight * profile**2).sum())


def test_demonstration_light_has_99_percent_of_its_energy_up_to_degree_6() -> None:
    (light,) = demo_staging().scene.shots[0].illumination.extended
    assert isinstance(light, AreaLight)
    energies = zonal_energies(light, 60)
    assert_allclose(energies.sum(), 1.0, rtol=1e-9)  # Parseval: all of it is found by degree 60
    assert energies[:7].sum() >= 0.99  # RH01, section 6: "99% of its energy in low-frequency modes"


def test_map_holds_the_lights_power_and_points_where_the_light_is() -> None:
    height = 64
    radiance = latlong_map([WIDE], height)
    assert radiance.shape == (height, 2 * height, 3)
    assert radiance.dtype == np.float32
    solid = latlong_solid_angles(height)[..., None]
    # The integral of exp((c - 1) / w^2) over the sphere is 2 pi w^2 (1 - exp(-2 / w^2)).
    power = 2 * np.pi * WIDE.width_rad**2 * (1 - np.exp(-2 / WIDE.width_rad**2)) * WIDE.radiance
    # Pixel means of 3x3 midpoints at a spacing of 1 degree: 1e-4.
    assert_allclose((radiance * solid).sum(axis=(0, 1)), power, rtol=1e-4)
    centroid = (latlong_directions(height) * solid * radiance[..., :1]).sum(axis=(0, 1))
    assert_allclose(centroid / np.linalg.norm(centroid), WIDE.axis, atol=1e-3)  # 2% of a pixel


def test_maps_of_lights_add_up() -> None:
    other = AreaLight(np.array([-1.0, 0.0, 0.1]), np.ones(3), 0.5)
    together = latlong_map([WIDE, other], 16)
    assert_allclose(together, latlong_map([WIDE], 16) + latlong_map([other], 16), rtol=1e-6)  # float32


def test_directions_are_normalised_and_nonsense_is_refused() -> None:
    source = DirectionalSource(np.array([0.0, 3.0, 4.0]), np.ones(3))
    assert_allclose(source.direction, [0, 0.6, 0.8], rtol=1e-15)
    with pytest.raises(ValueError, match="direction of a source"):
        DirectionalSource(np.zeros(3), np.ones(3))
    with pytest.raises(ValueError, match="radiance of an area light"):
        AreaLight(np.ones(3), np.array([1.0, -1.0, 1.0]), 0.3)
    with pytest.raises(ValueError, match=r"width .* is 0"):
        AreaLight(np.ones(3), np.ones(3), 0.0)

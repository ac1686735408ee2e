"""The base under an interface: radiance against sums over directions of light, and what is let through on average."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import latlong_directions, latlong_solid_angles
from invrender.brdf.lobes import GGX_FORM, PLASTICS
from invrender.brdf.richer import COATED
from invrender.transport.diffuse_base import base_columns, base_transfer, base_weights
from invrender.transport.transfer import LightElement
from synthetic.materials.facets import GGXSlopes
from synthetic.materials.plastic import Plastic
from synthetic.materials.smith import SmithMaterial

FORM = PLASTICS[GGX_FORM]
LAMP = np.array([0.6, 0.0, 0.8])
HEIGHT = 128
# A broad window in the sky above a dim room.
SKY = (0.2 + np.exp(8 * (latlong_directions(HEIGHT) @ np.array([0.36, 0.48, 0.8]) - 1)))[..., None]


@pytest.fixture
def pairs(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals and views (60, 3), up to 85 degrees apart."""
    normals = rng.standard_normal((60, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    across = np.cross(normals, rng.standard_normal((60, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.radians(rng.uniform(0, 85, (60, 1)))
    return normals, np.cos(angle) * normals + np.sin(angle) * across


def summed(mu: float, normals: np.ndarray, views: np.ndarray) -> np.ndarray:
    """Radiance (m,) of a unit base alone under the sky and the lamp, direction by direction."""
    material = Plastic(SmithMaterial(np.ones(3), np.zeros(3), mu, GGXSlopes(0.1, 0.1)))
    directions = latlong_directions(HEIGHT).reshape(-1, 3)
    light = SKY[..., 0].ravel() * latlong_solid_angles(HEIGHT).repeat(2 * HEIGHT)
    result = np.empty(len(normals))
    for k, (normal, view) in enumerate(zip(normals, views, strict=True)):
        shown = material.evaluate(normal, directions, view)[:, 0] * np.maximum(directions @ normal, 0)
        lit = material.evaluate(normal, LAMP, view)[0] * max(LAMP @ normal, 0)
        result[k] = shown @ light + lit
    return result


@pytest.mark.parametrize("mu", [1.2, 1.5, 2.5])
def test_radiance_is_the_sum_over_directions_of_light(mu: float, pairs) -> None:
    light = LightElement("known", LAMP[None], np.ones((1, 1)), SKY.astype(np.float32))
    found = base_transfer(FORM, mu, light, *pairs, None)[:, 0]
    # Pixels of 1.4 degrees that a normal's horizon cuts leave 2e-4.
    assert_allclose(found, summed(mu, *pairs), rtol=1e-3)
    in_parts = base_columns(FORM, light, *pairs, None)[:, :, 0] @ base_weights(FORM, mu)
    # What the basis leaves of t, 5e-4 on either way through.
    assert_allclose(in_parts, found, atol=1e-3 * found.max())


def test_under_light_from_all_sides_the_albedo_is_pi_kd(pairs) -> None:
    uniform = LightElement("ambient", np.zeros((0, 3)), np.zeros((0, 1)), uniform=1.0)
    cos = np.sqrt((np.arange(400) + 0.5) / 400)  # evenly spread over projected solid angles
    views = np.stack([np.sqrt(1 - cos**2), np.zeros(400), cos], axis=-1)
    normals = np.broadcast_to([0.0, 0.0, 1.0], views.shape)
    for mu in (1.3, 1.5, 3.0):
        sent = base_transfer(FORM, mu, uniform, normals, views, None)[:, 0]
        # Midpoints of 400 parts: the last part, at grazing, is told to a hundredth of its own.
        assert_allclose(sent.mean(), np.pi, rtol=2e-4)
        assert sent[0] < 0.5 * sent[-1]


@pytest.mark.parametrize("coat", [0.3, 1.0])
def test_a_coated_base_is_the_sum_over_directions_of_light(coat: float, pairs) -> None:
    normals, views = pairs
    form = COATED[GGX_FORM].with_numbers({"coat": coat})
    light = LightElement("known", LAMP[None], np.ones((1, 1)), SKY.astype(np.float32))
    found = base_transfer(form, None, light, normals, views, None)[:, 0]

    def through(cos: np.ndarray) -> np.ndarray:
        # Shirley's factor over its mean per projected solid angle, which is 1 - coat / 21.
        return (1 - coat * (1 - np.clip(cos, 0, 1)) ** 5) / (1 - coat / 21)

    directions = latlong_directions(HEIGHT).reshape(-1, 3)
    arriving = SKY[..., 0].ravel() * latlong_solid_angles(HEIGHT).repeat(2 * HEIGHT)
    cos = np.maximum(normals @ directions.T, 0)
    lit = np.maximum(normals @ LAMP, 0)
    received = (cos * through(cos)) @ arriving + lit * through(lit)
    expected = received * through((normals * views).sum(axis=1))
    # Pixels of 1.4 degrees that a normal's horizon cuts leave 2e-4.
    assert_allclose(found, expected, rtol=1e-3)
    # Three columns hold any strength exactly.
    in_parts = base_columns(form, light, normals, views, None)[:, :, 0] @ base_weights(form, None)
    assert_allclose(in_parts, found, rtol=1e-6)

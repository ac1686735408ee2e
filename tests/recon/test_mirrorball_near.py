"""How far lamps are, by views of a mirror ball from several places, against balls of light that are ray traced."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from recon.mirrorball.light import ball_lighting, lighting_of_ball
from recon.mirrorball.view import BallView

from .test_mirrorball_views import LAMP_AXIS, LAMP_DEG, RADIUS, Bulb, camera_at, pair, room, viewed

__all__ = ["pair"]

Floats = NDArray[np.float64]


def bulb_at(place: Floats, irradiance: float) -> Bulb:
    """A ball of light of 2.5 degrees' radius, and its irradiance, as the mirror ball's centre sees them."""
    far = np.linalg.norm(place)
    radius = far * np.sin(np.radians(LAMP_DEG))
    radiance = irradiance * far**2 / (np.pi * radius**2)

    def shown(points: Floats, directions: Floats) -> Floats:
        beside = np.linalg.norm(np.cross(place - points, directions), axis=1)
        ahead = ((place - points) * directions).sum(axis=1) > 0
        return ((beside < radius) & ahead)[:, None] * np.full(3, radiance)

    return shown


@pytest.mark.parametrize("radii", [5.0, 10.0, 20.0])
def test_views_from_two_places_tell_how_far_a_lamp_is(radii: float) -> None:
    place = radii * RADIUS * LAMP_AXIS
    views = [
        viewed(camera, room, name, bulb_at(place, 0.4))
        for name, camera in (("first", camera_at(0, 10)), ("second", camera_at(80, -5)))
    ]
    found = ball_lighting(views, "lamp", height=16)
    lighting = lighting_of_ball(found, ())
    assert found.warnings == ()
    assert len(found.sources) == 1
    assert_allclose(found.centre, 0, atol=0.002 * RADIUS)
    (lamp,) = lighting.places
    assert lamp is not None
    source, true = found.sources[0], 1 / (radii * RADIUS)
    # Poses are doubted by 0.1 degrees, and these are exact.
    assert abs(source.closeness - true) < 2 * source.closeness_std < 0.3 * true
    assert source.direction @ LAMP_AXIS > np.cos(np.radians(3 * source.direction_std_deg))
    # What the pixels' grid leaves, as for distant lamps; taken for distant, the nearest reads 16% too much.
    assert_allclose(source.irradiance, 0.4, rtol=0.02)


def test_a_distant_lamp_is_not_near(pair: tuple[BallView, BallView]) -> None:
    assert lighting_of_ball(ball_lighting(pair, "lamp", height=16), ()).closeness is None


def test_views_from_one_place_tell_no_distance() -> None:
    """The second is the first turned about its own place, as a camera on a tripod that is turned a little."""
    place, first = 5 * RADIUS * LAMP_AXIS, camera_at(0, 10)
    turned = np.eye(4)
    turned[:3, :3] = [[np.cos(0.02), 0, np.sin(0.02)], [0, 1, 0], [-np.sin(0.02), 0, np.cos(0.02)]]
    views = [
        viewed(camera, room, name, bulb_at(place, 0.4))
        for name, camera in (("first", first), ("second", first.posed(turned @ first.world_to_camera)))
    ]
    found = ball_lighting(views, "lamp", height=16)
    assert found.centre is None
    assert found.sources[0].closeness == 0

"""Where photographs are taken from: gantries, turntables, single views, from tables to poses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.scene import Shot
from synthetic.scenes.scenefile import SceneFile
from synthetic.scenes.views import seen_from, shots, towards

Floats = NDArray[np.float64]

LAB = Illumination("lab", (AreaLight(np.array([1.0, 2, 3]), np.ones(3), 0.3),))
LAMP = Illumination("lamp", (), (PointSource(np.array([0.3, 0, 0.2]), np.ones(3)),))


def taken(**tables: object) -> tuple[Shot, ...]:
    """Photographs of a scene with these tables."""
    whole = {
        "format": 1,
        "name": "views",
        "object": {"shape": "sphere", "centre": (0.01, 0.02, 0.03)},
        "material": {"model": "lambertian", "kd": 0.1},
        "lighting": ({"name": "lab", "area": ({"azimuth_deg": 0.0, "radiance": 1.0},)},),
        "camera": {"focal_px": 500.0, "width": 64, "height": 48},
    }
    if "lamp" in str(tables):
        lamp = {"azimuth_deg": 0.0, "irradiance": 1.0, "distance": 1.0}
        whole["lighting"] = (*whole["lighting"], {"name": "lamp", "lamp": (lamp,)})  # type: ignore[misc]
    return shots(SceneFile.model_validate(whole | tables), {"lab": LAB, "lamp": LAMP})


def test_angles_are_azimuths_from_x_to_y_and_elevations() -> None:
    assert_allclose(towards(0, 0), [1, 0, 0], atol=1e-15)
    assert_allclose(towards(90, 0), [0, 1, 0], atol=1e-15)
    assert_allclose(towards(-135, 45), [-0.5, -0.5, np.sqrt(0.5)], atol=1e-15)
    assert_allclose(towards(33, -90), [0, 0, -1], atol=1e-15)


def test_a_camera_in_the_middle_of_its_picture_looks_at_the_target_upright() -> None:
    target = np.array([0.1, -0.2, 0.3])
    (shot,) = taken(view=({"azimuth_deg": 0.0},))
    camera = shot.camera.posed(seen_from(40, 25, 0.5, target))
    assert_allclose(camera.centre, target + 0.5 * towards(40, 25), atol=1e-12)  # rounding
    above, here = camera.project(target + np.array([[0, 0, 0.01], [0, 0, 0]]))
    assert_allclose(here, [32, 24], atol=1e-9)
    assert_allclose(above[0], 32, atol=1e-9)
    assert above[1] < 24


def test_a_view_looks_at_the_object_from_its_angles_or_stands_where_it_is_told() -> None:
    pose = np.array(seen_from(10, 20, 0.3, np.zeros(3)))
    rows = tuple(map(tuple, pose.tolist()))
    by_angles, by_pose = taken(
        view=(
            {"azimuth_deg": 70.0, "elevation_deg": 15.0, "distance": 0.4},
            {"world_to_camera": rows, "lighting": "lamp", "held_out": True},
        )
    )
    assert_allclose(by_angles.camera.project(np.array([[0.01, 0.02, 0.03]])), [[32, 24]], atol=1e-9)
    assert_allclose(by_angles.camera.centre, [0.01, 0.02, 0.03] + 0.4 * towards(70, 15), atol=1e-12)
    assert (by_angles.illumination, by_angles.held_out) == (LAB, False)
    assert_allclose(by_pose.camera.world_to_camera, pose, atol=1e-15)
    assert (by_pose.illumination, by_pose.held_out) == (LAMP, True)


def test_a_gantry_goes_along_its_arc_in_equal_steps() -> None:
    arc = {"radius": 0.5, "start_deg": 30.0, "step_deg": -20.0, "photos": 4, "held_out": (1, 3)}
    gantry = taken(gantry=arc)
    for index, shot in enumerate(gantry):
        # The arc is about the origin, not about the object.
        assert_allclose(shot.camera.centre, 0.5 * towards(30 - 20 * index, 0), atol=1e-12)
        assert_allclose(shot.camera.project(np.zeros((1, 3))), [[32, 24]], atol=1e-9)
        assert shot.illumination is LAB
    assert [shot.held_out for shot in gantry] == [False, True, False, True]


def test_a_gantry_comes_before_a_turntable_and_single_views() -> None:
    both = taken(
        gantry={"photos": 2},
        turntable={"photos": 3},
        view=({"azimuth_deg": 1.0, "lighting": "lamp"},),
    )
    names = [shot.illumination.name for shot in both]
    assert names == ["lab", "lab", "lab-000", "lab-001", "lab-002", "lamp"]


@pytest.mark.parametrize("elevation", [0.0, 35.0])
def test_on_a_turntable_the_room_stays_where_the_camera_is(elevation: float) -> None:
    table = {"photos": 5, "step_deg": 50.0, "azimuth_deg": 25.0, "elevation_deg": elevation, "distance": 0.4}
    turntable = taken(turntable=table)
    room = turntable[0]
    assert_allclose(room.camera.centre, 0.4 * towards(25, elevation), atol=1e-12)
    seen = [room.camera.world_to_camera[:3, :3] @ LAB.extended[0].axis for _ in turntable]  # type: ignore[attr-defined]
    for index, shot in enumerate(turntable):
        # Lights and camera keep their places to each other; the object's points turn counter-clockwise about +Z.
        (light,) = shot.illumination.extended
        assert isinstance(light, AreaLight)
        assert_allclose(shot.camera.world_to_camera[:3, :3] @ light.axis, seen[index], atol=1e-12)
        point = np.array([[0.01, 0.0, 0.02]])
        turn = np.radians(50 * index)
        turned = np.array([[0.01 * np.cos(turn), 0.01 * np.sin(turn), 0.02]])
        assert_allclose(shot.camera.project(point), room.camera.project(turned), atol=1e-9)


def test_the_cameras_numbers_are_the_tables() -> None:
    (shot,) = taken(
        view=({"azimuth_deg": 0.0},),
        camera={
            "focal_px": 500.0,
            "width": 64,
            "height": 48,
            "principal_point": (31.0, 25.5),
            "distortion": (0.1, 0.2, 0.3, 0.4),
        },
    )
    assert shot.camera.model == "OPENCV"
    assert shot.camera.params.tolist() == [500, 500, 31, 25.5, 0.1, 0.2, 0.3, 0.4]
    plain = taken(view=({"azimuth_deg": 0.0},))[0].camera
    assert (plain.width, plain.height) == (64, 48)
    assert plain.params.tolist() == [500, 500, 32, 24, 0, 0, 0, 0]


def test_sources_of_a_turntable_turn_too() -> None:
    light = Illumination("lab", (), (DirectionalSource(np.array([1.0, 0, 0]), np.ones(3)),))
    turned = light.turned(np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), "lab-001")
    (source,) = turned.sources
    assert isinstance(source, DirectionalSource)
    assert_allclose(source.direction, [0, -1, 0], atol=1e-15)

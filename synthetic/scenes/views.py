"""Where photographs are taken from, and under which light: gantries, turntables, single views."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture.arc.gantry import Arc, look_at
from capture.camera import Camera
from synthetic.lights.illumination import Illumination
from synthetic.scene import Shot
from synthetic.scenes.scenefile import SceneFile
from synthetic.scenes.schema import SceneCamera, SceneGantry, TurntableTable, ViewTable

Floats = NDArray[np.float64]


def shots(scene: SceneFile, lights: Mapping[str, Illumination]) -> tuple[Shot, ...]:
    """All photographs of a scene file: the gantry's, the turntable's, then single views."""
    camera, target = camera_of(scene.camera), np.array(scene.object.centre)
    taken: list[Shot] = []
    if scene.gantry is not None:
        taken += _on_arc(scene.gantry, camera, _light(scene.gantry.lighting, lights))
    if scene.turntable is not None:
        taken += _on_turntable(scene.turntable, camera, _light(scene.turntable.lighting, lights))
    taken += [_single(view, camera, target, _light(view.lighting, lights)) for view in scene.view]
    return tuple(taken)


def camera_of(table: SceneCamera) -> Camera:
    """The camera, not posed yet."""
    centre = table.principal_point or (table.width / 2, table.height / 2)
    params = np.array([table.focal_px, table.focal_px, *centre, *table.distortion])
    return Camera("OPENCV", params, table.width, table.height, np.eye(4))


def towards(azimuth_deg: float, elevation_deg: float) -> Floats:
    """The unit direction (3,) at an azimuth from +X towards +Y and an elevation above the horizon, degrees."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def seen_from(azimuth_deg: float, elevation_deg: float, distance: float, target: Floats) -> Floats:
    """The 4x4 world_to_camera of a camera so many metres from a target (3,), looking at it, +Z up in its picture."""
    return look_at(target + distance * towards(azimuth_deg, elevation_deg), target, [0, 0, 1])


def _light(name: str | None, lights: Mapping[str, Illumination]) -> Illumination:
    return lights[name] if name is not None else next(iter(lights.values()))


def _on_arc(table: SceneGantry, camera: Camera, light: Illumination) -> list[Shot]:
    arc = Arc(np.array(table.centre), np.array(table.axis), table.radius, np.array(table.start))
    angles = np.radians(table.start_deg + table.step_deg * np.arange(table.photos))
    return [
        Shot(camera.posed(arc.pose(angle)), light, index in table.held_out)
        for index, angle in enumerate(angles)
    ]


def _on_turntable(table: TurntableTable, camera: Camera, light: Illumination) -> list[Shot]:
    """In the object's frame camera and lights go round it: each photograph has a lighting of its own."""
    room_to_camera = seen_from(table.azimuth_deg, table.elevation_deg, table.distance, np.zeros(3))
    taken = []
    for index in range(table.photos):
        object_to_room = Rotation.from_euler("z", table.step_deg * index, degrees=True).as_matrix()
        pose = room_to_camera.copy()
        pose[:3, :3] = pose[:3, :3] @ object_to_room
        turned = light.turned(object_to_room.T, f"{light.name}-{index:03d}")
        taken.append(Shot(camera.posed(pose), turned, index in table.held_out))
    return taken


def _single(table: ViewTable, camera: Camera, target: Floats, light: Illumination) -> Shot:
    if table.world_to_camera is not None:
        pose = np.array(table.world_to_camera)
    else:
        pose = seen_from(table.azimuth_deg or 0.0, table.elevation_deg, table.distance, target)
    return Shot(camera.posed(pose), light, table.held_out)

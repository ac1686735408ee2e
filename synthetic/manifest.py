"""The text of photoset.toml, as a photographer would write it about a photo set."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from synthetic.given import given_camera, given_light
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import PointSource
from synthetic.materials.texture import Textured
from synthetic.shapes.ball import Ball
from synthetic.staging import Staging

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Photograph:
    """One written photograph. shot : which of the scene's it shows. exposure_s : None if the manifest needs none."""

    shot: int
    file: str
    mask: str
    exposure_s: float | None


@dataclass(frozen=True, eq=False)
class WrittenSet:
    """What was written of a photo set, as the manifest states it.

    maps : files of the lightings' maps, by the lighting's name. balls : the lightings' `mirror_ball` tables.
    poses : world_to_camera (4, 4) of each shot as handed over. mesh_to_world : (4, 4) likewise, None for spheres.
    radiometry : the keys of [radiometry].
    """

    maps: dict[str, str]
    balls: dict[str, dict[str, Any]]
    poses: list[Floats]
    mesh_to_world: Floats | None
    radiometry: dict[str, Any]
    photographs: list[Photograph]


def manifest_text(staging: Staging, written: WrittenSet, mesh: str) -> str:
    """photoset.toml. mesh : the mesh's file."""
    scene = staging.scene
    first = given_camera(scene.shots[0].camera, staging)
    stated = staging.uncertainty.model_dump(exclude_defaults=True)
    tables = [
        _table("", format=1, name=scene.name),
        _table("[camera]", **intrinsics(first)),
        _table("[radiometry]", **written.radiometry),
        _table("[object]", **_object(staging, written, mesh)),
        *([_table("[uncertainty]", **stated)] if stated else []),
        *(_table("[[lighting]]", **_lighting(light, staging, written)) for light in scene.illuminations),
    ]
    several = len(scene.illuminations) > 1
    for photograph in written.photographs:
        shot = scene.shots[photograph.shot]
        keys: dict[str, Any] = {"file": photograph.file, "mask": photograph.mask}
        if several:
            keys["lighting"] = shot.illumination.name
        if photograph.exposure_s is not None:
            keys["exposure_s"] = photograph.exposure_s
        if shot.held_out:
            keys["held_out"] = True
        keys["world_to_camera"] = written.poses[photograph.shot].tolist()
        own = intrinsics(given_camera(shot.camera, staging))
        if own != intrinsics(first):
            keys["camera"] = own
        tables.append(_table("[[photo]]", **keys))
    return "\n".join(tables)


def intrinsics(camera: Camera) -> dict[str, Any]:
    """The keys of [camera]."""
    return {
        "model": camera.model,
        "params": camera.params.tolist(),
        "width": camera.width,
        "height": camera.height,
    }


def _sources(illumination: Illumination, target: Floats) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Tables of the distant sources and of the near ones.

    Where the light is given as distant, lamps are as they look from the object's centre, (3,) metres.
    """
    distant, near = [], []
    for source in illumination.sources:
        if isinstance(source, PointSource) and illumination.given == "all":
            near.append({"position": source.position.tolist(), "intensity": source.intensity.tolist()})
            continue
        direction, _, irradiance = source.at(target[None])
        distant.append({"direction": direction[0].tolist(), "irradiance": irradiance[0].tolist()})
    return distant, near


def _object(staging: Staging, written: WrittenSet, mesh: str) -> dict[str, Any]:
    surface = staging.scene.surface
    if isinstance(surface, Ball):
        place = {"centre": surface.centre.tolist(), "radius": surface.radius} if staging.stated else {}
        return {"shape": "sphere", **place}
    assert written.mesh_to_world is not None, "other surfaces are meshes"
    keys: dict[str, Any] = {"shape": "mesh", "mesh": mesh, "mesh_to_world": written.mesh_to_world.tolist()}
    if isinstance(staging.scene.material, Textured):
        keys["texture"] = True
    return keys


def _lighting(illumination: Illumination, staging: Staging, written: WrittenSet) -> dict[str, Any]:
    keys: dict[str, Any] = {"name": illumination.name}
    if illumination.given == "nothing":
        keys["unknown"] = True
    elif illumination.given == "ball":
        keys["mirror_ball"] = written.balls[illumination.name]
    else:
        if illumination.name in written.maps:
            keys["map"] = written.maps[illumination.name]
        distant, near = _sources(given_light(illumination, staging), staging.scene.surface.centre)
        keys |= {"directional": distant} if distant else {}
        keys |= {"near": near} if near else {}
    return keys


def _table(header: str, **keys: Any) -> str:
    lines = [header] if header else []
    return "\n".join([*lines, *(f"{key} = {_toml(value)}" for key, value in keys.items())]) + "\n"


def _toml(value: Any) -> str:
    """A value in TOML, which writes strings, booleans and numbers (to the last bit) as JSON does."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(entry) for entry in value) + "]"
    # JSON leaves one control character as it is that TOML doesn't.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")

"""A scene as a photo set on disk, with the truth beside it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import write_exr
from capture.photoset import MANIFEST_NAME
from synthetic.lights.illumination import latlong_pixels
from synthetic.spheres import SphereScene, render

Progress = Callable[[Iterable[Any], str], Iterable[Any]]

TRUTH_NAME = "truth.json"
# Names that a written set holds.
PHOTOSET_FILES = (MANIFEST_NAME, TRUTH_NAME, "*.exr", "*_mask.png")
_LIGHTING_NAME = "lighting"
_MAP_NAME = "lighting.exr"
_MAP_HEIGHT = 128


def write_photoset(scene: SphereScene, folder: Path, progress: Progress | None = None) -> None:
    """Photograph a scene into a folder: photoset.toml, photographs, masks, the lighting map and truth.json.

    folder : made if missing; files of the same names are replaced.
    progress : called with the photographs' indices and a description; iterates over what it returns.
    The bytes depend on nothing but the scene: photograph i draws its noise from (scene.seed, i).
    """
    folder.mkdir(parents=True, exist_ok=True)
    indices: Iterable[int] = range(len(scene.cameras))
    for index in progress(indices, "Photographing") if progress else indices:
        rng = np.random.default_rng([scene.seed, index])
        photo, coverage = render(scene, scene.cameras[index], rng)
        write_exr(folder / _photo_name(index), photo)
        _write_mask(folder / _mask_name(index), coverage)
    if scene.area_lights:
        write_exr(folder / _MAP_NAME, latlong_pixels(scene.area_lights, _MAP_HEIGHT))
    (folder / TRUTH_NAME).write_text(json.dumps(_truth(scene), indent=1) + "\n", encoding="utf-8")
    # Last: a folder without a manifest isn't taken for a whole set.
    (folder / MANIFEST_NAME).write_text(_manifest(scene), encoding="utf-8")


def _photo_name(index: int) -> str:
    return f"{index:03d}.exr"


def _mask_name(index: int) -> str:
    return f"{index:03d}_mask.png"


def _write_mask(path: Path, coverage: NDArray[np.float32]) -> None:
    import cv2

    _, data = cv2.imencode(".png", np.round(coverage * 255).astype(np.uint8))
    path.write_bytes(data.tobytes())


def _manifest(scene: SphereScene) -> str:
    """photoset.toml. The sphere's centre and radius are left to be found from the masks."""
    first = scene.cameras[0]
    tables = [
        _table("", format=1, name=scene.name),
        _table("[camera]", **_intrinsics(scene, 0)),
        _table("[radiometry]", encoding="linear", exposure="equal"),
        _table("[object]", shape="sphere"),
        _table("[[lighting]]", **_lighting(scene)),
    ]
    for index, camera in enumerate(scene.cameras):
        keys: dict[str, Any] = {"file": _photo_name(index), "mask": _mask_name(index)}
        if index in scene.held_out:
            keys["held_out"] = True
        keys["world_to_camera"] = camera.world_to_camera.tolist()
        if camera.model != first.model or camera.params.tolist() != first.params.tolist():
            keys["camera"] = _intrinsics(scene, index)
        tables.append(_table("[[photo]]", **keys))
    return "\n".join(tables)


def _intrinsics(scene: SphereScene, index: int) -> dict[str, Any]:
    camera = scene.cameras[index]
    return {
        "model": camera.model,
        "params": camera.params.tolist(),
        "width": camera.width,
        "height": camera.height,
    }


def _lighting(scene: SphereScene) -> dict[str, Any]:
    keys: dict[str, Any] = {"name": _LIGHTING_NAME}
    if scene.area_lights:
        keys["map"] = _MAP_NAME
    if scene.sources:
        keys["directional"] = _sources(scene)
    return keys


def _sources(scene: SphereScene) -> list[dict[str, Any]]:
    return [
        {"direction": source.direction.tolist(), "irradiance": source.irradiance.tolist()}
        for source in scene.sources
    ]


def _table(header: str, **keys: Any) -> str:
    lines = [header] if header else []
    return "\n".join([*lines, *(f"{key} = {_toml(value)}" for key, value in keys.items())]) + "\n"


def _toml(value: Any) -> str:
    """A value in TOML, which writes strings, booleans and numbers (to the last bit) as JSON does."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(entry) for entry in value) + "]"
    return json.dumps(value, ensure_ascii=False)


def _truth(scene: SphereScene) -> dict[str, Any]:
    material = scene.material
    return {
        "format": 1,
        "name": scene.name,
        "brdf": {
            "model": "microfacet",
            "kd": material.kd.tolist(),
            "ks": material.ks.tolist(),
            "mu": material.mu,
            "sigma": material.sigma,
        },
        "sphere": {"centre": scene.centre.tolist(), "radius": scene.radius},
        "lighting": {
            "name": _LIGHTING_NAME,
            "directional": _sources(scene),
            "area": [
                {
                    "axis": light.axis.tolist(),
                    "radiance": light.radiance.tolist(),
                    "width_rad": light.width_rad,
                }
                for light in scene.area_lights
            ],
        },
        "noise": {"relative": scene.noise.relative, "floor": scene.noise.floor},
    }

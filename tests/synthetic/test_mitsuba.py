"""A matte sphere against Mitsuba 3, an unrelated renderer: camera, directions, lights and units at once.

Matte only: Mitsuba has no material with RH01's lobe, whose own tests are in `test_lobes`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from synthetic.spheres import Noise, SphereScene, expose

from capture.arc.gantry import look_at
from capture.camera import Camera
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.microfacet import Microfacet

mi = pytest.importorskip("mitsuba")
mi.set_variant("scalar_rgb")

AREA = AreaLight(np.array([0.3, -0.5, 0.8]), np.array([1.0, 1.5, 2.0]), 0.35)
SOURCE = DirectionalSource(np.array([0.8, 0.5, -0.1]), np.array([2.0, 1.0, 0.5]))
# No symmetry of the scene hides a flipped axis; the principal point is off the centre.
CAMERA = Camera(
    "PINHOLE",
    np.array([660.0, 660.0, 34.0, 22.0]),
    64,
    48,
    look_at([0.45, -0.3, 0.25], [0.001, 0.002, 0.0], [0.1, 0.0, 1.0]),
)


def envmap_directions(height: int) -> np.ndarray:
    """Directions of the texels of Mitsuba's envmap: y up, rows span 0 to pi inclusive, u from -z to +x."""
    theta = np.linspace(0, np.pi, height)[:, None]
    phi = (np.arange(2 * height) + 0.5) * np.pi / height
    y = np.broadcast_to(np.cos(theta), (height, 2 * height))
    return np.stack([np.sin(theta) * np.sin(phi), y, -np.sin(theta) * np.cos(phi)], axis=-1)


def mitsuba_photo(scene: SphereScene, emitter: dict[str, Any], samples: int) -> np.ndarray:
    camera = scene.cameras[0]
    fx, _, cx, cy = camera.params
    # Mitsuba's camera looks along +z with x to the left and y up.
    to_world = camera.camera_to_world @ np.diag([-1.0, -1.0, 1.0, 1.0])
    description = {
        "type": "scene",
        # More emitter samples than one would count a directional light more than once.
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, "hide_emitters": True},
        "sensor": {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / fx))),
            "fov_axis": "x",
            "principal_point_offset_x": float((camera.width / 2 - cx) / camera.width),
            "principal_point_offset_y": float((camera.height / 2 - cy) / camera.height),
            "to_world": mi.ScalarTransform4f(to_world),
            "near_clip": 0.01,
            "film": {
                "type": "hdrfilm",
                "width": camera.width,
                "height": camera.height,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
            },
            "sampler": {"type": "multijitter", "sample_count": samples, "seed": 1},
        },
        "sphere": {
            "type": "sphere",
            "center": scene.centre.tolist(),
            "radius": scene.radius,
            "bsdf": {
                "type": "diffuse",
                "reflectance": {"type": "rgb", "value": (np.pi * scene.material.kd).tolist()},
            },
        },
        "emitter": emitter,
    }
    return np.array(mi.render(mi.load_dict(description)))


@pytest.mark.parametrize("kind", ["source", "area"])
def test_matte_sphere_agrees_with_mitsuba(kind: str) -> None:
    scene = SphereScene(
        name="matte",
        material=Microfacet(np.array([0.1, 0.2, 0.25]), np.zeros(3), None, 0.1),
        area_lights=(AREA,) if kind == "area" else (),
        sources=(SOURCE,) if kind == "source" else (),
        centre=np.array([0.0015, -0.001, 0.002]),
        radius=0.018,
        cameras=(CAMERA,),
        noise=Noise(0.0, 0.0),
    )
    if kind == "area":
        texels = AREA.profile(envmap_directions(64) @ AREA.axis)[..., None] * AREA.radiance
        emitter = {"type": "envmap", "bitmap": mi.Bitmap(texels.astype(np.float32))}
        photo = mitsuba_photo(scene, emitter, samples=1024)
    else:
        emitter = {
            "type": "directional",
            "direction": (-SOURCE.direction).tolist(),
            "irradiance": {"type": "rgb", "value": SOURCE.irradiance.tolist()},
        }
        photo = mitsuba_photo(scene, emitter, samples=64)
    radiance, coverage = expose(scene, CAMERA)
    inner = coverage == 1
    assert inner.sum() > 1000
    difference = (photo - radiance)[inner]
    # Monte Carlo noise: some 0.1% of a pixel from 1024 stratified directions.
    rms = np.sqrt((difference**2).mean(axis=0) / (radiance[inner] ** 2).mean(axis=0))
    assert (rms < 0.003).all()
    # It averages out; what remains is Mitsuba's interpolation between texels 0.05 rad apart.
    assert (np.abs(difference.mean(axis=0) / radiance[inner].mean(axis=0)) < 1e-3).all()

"""Scenes for Mitsuba 3, an unrelated renderer, as a witness for ours.

Lengths are millimetres there: Mitsuba's rays leave surfaces by 9e-5 (1 + the largest coordinate), which in metres would
be 0.1 mm. What the two print differently: Mitsuba's rough conductor shadows and masks independently, G1(wi) G1(wo),
where `SmithMaterial` correlates heights.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from recon.mesh.trianglemesh import TriangleMesh, write_mesh
from synthetic.lights.disc import DiscLight
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.materials.facets import GGXSlopes
from synthetic.materials.fresnel import fresnel_at_normal
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.material import Material
from synthetic.materials.mirror import Mirror
from synthetic.materials.smith import SmithMaterial
from synthetic.materials.texture import Textured
from synthetic.scene import Scene
from synthetic.shapes.ball import Ball
from synthetic.shapes.meshsurface import MeshSurface
from synthetic.shapes.surface import Surface

Floats = NDArray[np.float64]
Plugin = dict[str, Any]

_MILLIMETRES = 1000.0
# Rows of environment maps: Mitsuba is linear between texels, which then are 0.7 degrees apart.
_ROWS = 256
# Where distant discs stand, millimetres: far enough for objects of 20 mm, near enough for single precision.
_FAR = 1e5


def mitsuba_photo(
    scene: Scene, folder: Path, samples: int, photograph: int = 0, bsdf: Plugin | None = None, seed: int = 0
) -> Floats:
    """Mean radiance (h, w, 3) over the pixels of a photograph, by Mitsuba's path tracer in the variant that is set.

    folder : where meshes are written. samples : paths per pixel. bsdf : a plugin instead of the scene's material.
    ValueError for what Mitsuba hasn't.
    """
    shot = scene.shots[photograph]
    description = {
        "type": "scene",
        # Edges of paths: from the camera, between reflections, to the light. Roulette would only add noise.
        "integrator": {
            "type": "path",
            "max_depth": scene.effort.bounces + 2,
            "rr_depth": 1000,
            "hide_emitters": True,
        },
        "sensor": _sensor(shot.camera, samples),
        "object": _shape(scene.surface, folder) | {"bsdf": bsdf or bsdf_of(scene.material)},
    }
    loaded = mi.load_dict(description | emitters(shot.illumination))
    return np.array(mi.render(loaded, seed=seed), dtype=float)


def bsdf_of(material: Material) -> Plugin:
    """The stock plugin for a material. ValueError for one that Mitsuba hasn't, or whose reflectances it refuses."""
    described, kd, ks = material, material.kd, material.ks
    if isinstance(material, Textured):
        described, kd, ks = material.material, material.kd_map, material.ks_map
    if isinstance(described, Lambertian):
        return {"type": "diffuse", "reflectance": reflectance(np.pi * kd)}
    if isinstance(described, SmithMaterial):
        ggx = isinstance(described.facets, GGXSlopes)
        widths = {"alpha_u": described.facets.along, "alpha_v": described.facets.across}
        lobe = {"type": "roughconductor", "distribution": "ggx" if ggx else "beckmann"} | widths
    elif isinstance(described, Mirror):
        lobe = {"type": "conductor"}
    else:
        raise ValueError(f"Mitsuba has no {type(described).__name__}")
    at_normal = 1.0 if described.mu is None else fresnel_at_normal(described.mu)
    albedo, gloss = np.pi * kd, ks / at_normal
    lobe |= _index(described.mu)
    if not albedo.any():
        return lobe | {"specular_reflectance": reflectance(gloss)}
    # A blend takes so much of either that both stay below 1.
    share = float(gloss.max() / (albedo.max() + gloss.max()))
    return {
        "type": "blendbsdf",
        "weight": share,
        "base": {"type": "diffuse", "reflectance": reflectance(albedo / (1 - share))},
        "lobe": lobe | {"specular_reflectance": reflectance(gloss / share)},
    }


def reflectance(values: Floats) -> Plugin:
    """A texture of a value (3,) or of texels (h, w, 3), first row at v = 1. ValueError above 1: Mitsuba refuses it."""
    if values.max() > 1:
        raise ValueError(f"Mitsuba's reflectances end at 1; {values.max():.3g} is wanted")
    if values.ndim == 1:
        return {"type": "rgb", "value": values.tolist()}
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(values.astype(np.float32)),
        "raw": True,
        "filter_type": "bilinear",
    }


def emitters(illumination: Illumination) -> dict[str, Plugin]:
    """All lights of an illumination: discs as discs far away, other extended ones as one environment map."""
    plugins: dict[str, Plugin] = {}
    for index, source in enumerate(illumination.sources):
        plugins[f"source{index}"] = _source(source)
    discs = [light for light in illumination.extended if isinstance(light, DiscLight)]
    for index, light in enumerate(discs):
        plugins[f"disc{index}"] = _disc(light)
    smooth = [light for light in illumination.extended if not isinstance(light, DiscLight)]
    if smooth:
        texels = sum(light.radiance_from(_envmap_directions(_ROWS)) for light in smooth)
        plugins["map"] = {"type": "envmap", "bitmap": mi.Bitmap(np.asarray(texels, np.float32))}
    return plugins


def _sensor(camera: Camera, samples: int) -> Plugin:
    fx, fy, cx, cy = camera.params[:4]
    if camera.model not in ("PINHOLE", "OPENCV") or camera.params[4:].any() or fx != fy:
        raise ValueError(f"Mitsuba has no {camera.model} camera with parameters {camera.params.tolist()}")
    # Mitsuba's camera looks along +z with x to the left and y up.
    to_world = camera.camera_to_world @ np.diag([-1.0, -1.0, 1.0, 1.0])
    to_world[:3, 3] *= _MILLIMETRES
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / fx))),
        "fov_axis": "x",
        "principal_point_offset_x": float((camera.width / 2 - cx) / camera.width),
        "principal_point_offset_y": float((camera.height / 2 - cy) / camera.height),
        "to_world": mi.ScalarTransform4f(to_world),
        "near_clip": 1.0,
        "far_clip": 1e5,
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "orthogonal", "sample_count": samples},
    }


def _shape(surface: Surface, folder: Path) -> Plugin:
    if isinstance(surface, Ball):
        centre = (_MILLIMETRES * surface.centre).tolist()
        return {"type": "sphere", "center": centre, "radius": _MILLIMETRES * surface.radius}
    if not isinstance(surface, MeshSurface):
        raise ValueError(f"Mitsuba has no {type(surface).__name__}")
    mesh = surface.mesh
    path = folder / "object.obj"
    write_mesh(path, TriangleMesh(_MILLIMETRES * mesh.vertices, mesh.faces, mesh.normals, mesh.uv))
    return {"type": "obj", "filename": str(path)}


def _index(mu: complex | None) -> Plugin:
    """Fresnel's equations for an index; a real one is a metal's that doesn't absorb."""
    if mu is None:
        return {"material": "none"}
    parts = {"eta": mu.real, "k": mu.imag}
    return {name: {"type": "rgb", "value": [float(part)] * 3} for name, part in parts.items()}


def _source(source: DirectionalSource | PointSource) -> Plugin:
    if isinstance(source, PointSource):
        intensity = (_MILLIMETRES**2 * source.intensity).tolist()
        position = (_MILLIMETRES * source.position).tolist()
        return {"type": "point", "position": position, "intensity": {"type": "rgb", "value": intensity}}
    irradiance = {"type": "rgb", "value": source.irradiance.tolist()}
    # The direction in which the light travels.
    return {"type": "directional", "direction": (-source.direction).tolist(), "irradiance": irradiance}


def _disc(light: DiscLight) -> Plugin:
    radiance = light.irradiance / (np.pi * np.sin(light.radius_rad) ** 2)
    centre = (_FAR * light.direction).tolist()
    up = np.eye(3)[np.abs(light.direction).argmin()].tolist()
    placed = mi.ScalarTransform4f().look_at(origin=centre, target=[0, 0, 0], up=up)
    return {
        "type": "disk",
        "to_world": placed @ mi.ScalarTransform4f().scale(float(_FAR * np.tan(light.radius_rad))),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance.tolist()}},
    }


def _envmap_directions(rows: int) -> Floats:
    """Directions (rows, 2 rows, 3) of an envmap's texels: y up, rows from 0 to pi inclusive, columns from -z to +x."""
    theta = np.linspace(0, np.pi, rows)[:, None]
    phi = (np.arange(2 * rows) + 0.5) * np.pi / rows
    y = np.broadcast_to(np.cos(theta), (rows, 2 * rows))
    return np.stack([np.sin(theta) * np.sin(phi), y, -np.sin(theta) * np.cos(phi)], axis=-1)

"""From the tables of a scene file to the scene itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.lighting import read_latlong
from capture.reflectance.cornell import read_cornell
from recon.mesh.atlas import with_atlas
from recon.mesh.trianglemesh import TriangleMesh, read_mesh
from synthetic.lights.arealight import AreaLight
from synthetic.lights.disc import DiscLight
from synthetic.lights.illumination import Given, Illumination
from synthetic.lights.latlong import LatLongLight
from synthetic.lights.light import ExtendedLight
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.lights.values import unit_vector
from synthetic.materials.facets import BeckmannSlopes, GGXSlopes
from synthetic.materials.interpolated import interpolated
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.mirror import Mirror
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.plastic import Plastic
from synthetic.materials.rh01 import RH01_MATERIALS, exact, radiometric
from synthetic.materials.smith import SmithMaterial
from synthetic.materials.tabulated import of_merl
from synthetic.materials.texture import Textured
from synthetic.scene import Effort, Scene
from synthetic.scenes.scenefile import SceneFile, read_scene_file
from synthetic.scenes.schema import (
    BallTable,
    MaterialTable,
    SceneCamera,
    SceneLighting,
    SceneObject,
    SensorTable,
    Towards,
)
from synthetic.scenes.views import shots, towards
from synthetic.sensing.development import Development
from synthetic.sensing.noise import Noise
from synthetic.sensing.sensor import Sensor
from synthetic.shapes.ball import Ball
from synthetic.shapes.cat import REACH, cat_field
from synthetic.shapes.doll import doll_mesh
from synthetic.shapes.dollpaint import doll_textures
from synthetic.shapes.meshing import mesh_implicit
from synthetic.shapes.meshsurface import MeshSurface
from synthetic.shapes.surface import Surface
from synthetic.staging import Staging

Floats = NDArray[np.float64]

_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
# Length of edges, metres, of cat and doll.
_EDGE = 0.0012
_TEXTURE_HEIGHT = 1024


def read_staging(
    path: Path, given: Given | None = None, seed: int | None = None, atlas: bool = True
) -> Staging:
    """Read a scene file and build all of it; files that it names are relative to it. ValueError says what is wrong.

    given : instead of the file's, for the lightings of photographs that are not held out. seed : instead of the file's.
    atlas : whether the cat gets the texture coordinates that the file asks for, which take seconds.
    """
    file = read_scene_file(path)
    if not atlas:
        file = file.model_copy(update={"object": file.object.model_copy(update={"atlas": False})})
    if seed is not None:
        file = file.model_copy(update={"seed": seed})
    if given is not None:
        file = _with_light_given(file, given)
    try:
        return _staging(file, path.parent, path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise error if str(path) in str(error) else ValueError(f"{path}: {error}") from error
    except OSError as error:
        raise ValueError(f"{path}: {error.filename}: cannot be read ({error.strerror or error})") from error


def _staging(file: SceneFile, folder: Path, source: str) -> Staging:
    mesh = _mesh(file.object, folder)
    lights = {table.name: _illumination(table, file.object, folder) for table in file.lighting}
    scene = Scene(
        name=file.name,
        surface=_surface(file.object, mesh),
        material=_material(file.material, file.object, folder),
        shots=shots(file, lights),
        effort=Effort(**file.render.model_dump()),
        seed=file.seed,
    )
    placed = np.eye(4)
    placed[:3, 3] = file.object.centre
    return Staging(
        scene=scene,
        sensor=_sensor(file.sensor, file.camera),
        mesh=mesh,
        mesh_to_world=placed,
        stated=file.object.stated,
        faults=file.faults,
        uncertainty=file.uncertainty,
        ball=file.mirror_ball,
        calibration=file.calibration,
        source=source,
    )


def _with_light_given(file: SceneFile, given: Given) -> SceneFile:
    arcs = [arc for arc in (file.gantry, file.turntable) if arc is not None]
    fitted = {arc.lighting for arc in arcs} | {view.lighting for view in file.view if not view.held_out}
    fitted = {name or file.lighting[0].name for name in fitted}
    tables = [
        table.model_copy(update={"given": given}) if table.name in fitted else table
        for table in file.lighting
    ]
    ball = file.mirror_ball or (BallTable() if given == "ball" else None)
    return file.model_copy(update={"lighting": tuple(tables), "mirror_ball": ball})


def _mesh(table: SceneObject, folder: Path) -> TriangleMesh | None:
    if table.shape == "cat":
        mesh = mesh_implicit(cat_field, REACH, table.edge or _EDGE)
        return with_atlas(mesh) if table.atlas else mesh
    if table.shape == "doll":
        return doll_mesh(table.edge or _EDGE)
    if table.mesh is not None:
        mesh = read_mesh(folder / table.mesh)
        return replace(mesh, vertices=mesh.vertices * _METRES[table.unit])
    return None


def _surface(table: SceneObject, mesh: TriangleMesh | None) -> Surface:
    centre = np.array(table.centre)
    if mesh is None:
        return Ball(centre, table.radius)
    try:
        return MeshSurface(TriangleMesh(mesh.vertices + centre, mesh.faces, mesh.normals, mesh.uv))
    except ValueError as error:
        raise ValueError(f"[object] {table.mesh or table.shape}: {error}") from error


def _material(table: MaterialTable | None, of: SceneObject, folder: Path) -> Material:
    if of.shape == "doll":
        kd_map, ks_map = doll_textures(_TEXTURE_HEIGHT)
        lobe = _plain(table, folder) if table else MicrofacetMaterial(np.zeros(3), np.ones(3), 1.5, 0.15)
        return Textured(lobe, kd_map.astype(float), ks_map.astype(float))
    assert table is not None, "the schema sees to it"
    return _plain(table, folder)


def _plain(table: MaterialTable, folder: Path) -> Material:
    if table.name is not None:
        row = RH01_MATERIALS[table.name]
        return radiometric(row) if table.model == "microfacet" else exact(row)
    kd, ks = np.array(table.kd or (0, 0, 0)), np.array(table.ks or (0, 0, 0))
    sigma, alpha = table.sigma or 0.0, table.alpha or 0.0
    match table.model:
        case "lambertian":
            return Lambertian(kd)
        case "microfacet":
            return MicrofacetMaterial(kd, ks, table.mu, sigma)
        case "smith":
            return SmithMaterial(kd, ks, table.mu, BeckmannSlopes(sigma, sigma))
        case "ggx":
            return SmithMaterial(kd, ks, table.mu, GGXSlopes(alpha, alpha))
        case "anisotropic":
            return SmithMaterial(kd, ks, table.mu, GGXSlopes(table.alpha_x or 0.0, table.alpha_y or 0.0))
        case "plastic":
            return Plastic(
                SmithMaterial(
                    kd, ks, table.mu, GGXSlopes(alpha, alpha) if alpha else BeckmannSlopes(sigma, sigma)
                )
            )
        case "phong":
            return PhongMaterial(kd, ks, table.exponent or 0.0)
        case "mirror":
            return Mirror(kd, ks, table.mu)
        case "table":
            path = folder / (table.file or "")
            return of_merl(path) if path.suffix == ".binary" else interpolated(read_cornell(path))


def _illumination(table: SceneLighting, of: SceneObject, folder: Path) -> Illumination:
    extended: list[ExtendedLight] = [
        AreaLight(_direction(light), np.array(light.radiance), np.radians(light.width_deg))
        for light in table.area
    ]
    if table.map is not None:
        extended.append(LatLongLight(read_latlong(folder / table.map) * table.map_scale))
    sources: list[DirectionalSource | PointSource] = []
    for source in table.directional:
        direction, irradiance = _direction(source), np.array(source.irradiance)
        if source.radius_deg is None:
            sources.append(DirectionalSource(direction, irradiance))
        else:
            extended.append(DiscLight(direction, irradiance, np.radians(source.radius_deg)))
    for lamp in table.lamp:
        position = np.array(of.centre) + lamp.distance * unit_vector(_direction(lamp), "direction of a lamp")
        sources.append(PointSource(position, np.array(lamp.irradiance) * lamp.distance**2))
    return Illumination(table.name, tuple(extended), tuple(sources), table.given)


def _direction(table: Towards) -> Floats:
    if table.direction is not None:
        return np.array(table.direction)
    return towards(table.azimuth_deg or 0.0, table.elevation_deg)


def _sensor(table: SensorTable, camera: SceneCamera) -> Noise | Development:
    if table.file == "exr":
        return Noise(table.noise, table.floor)
    bits = table.bits or {"png": 8, "jpeg": 8, "tiff": 16, "dng": 14}[table.file]
    sensor = Sensor(
        full_well=np.full(3, table.full_well or 20_000.0),
        read_noise=np.full(3, 4.0 if table.read_noise is None else table.read_noise),
        focal_px=camera.focal_px if table.vignetting else np.inf,
        centre=camera.principal_point,
        response=table.response or ("srgb" if bits == 8 else "linear"),
        bits=bits,
    )
    return Development(
        sensor,
        table.file,
        table.demosaic,
        table.exposure_s,
        table.saturated,
        (0.0,) if table.bracket_stops is None else table.bracket_stops,
    )

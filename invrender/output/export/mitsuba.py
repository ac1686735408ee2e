"""A result as a scene for Mitsuba 3: object, material, light and a camera; `mitsuba scene.xml` renders it.

Lengths are millimetres: Mitsuba's rays leave surfaces by about 0.1 unit of length, which in metres would let light
through what is small. Radiance doesn't change by it, all light being distant.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.files.imagefile import write_exr
from capture.lighting import Lighting
from invrender.output.export.lights import MITSUBA_MAP_TO_WORLD, mitsuba_map
from invrender.output.export.mapping import Mapping
from invrender.output.export.material import ExportedBRDF
from invrender.output.export.mitsuba_target import NO_INDEX, MitsubaBlend, MitsubaPlastic
from invrender.output.export.shape import Shape
from invrender.output.export.target import Numbers
from invrender.output.export.texels import base_texels, texels_of
from invrender.output.export.written import WrittenExport
from recon.mesh.trianglemesh import TriangleMesh, write_mesh

Floats = NDArray[np.float64]

SCENE_NAME, _MESH_NAME, _MAP_NAME = "scene.xml", "object.obj", "environment.exr"
_MILLIMETRES = 1000.0
_SAMPLES = 64


def write_mitsuba(
    folder: Path, shape: Shape, material: ExportedBRDF, mapping: Mapping, lighting: Lighting, camera: Camera
) -> WrittenExport:
    """Write scene.xml with what it names beside it."""
    scene = ET.Element("scene", version="3.0.0")
    scene.append(ET.Comment(" lightfactor: lengths in millimetres, +Z up, linear radiance "))
    integrator = ET.SubElement(scene, "integrator", type="path")
    _add(integrator, "boolean", hide_emitters="true")
    scene.append(_sensor(camera))
    files = [SCENE_NAME]
    body = _shape(scene, shape, folder, files)
    parameters = _bsdf(body, material, mapping, folder, files)
    _emitters(scene, lighting, folder, files)
    ET.indent(scene)
    ET.ElementTree(scene).write(folder / SCENE_NAME, encoding="utf-8", xml_declaration=True)
    return WrittenExport(tuple(files), parameters)


def _shape(scene: ET.Element, shape: Shape, folder: Path, files: list[str]) -> ET.Element:
    if shape.is_sphere:
        body = ET.SubElement(scene, "shape", type="sphere")
        x, y, z = (_number(value) for value in _MILLIMETRES * shape.centre)
        ET.SubElement(body, "point", name="center", x=x, y=y, z=z)
        _add(body, "float", radius=_number(_MILLIMETRES * shape.radius))
        return body
    mesh = shape.mesh
    write_mesh(
        folder / _MESH_NAME, TriangleMesh(_MILLIMETRES * mesh.vertices, mesh.faces, mesh.normals, mesh.uv)
    )
    files.append(_MESH_NAME)
    body = ET.SubElement(scene, "shape", type="obj")
    _add(body, "string", filename=_MESH_NAME)
    return body


def _bsdf(
    body: ET.Element, material: ExportedBRDF, mapping: Mapping, folder: Path, files: list[str]
) -> dict[str, object]:
    """The material; returns its parameters."""
    numbers, target = mapping.numbers, mapping.target
    assert isinstance(target, MitsubaBlend)
    base, lobe = numbers.base, numbers.specular
    if material.textures is not None:
        texels = texels_of(material.textures, material.brdf.ks)
        base = base_texels(texels, mapping, material.brdf, 1.0)
        if np.ptp(texels.strength) > 0:
            lobe = lobe * texels.strength
    if isinstance(target, MitsubaPlastic):
        return _plastic(body, target, numbers, base, lobe, folder, files)
    return _blend(body, target, numbers, base, lobe, folder, files)


def _plastic(
    body: ET.Element,
    target: MitsubaPlastic,
    numbers: Numbers,
    base: Floats,
    lobe: Floats,
    folder: Path,
    files: list[str],
) -> dict[str, object]:
    """A roughplastic with reflectances (3,) or (h, w, 3)."""
    plastic = ET.SubElement(body, "bsdf", type="roughplastic")
    _add(plastic, "string", distribution=target.distribution)
    _add(plastic, "float", alpha=_number(numbers.alpha), int_ior=_number(numbers.fresnel), ext_ior="1")
    _add(plastic, "boolean", nonlinear="false")
    _reflectance(plastic, "diffuse_reflectance", base, folder, files)
    _reflectance(plastic, "specular_reflectance", lobe, folder, files)
    return {
        "distribution": target.distribution,
        "alpha": numbers.alpha,
        "int_ior": numbers.fresnel,
        "ext_ior": 1.0,
        "nonlinear": False,
        "diffuse_reflectance": numbers.base.tolist(),
        "specular_reflectance": numbers.specular.tolist(),
    }


def _blend(
    body: ET.Element,
    target: MitsubaBlend,
    numbers: Numbers,
    base: Floats,
    lobe: Floats,
    folder: Path,
    files: list[str],
) -> dict[str, object]:
    """A blend of base and lobe, (3,) or (h, w, 3) each, or the one that there is."""
    albedo, gloss = float(numbers.base.max()), float(numbers.specular.max())
    # Weights that leave both reflectances at their sum, which is below 1 unless grazing light is reflected strongly.
    share = gloss / (albedo + gloss) if albedo + gloss > 0 else 0.0
    parent = body if share in (0.0, 1.0) else ET.SubElement(body, "bsdf", type="blendbsdf")
    if parent is not body:
        _add(parent, "float", weight=_number(share))
    parameters: dict[str, object] = {"weight": share}
    if share < 1:
        diffuse = ET.SubElement(parent, "bsdf", type="diffuse")
        _reflectance(diffuse, "reflectance", base / max(1 - share, 1e-9), folder, files)
        parameters["reflectance"] = (numbers.base / max(1 - share, 1e-9)).tolist()
    if share > 0:
        conductor = ET.SubElement(parent, "bsdf", type="roughconductor")
        _add(conductor, "string", distribution=target.distribution)
        _add(conductor, "float", alpha=_number(numbers.alpha))
        if numbers.fresnel == NO_INDEX:
            _add(conductor, "string", material="none")
        else:
            _add(conductor, "spectrum", eta=_number(numbers.fresnel), k="0")
        _reflectance(conductor, "specular_reflectance", lobe / max(share, 1e-9), folder, files)
        parameters |= {
            "distribution": target.distribution,
            "alpha": numbers.alpha,
            "eta": None if numbers.fresnel == NO_INDEX else numbers.fresnel,
            "k": 0.0,
            "specular_reflectance": (numbers.specular / share).tolist(),
        }
    return parameters


def _reflectance(parent: ET.Element, name: str, values: Floats, folder: Path, files: list[str]) -> None:
    """A reflectance (3,) or texels (h, w, 3). Mitsuba refuses colours above 1, but not images of them."""
    if values.ndim == 1 and values.max() <= 1:
        _add(parent, "rgb", **{name: _list(values)})
        return
    file = f"{name}.exr"
    write_exr(folder / file, values.reshape(1, 1, 3) if values.ndim == 1 else values)
    files.append(file)
    texture = ET.SubElement(parent, "texture", type="bitmap", name=name)
    _add(texture, "string", filename=file)
    _add(texture, "boolean", raw="true")


def _emitters(scene: ET.Element, lighting: Lighting, folder: Path, files: list[str]) -> None:
    if lighting.radiance_map is not None:
        write_exr(folder / _MAP_NAME, mitsuba_map(lighting.radiance_map))
        files.append(_MAP_NAME)
        emitter = ET.SubElement(scene, "emitter", type="envmap")
        _add(emitter, "string", filename=_MAP_NAME)
        _transform(emitter, MITSUBA_MAP_TO_WORLD)
    sources = zip(lighting.directions, lighting.irradiances, lighting.places, strict=True)
    for direction, irradiance, place in sources:
        if place is not None:
            emitter = ET.SubElement(scene, "emitter", type="point")
            x, y, z = (_number(value) for value in _MILLIMETRES * place[0])
            ET.SubElement(emitter, "point", name="position", x=x, y=y, z=z)
            _add(emitter, "rgb", intensity=_list(_MILLIMETRES**2 * place[1]))
            continue
        emitter = ET.SubElement(scene, "emitter", type="directional")
        # The way that the light goes.
        x, y, z = (_number(-value) for value in direction)
        ET.SubElement(emitter, "vector", name="direction", x=x, y=y, z=z)
        _add(emitter, "rgb", irradiance=_list(irradiance))


def _sensor(camera: Camera) -> ET.Element:
    """A perspective camera with square pixels, looking through the picture's middle."""
    sensor = ET.Element("sensor", type="perspective")
    # Mitsuba's cameras look along +z with x to the left and y up.
    to_world = camera.camera_to_world @ np.diag([-1.0, -1.0, 1.0, 1.0])
    to_world[:3, 3] *= _MILLIMETRES
    _add(sensor, "float", fov=_number(float(np.degrees(2 * np.arctan(camera.width / 2 / camera.focal_px)))))
    _add(sensor, "string", fov_axis="x")
    _add(sensor, "float", near_clip="0.1", far_clip="1e7")
    _transform(sensor, to_world)
    film = ET.SubElement(sensor, "film", type="hdrfilm")
    _add(film, "integer", width=str(camera.width), height=str(camera.height))
    _add(film, "string", component_format="float32")
    # A pixel is the mean over its square.
    ET.SubElement(film, "rfilter", type="box")
    sampler = ET.SubElement(sensor, "sampler", type="independent")
    _add(sampler, "integer", sample_count=str(_SAMPLES))
    return sensor


def _transform(parent: ET.Element, matrix: Floats) -> None:
    transform = ET.SubElement(parent, "transform", name="to_world")
    ET.SubElement(transform, "matrix", value=_list(matrix.ravel()))


def _add(parent: ET.Element, kind: str, **values: str) -> None:
    for name, value in values.items():
        ET.SubElement(parent, kind, name=name, value=value)


def _list(values: Iterable[float]) -> str:
    return " ".join(_number(value) for value in values)


def _number(value: float) -> str:
    return f"{value:.9g}"

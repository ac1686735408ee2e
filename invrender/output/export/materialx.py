"""A result's material as a MaterialX document, its textures and the object beside it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import write_exr, write_png
from invrender.output.export.mapping import Mapping
from invrender.output.export.material import ExportedBRDF
from invrender.output.export.shape import Shape
from invrender.output.export.texels import base_texels, texels_of
from invrender.output.export.written import WrittenExport, clipped
from recon.mesh.trianglemesh import write_mesh

Floats = NDArray[np.float64]

MATERIAL_NAME, _MESH_NAME = "material.mtlx", "object.obj"


@dataclass(frozen=True)
class SurfaceNode:
    """A node of MaterialX's that has a dielectric layer over a base: what it and its inputs are called.

    version : of MaterialX that has it. scales : whether its weight scales the layer, and with it what that leaves of
    the base; otherwise the layer's colour holds its strength.
    """

    name: str
    version: str
    weight: str
    base: str
    roughness: str
    metalness: str
    index: str
    normal: str
    scales: bool


NODES = {
    "materialx": SurfaceNode(
        "standard_surface", "1.38", "specular", "base", "diffuse_roughness", "metalness", "specular_IOR", "normal",
        True,
    ),
    "openpbr": SurfaceNode(
        "open_pbr_surface", "1.39", "specular_weight", "base_weight", "base_diffuse_roughness", "base_metalness",
        "specular_ior", "geometry_normal", False,
    ),
}  # fmt: skip


def write_materialx(
    folder: Path,
    shape: Shape,
    material: ExportedBRDF,
    mapping: Mapping,
    node: SurfaceNode,
    normal_codes: NDArray[np.uint8] | None = None,
) -> WrittenExport:
    """Write material.mtlx, the object as object.obj (metres, +Z up), and textures.

    normal_codes : (h, w, 3), of a normal map over the mesh's texture coordinates: right, up, outward.
    """
    numbers = mapping.numbers
    strongest = float(numbers.specular.max())
    weight = strongest if node.scales or strongest == 0 else 1.0
    tint = numbers.specular / weight if weight > 0 else np.ones(3)
    maps: dict[str, Floats] = {}
    notes: list[str] = []
    base = numbers.base
    if material.textures is not None:
        texels = texels_of(material.textures, material.brdf.ks)
        varies = np.ptp(texels.strength) > 0 and weight > 0
        # One weight for all, the strongest's: it says how far the lobe darkens the base; its colour does the rest.
        most = min(float(texels.strength.max()), 1 / weight) if varies and node.scales else 1.0
        maps["base_color"], note = clipped(
            base_texels(texels, mapping, material.brdf, most), "Kd", "base colour"
        )
        notes += note
        if varies:
            weight *= most
            maps["specular_color"], note = clipped(tint * texels.strength / most, "Ks", "specular weight")
            notes += note
    parameters = {
        node.base: 1.0,
        "base_color": base.tolist(),
        node.roughness: 0.0,
        node.metalness: 0.0,
        node.weight: weight,
        "specular_color": tint.tolist(),
        "specular_roughness": float(np.sqrt(numbers.alpha)),
        node.index: numbers.fresnel,
    }
    document = ET.Element("materialx", version=node.version, colorspace="lin_rec709")
    files = [MATERIAL_NAME, _MESH_NAME]
    for name, texels_map in maps.items():
        files.append(f"{name}.exr")
        write_exr(folder / files[-1], texels_map)
        image = ET.SubElement(document, "image", name=f"{name}_map", type="color3")
        ET.SubElement(image, "input", name="file", type="filename", value=files[-1], colorspace="lin_rec709")
    if normal_codes is not None:
        files.append("normals.png")
        write_png(folder / files[-1], normal_codes)
        image = ET.SubElement(document, "image", name="normals_image", type="vector3")
        ET.SubElement(image, "input", name="file", type="filename", value=files[-1])
        normals = ET.SubElement(document, "normalmap", name="normals", type="vector3")
        ET.SubElement(normals, "input", name="in", type="vector3", nodename="normals_image")
    shader = ET.SubElement(document, node.name, name="reflectance", type="surfaceshader")
    for name, value in parameters.items():
        kind = "float" if isinstance(value, float) else "color3"
        entry = ET.SubElement(shader, "input", name=name, type=kind)
        if name in maps:
            entry.set("nodename", f"{name}_map")
        else:
            entry.set("value", ", ".join(f"{v:.9g}" for v in np.atleast_1d(value)))
    if normal_codes is not None:
        ET.SubElement(shader, "input", name=node.normal, type="vector3", nodename="normals")
    surface = ET.SubElement(document, "surfacematerial", name="material", type="material")
    ET.SubElement(surface, "input", name="surfaceshader", type="surfaceshader", nodename="reflectance")
    look = ET.SubElement(document, "look", name="look")
    ET.SubElement(look, "materialassign", name="object", geom="/", material="material")
    ET.indent(document)
    ET.ElementTree(document).write(folder / MATERIAL_NAME, encoding="utf-8", xml_declaration=True)
    write_mesh(folder / _MESH_NAME, shape.mesh)
    return WrittenExport(tuple(files), parameters, tuple(notes))

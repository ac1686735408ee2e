"""A result's material as a MaterialX document with a standard_surface, its textures and the object beside it."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import write_exr
from invrender.output.export.mapping import Mapping
from invrender.output.export.material import ExportedBRDF
from invrender.output.export.shape import Shape
from invrender.output.export.texels import base_texels, texels_of
from invrender.output.export.written import WrittenExport, clipped
from recon.mesh.trianglemesh import write_mesh

Floats = NDArray[np.float64]

MATERIAL_NAME, _MESH_NAME = "material.mtlx", "object.obj"


def write_materialx(folder: Path, shape: Shape, material: ExportedBRDF, mapping: Mapping) -> WrittenExport:
    """Write material.mtlx, the object as object.obj (metres, +Z up), and textures."""
    numbers = mapping.numbers
    weight = float(numbers.specular.max())
    tint = numbers.specular / weight if weight > 0 else np.ones(3)
    maps: dict[str, Floats] = {}
    notes: list[str] = []
    base = numbers.base
    if material.textures is not None:
        texels = texels_of(material.textures, material.brdf.ks)
        varies = np.ptp(texels.strength) > 0 and weight > 0
        # One weight for all, the strongest's: it says how far the lobe darkens the base; its colour does the rest.
        most = min(float(texels.strength.max()), 1 / weight) if varies else 1.0
        maps["base_color"], note = clipped(
            base_texels(texels, mapping, material.brdf, most), "Kd", "base colour"
        )
        notes += note
        if varies:
            weight *= most
            maps["specular_color"], note = clipped(tint * texels.strength / most, "Ks", "specular weight")
            notes += note
    parameters = {
        "base": 1.0,
        "base_color": base.tolist(),
        "diffuse_roughness": 0.0,
        "metalness": 0.0,
        "specular": weight,
        "specular_color": tint.tolist(),
        "specular_roughness": float(np.sqrt(numbers.alpha)),
        "specular_IOR": numbers.fresnel,
    }
    document = ET.Element("materialx", version="1.38", colorspace="lin_rec709")
    files = [MATERIAL_NAME, _MESH_NAME]
    for name, texels_map in maps.items():
        files.append(f"{name}.exr")
        write_exr(folder / files[-1], texels_map)
        image = ET.SubElement(document, "image", name=f"{name}_map", type="color3")
        ET.SubElement(image, "input", name="file", type="filename", value=files[-1], colorspace="lin_rec709")
    shader = ET.SubElement(document, "standard_surface", name="reflectance", type="surfaceshader")
    for name, value in parameters.items():
        kind = "float" if isinstance(value, float) else "color3"
        entry = ET.SubElement(shader, "input", name=name, type=kind)
        if name in maps:
            entry.set("nodename", f"{name}_map")
        else:
            entry.set("value", ", ".join(f"{v:.9g}" for v in np.atleast_1d(value)))
    surface = ET.SubElement(document, "surfacematerial", name="material", type="material")
    ET.SubElement(surface, "input", name="surfaceshader", type="surfaceshader", nodename="reflectance")
    look = ET.SubElement(document, "look", name="look")
    ET.SubElement(look, "materialassign", name="object", geom="/", material="material")
    ET.indent(document)
    ET.ElementTree(document).write(folder / MATERIAL_NAME, encoding="utf-8", xml_declaration=True)
    write_mesh(folder / _MESH_NAME, shape.mesh)
    return WrittenExport(tuple(files), parameters, tuple(notes))

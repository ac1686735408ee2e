"""A result as glTF 2.0 (.glb): metres, +Y up, metallic-roughness with KHR_materials_specular and KHR_materials_ior."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.files.documents import software
from capture.files.imagefile import write_exr
from capture.lighting import Lighting
from capture.srgb import linear_to_srgb
from invrender.output.export.glb import GlbBuffer
from invrender.output.export.gltf_target import index_of
from invrender.output.export.lights import panorama
from invrender.output.export.mapping import Mapping
from invrender.output.export.material import ExportedBRDF
from invrender.output.export.shape import Shape
from invrender.output.export.texels import base_texels, texels_of
from invrender.output.export.written import WrittenExport, clipped

Floats = NDArray[np.float64]

MODEL_NAME, ENVIRONMENT_NAME = "object.glb", "environment.exr"
# Our +Z is glTF's +Y, our +Y its -Z.
TO_GLTF = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
_REPEAT, _LINEAR, _MIPMAPS = 10497, 9729, 9987


def write_gltf(
    folder: Path,
    name: str,
    shape: Shape,
    material: ExportedBRDF,
    mapping: Mapping,
    lighting: Lighting | None,
    normal_codes: NDArray[np.uint8] | None = None,
) -> WrittenExport:
    """Write object.glb and, of a lighting with a map, environment.exr. lighting : None leaves the light out.

    normal_codes : (h, w, 3), of a normal map over the mesh's texture coordinates: right, up, outward.
    """
    buffer = GlbBuffer()
    mesh = shape.mesh
    attributes = {
        "POSITION": buffer.add_vertices(mesh.vertices @ TO_GLTF.T),
        "NORMAL": buffer.add_vertices(mesh.normals @ TO_GLTF.T),
    }
    if mesh.uv is not None:
        # v runs down in glTF.
        attributes["TEXCOORD_0"] = buffer.add_vertices(np.column_stack([mesh.uv[:, 0], 1 - mesh.uv[:, 1]]))
    indices = buffer.add_indices(mesh.faces)
    described, images, notes = _material(name, material, mapping)
    if normal_codes is not None:
        described["normalTexture"] = {"index": len(images)}
        images["normals"] = normal_codes
    nodes: list[dict[str, Any]] = [{"name": name, "mesh": 0}]
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"lightfactor {software()['lightfactor']}"},
        "scene": 0,
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [described],
        "extensionsUsed": sorted(described["extensions"]),
    }
    if images:
        document["samplers"] = [
            {"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": _REPEAT, "wrapT": _REPEAT}
        ]
        document["images"] = [
            {"name": label, "mimeType": "image/png", "bufferView": buffer.add_bytes(_png(codes))}
            for label, codes in images.items()
        ]
        document["textures"] = [{"sampler": 0, "source": k} for k in range(len(images))]
    files = [MODEL_NAME]
    if lighting is not None:
        lights = [
            _light("directional", irradiance) if place is None else _light("point", place[1])
            for irradiance, place in zip(lighting.irradiances, lighting.places, strict=True)
        ]
        if lights:
            document["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
            document["extensionsUsed"].append("KHR_lights_punctual")
            nodes += [
                _light_node(
                    k,
                    {"rotation": _from_z(TO_GLTF @ direction).tolist()}
                    if place is None
                    else {"translation": (TO_GLTF @ place[0]).tolist()},
                )
                for k, (direction, place) in enumerate(zip(lighting.directions, lighting.places, strict=True))
            ]
        if lighting.radiance_map is not None:
            write_exr(folder / ENVIRONMENT_NAME, panorama(lighting.radiance_map))
            files.append(ENVIRONMENT_NAME)
    document["nodes"], document["scenes"] = nodes, [{"nodes": list(range(len(nodes)))}]
    (folder / MODEL_NAME).write_bytes(buffer.file(document))
    written: dict[str, Any] = {key: described[key] for key in ("pbrMetallicRoughness", "extensions")}
    return WrittenExport(tuple(files), written, tuple(notes))


def _material(
    name: str, material: ExportedBRDF, mapping: Mapping
) -> tuple[dict[str, Any], dict[str, NDArray[np.uint8]], list[str]]:
    """The material, its images by their names (codes (h, w, 3 or 4)), and notes."""
    values = mapping.numbers
    surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": float(np.sqrt(values.alpha))}
    described: dict[str, Any] = {"name": name, "pbrMetallicRoughness": surface}
    surface["baseColorFactor"] = [*values.base.tolist(), 1.0]
    f0 = float(values.specular.max())
    specular: dict[str, Any] = {
        "specularFactor": values.fresnel,
        "specularColorFactor": (values.specular / f0).tolist(),
    }
    described["extensions"] = {"KHR_materials_specular": specular, "KHR_materials_ior": {"ior": index_of(f0)}}
    if material.textures is None:
        return described, {}, []
    texels = texels_of(material.textures, material.brdf.ks)
    base, note = clipped(base_texels(texels, mapping, material.brdf, texels.brightest), "Kd", "base colour")
    images, notes = {"base colour": _srgb_codes(base)}, [*note]
    surface |= {"baseColorFactor": [1.0, 1.0, 1.0, 1.0], "baseColorTexture": {"index": 0}}
    if np.ptp(texels.strength) > 0:
        factor, note = clipped(values.fresnel * texels.brightest, "Ks", "specular factor")
        notes += note
        most = float(factor.max()) or 1.0
        tint = texels.strength / np.where(texels.brightest > 0, texels.brightest, 1)[..., None]
        alpha = np.round(factor / most * 255).astype(np.uint8)
        images["specular"] = np.dstack([_srgb_codes(tint), alpha])
        specular |= {
            "specularFactor": most,
            "specularTexture": {"index": 1},
            "specularColorTexture": {"index": 1},
        }
    return described, images, notes


def _light(kind: str, strength: Floats) -> dict[str, Any]:
    """A source; its intensity is its irradiance, or that times metres squared, in the unit of the light, not lux."""
    most = float(strength.max())
    return {
        "type": kind,
        "color": (strength / (most or 1.0)).tolist(),
        "intensity": most,
    }


def _light_node(index: int, placed: dict[str, Any]) -> dict[str, Any]:
    """A source's node. placed : of one far away the rotation after which light goes along -Z, else its translation."""
    return {
        "name": f"source {index + 1}",
        **placed,
        "extensions": {"KHR_lights_punctual": {"light": index}},
    }


def _from_z(direction: Floats) -> Floats:
    """The quaternion (x, y, z, w) of a rotation that takes +Z to a unit direction."""
    x, y, z = direction
    if z < -1 + 1e-9:
        return np.array([1.0, 0, 0, 0])
    quaternion = np.array([-y, x, 0, 1 + z])
    return np.asarray(quaternion / np.linalg.norm(quaternion))


def _srgb_codes(linear: Floats) -> NDArray[np.uint8]:
    return np.asarray(np.round(linear_to_srgb(linear) * 255).astype(np.uint8))


def _png(codes: NDArray[np.uint8]) -> bytes:
    order = [2, 1, 0, 3][: codes.shape[2]]
    _, data = cv2.imencode(".png", np.ascontiguousarray(codes[:, :, order]))
    return data.tobytes()

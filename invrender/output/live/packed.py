"""A live scene as bytes: a JSON header that says where each array is, then the arrays; compressed.

4 bytes, little endian : length of the header
header : UTF-8, padded with spaces to a multiple of 8 bytes; "arrays" has type, shape and offset of each
arrays : little endian, each at a multiple of 8 bytes after the header
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from invrender.output.live.live_light import LiveLight
from invrender.output.live.live_material import LEAST_KNOWN, LiveReflectance
from invrender.output.live.scene import LiveScene
from invrender.transport.visibility import MIN_COS

_TYPES = {"float16": "f16", "float32": "f32", "uint32": "u32", "uint8": "u8"}
_ALIGNED = 8


def packed(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], level: int = 9) -> bytes:
    """A header and arrays of half or single floats, uint32 or uint8, as one block; level : of compression, 1 to 9."""
    described, parts, offset = {}, [], 0
    for name, values in arrays.items():
        data = np.ascontiguousarray(values).tobytes()
        described[name] = {"type": _TYPES[values.dtype.name], "shape": list(values.shape), "offset": offset}
        parts.append(data.ljust(-(-len(data) // _ALIGNED) * _ALIGNED, b"\0"))
        offset += len(parts[-1])
    text = json.dumps({**header, "arrays": described}, allow_nan=False).encode()
    # The header's end, after the four bytes of its length, is aligned, too.
    length = -(-(len(text) + 4) // _ALIGNED) * _ALIGNED - 4
    block = b"".join([length.to_bytes(4, "little"), text.ljust(length), *parts])
    # No clock in what is compressed: the same scene is the same bytes.
    return gzip.compress(block, level, mtime=0)


def packed_subject(scene: LiveScene) -> bytes:
    """What lights share: surface, reflectance, the lobe's table, the camera. Lengths are in radii about the centre."""
    return packed(*_subject(scene))


def packed_light(light: LiveLight) -> bytes:
    """One light; radiance and irradiance are over its unit."""
    return packed(*_light(light))


def packed_scene(scene: LiveScene) -> bytes:
    """A scene of one light in one block: what `packed_subject` and `packed_light` hold, under the scene's name."""
    (subject, surface), (light, tables) = _subject(scene), _light(scene.lights[0])
    return packed(light | subject, surface | tables)


def _subject(scene: LiveScene) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    mesh, camera = scene.mesh, scene.optics.camera
    arrays: dict[str, NDArray[Any]] = {
        "positions": ((mesh.vertices - scene.centre) / scene.radius).astype(np.float32),
        "normals": mesh.normals.astype(np.float16),
        "faces": mesh.faces.astype(np.uint32),
        "volume": scene.volume.values,
        "transmitted": scene.transmitted,
    }
    if mesh.uv is not None:
        arrays["uv"] = mesh.uv.astype(np.float32)
    for name, of in (("kd", scene.kd), ("ks", scene.ks)):
        arrays |= _reflectance(name, of)
    distance = scene.first_view.distance
    header = {
        "name": scene.name,
        "centre": scene.centre.tolist(),
        "radius": scene.radius,
        "shadows": scene.has_shadows,
        "width": scene.volume.width,
        "leastCos": MIN_COS,
        "leastKnown": LEAST_KNOWN,
        "hasGaps": scene.kd.has_gaps,
        "notes": list(scene.notes),
        "kd": scene.kd.scale.tolist(),
        "ks": scene.ks.scale.tolist(),
        "camera": {
            "orthographic": camera.is_orthographic,
            # Half the picture's sides over the focal length, or, orthographic, in radii.
            "reach": [
                side / 2 / camera.focal_px / (scene.radius if camera.is_orthographic else 1)
                for side in (camera.width, camera.height)
            ],
            "radii": scene.optics.radii if distance is None else distance / scene.radius,
            "azimuth": scene.first_view.azimuth,
            "elevation": scene.first_view.elevation,
        },
    }
    return header, arrays


def _light(light: LiveLight) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    header = {"name": light.name, "unit": light.unit, "orders": light.maps.orders.tolist()}
    return header, {
        "lamps": light.lamps.astype(np.float32),
        "irradiances": light.irradiances.astype(np.float32),
        "series": light.series,
        "maps": light.maps.maps,
        "functions": light.maps.functions,
    }


def _reflectance(name: str, of: LiveReflectance) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {f"{name}Codes": of.codes}
    if np.ptp(of.at_vertices.astype(np.float32)) > 0:
        arrays[f"{name}AtVertices"] = of.at_vertices
    return arrays

"""What was photographed: its shape in its place, and what it hides from itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture.files.documents import numbers
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from invrender.brdf.form import Axis
from invrender.transport.visibility import Shadows
from invrender.wording import sentences
from recon.mesh.bodies import Body, MeshBody, SphereBody
from recon.mesh.transfercache import cached_transfer
from recon.sampling.find import FoundBody, find_body

# Spheres are brushed along their parallels unless a set says otherwise.
_UPRIGHT = (0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class SceneGeometry:
    """An object of a photo set.

    found : its shape, checked against the masks. shadows : of a mesh on itself; None of a sphere, which has none.
    description : what result.json says of it. warnings : sentences on it. brushing_axis : that its surface would be
    brushed about; None of a mesh, whose tangents nothing states.
    """

    found: FoundBody
    shadows: Shadows | None
    description: Mapping[str, Any]
    warnings: tuple[str, ...]
    brushing_axis: Axis | None = None

    @property
    def body(self) -> Body:
        return self.found.body


def find_geometry(photoset: PhotoSet, track: Track = silent, shadowing: bool = True) -> SceneGeometry:
    """The object of a set; ValueError says what contradicts what.

    shadowing : False leaves a mesh's shadows on itself out, to show what they amount to.
    """
    found = find_body(photoset, track)
    warnings = list(found.warnings)
    shadows = None
    if isinstance(found.body, MeshBody) and shadowing:
        assert found.mesh is not None
        assert photoset.object.mesh is not None
        assert photoset.mesh_to_world is not None
        mesh_file = photoset.resolve(photoset.object.mesh)
        transfer, unkept = cached_transfer(found.mesh, mesh_file)
        warnings += [unkept] if unkept else []
        shadows = Shadows.of(found.body, transfer.rotated(photoset.mesh_to_world[:3, :3]))
    described = _description(photoset, found)
    return SceneGeometry(found, shadows, described, tuple(sentences(warnings)), brushing_axis(photoset))


def brushing_axis(photoset: PhotoSet) -> Axis | None:
    """The axis, unit, of the circles that a set's object would be brushed along; None of a mesh."""
    if photoset.object.shape != "sphere":
        return None
    x, y, z = photoset.object.brushed_about or _UPRIGHT
    length = float(np.linalg.norm((x, y, z)))
    return x / length, y / length, z / length


def _description(photoset: PhotoSet, found: FoundBody) -> dict[str, Any]:
    if isinstance(found.body, SphereBody):
        sphere = found.body.sphere
        return {
            "shape": "sphere",
            "centre": numbers(sphere.centre),
            "radius": sphere.radius,
            # In order of centre and radius; zero where given.
            "std": numbers(np.sqrt(np.diag(sphere.covariance))),
            "outline_rms_px": [round(r, 4) for r in sphere.residual_px],
        }
    assert isinstance(found.body, MeshBody)
    assert photoset.mesh_to_world is not None
    vertices = found.body.mesh.vertices
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return {
        "shape": "mesh",
        "mesh": photoset.object.mesh,
        "unit": photoset.object.unit,
        "mesh_to_world": numbers(photoset.mesh_to_world),
        "centre": numbers(centre),
        # Of the sphere about the centre that holds it.
        "radius": float(np.linalg.norm(vertices - centre, axis=1).max()),
        "mask_overlap": [None if overlap is None else round(overlap, 4) for overlap in found.overlaps],
    }

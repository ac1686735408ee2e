"""Whether a mesh, where it is said to lie, is what the photographs show."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from recon.bodies import MeshBody, body_coverage
from recon.conventions import other_conventions

Floats = NDArray[np.float64]
Coverage = NDArray[np.float32]

# Overlap (intersection over union) of mesh and mask below which they don't show the same thing; and below which
# the fit deserves a warning.
_MIN_OVERLAP, _GOOD_OVERLAP = 0.8, 0.95
# Pixels of a photograph that are looked at: enough to tell a percent of a small object.
_LOOKS = 150_000
# Factors by which units are commonly mistaken: metres for mm, cm; inches for mm, cm; and the like.
_UNIT_FACTORS = {
    0.001: "millimetres taken for metres",
    1000.0: "metres taken for millimetres",
    0.01: "centimetres taken for metres",
    100.0: "metres taken for centimetres",
    0.1: "millimetres taken for centimetres",
    10.0: "centimetres taken for millimetres",
    0.0254: "inches taken for metres",
    25.4: "inches taken for millimetres",
    2.54: "inches taken for centimetres",
}


@dataclass(frozen=True, eq=False)
class MaskedView:
    """One photograph: its name in messages, its camera, its mask (h, w) in 0 to 1 or None."""

    label: str
    camera: Camera
    coverage: Coverage | None


@dataclass(frozen=True)
class Placement:
    """How well a mesh fits its masks. overlaps : per photograph, intersection over union; None without a mask."""

    overlaps: tuple[float | None, ...]
    warnings: tuple[str, ...]


def check_placement(body: MeshBody, mesh_to_world: Floats, views: Iterable[MaskedView]) -> Placement:
    """Compare a mesh with the masks of all photographs, one after the other.

    mesh_to_world : (4, 4), where the body's mesh was put: wrong units scale it about its own origin.
    ValueError names the first photograph that doesn't show the mesh, and what would explain it: another unit or size,
    another convention of poses, faces inside out.
    """
    overlaps: list[float | None] = []
    poor = []
    for view in views:
        seen = _seen(body, view.camera)
        overlap = None if view.coverage is None else _overlap(seen, view.camera, view.coverage)
        if not seen.any() or (overlap is not None and overlap < _MIN_OVERLAP):
            raise ValueError(
                f"{view.label}: {_fault(body, view, overlap)}; {_remedy(body, mesh_to_world, view)}"
            )
        if overlap is not None and overlap < _GOOD_OVERLAP:
            poor.append(f"{view.label} {overlap:.0%}")
        overlaps.append(overlap)
    warnings = []
    if poor:
        warnings.append(
            f"mesh and mask overlap by less than {_GOOD_OVERLAP:.0%} in {len(poor)} of the photographs"
            f" ({', '.join(poor[:3])}{', ...' if len(poor) > 3 else ''}): `lightfactor align` may help"
        )
    if all(overlap is None for overlap in overlaps):
        warnings.append(
            "no photograph has a mask, so nothing has shown whether the mesh lies where it is seen: look at the figure,"
            " or give masks"
        )
    return Placement(tuple(overlaps), tuple(warnings))


def _fault(body: MeshBody, view: MaskedView, overlap: float | None) -> str:
    camera = view.camera
    depth = camera.depth(body.mesh.vertices)
    if not camera.is_orthographic and depth.max() <= 0:
        return "the mesh lies behind the camera"
    if not camera.is_orthographic and depth.min() <= 0:
        return f"the camera stands within the mesh, from {depth.min():.3g} to {depth.max():.3g} m before it"
    if overlap:
        return f"mesh and mask overlap by only {overlap:.0%}"
    return "the object isn't seen: the mesh projects outside the mask or the photograph"


def _remedy(body: MeshBody, mesh_to_world: Floats, view: MaskedView) -> str:
    if view.coverage is not None:
        flipped = _inside_out(body)
        if _fits(flipped, view.camera, view.coverage):
            return "it would fit if its faces were turned over: the mesh is inside out; flip its faces and normals"
        for factor, mistake in _UNIT_FACTORS.items():
            if _fits(body, _scaled(view.camera, mesh_to_world, factor), view.coverage):
                return f"it would fit if it were {factor:g} times as large: {mistake}? set unit in [object]"
        for factor, mistake in _UNIT_FACTORS.items():
            pose = view.camera.world_to_camera.copy()
            pose[:3, 3] *= factor
            if _fits(body, view.camera.posed(pose), view.coverage):
                return (
                    f"it would fit if the cameras' positions were {factor:g} times as large: {mistake}? give"
                    " world_to_camera in metres"
                )
        for name, convert in other_conventions().items():
            if _fits(body, view.camera.posed(convert(view.camera.world_to_camera)), view.coverage):
                return f"the pose looks like {name}"
        filling = _area_factor(body, mesh_to_world, view.camera, view.coverage)
        if filling is not None:
            return f"it would fit if it were {filling:.3g} times as large: check [object] unit and the mesh"
    return (
        "check world_to_camera, mesh_to_world, unit and the mask, or let `lightfactor align` place the mesh"
    )


def _fits(body: MeshBody, camera: Camera, coverage: Coverage) -> bool:
    return _overlap(_seen(body, camera), camera, coverage) >= _MIN_OVERLAP


def _scaled(camera: Camera, mesh_to_world: Floats, factor: float) -> Camera:
    """The camera that sees the mesh as this one would see it scaled about its own origin.

    world_to_camera . mesh_to_world . diag(f, f, f, 1) projects as it does divided by f.
    """
    of_mesh = camera.world_to_camera @ mesh_to_world
    of_mesh[:3, 3] /= factor
    return camera.posed(of_mesh @ np.linalg.inv(mesh_to_world))


def _area_factor(body: MeshBody, mesh_to_world: Floats, camera: Camera, coverage: Coverage) -> float | None:
    """By what the mesh must be scaled to fill its mask, if it then fits; None if it doesn't."""
    stride = _stride(camera)
    factor, wanted = 1.0, float((coverage[::stride, ::stride] >= 0.5).sum())
    for _ in range(4):
        area = float(_seen(body, _scaled(camera, mesh_to_world, factor)).sum())
        if not area:
            return None
        factor *= float(np.sqrt(wanted / area))
    return factor if _fits(body, _scaled(camera, mesh_to_world, factor), coverage) else None


def _inside_out(body: MeshBody) -> MeshBody:
    mesh = body.mesh
    return MeshBody(replace(mesh, faces=mesh.faces[:, ::-1], normals=-mesh.normals))


def _overlap(seen: NDArray[np.bool_], camera: Camera, coverage: Coverage) -> float:
    stride = _stride(camera)
    inside = coverage[::stride, ::stride] >= 0.5
    union = (seen | inside).sum()
    return float((seen & inside).sum() / union) if union else 0.0


def _seen(body: MeshBody, camera: Camera) -> NDArray[np.bool_]:
    """Whether every so many pixels show the mesh."""
    return body_coverage(body, camera, _stride(camera))


def _stride(camera: Camera) -> int:
    return max(int(np.sqrt(camera.width * camera.height / _LOOKS)), 1)

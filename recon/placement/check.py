"""Whether a mesh, where it is said to lie, is what the photographs show."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from recon.mesh.bodies import MeshBody, body_coverage
from recon.placement.misplacement import (
    GOOD_OVERLAP,
    MIN_OVERLAP,
    Look,
    common_mistake,
    overlap,
    single_mistake,
    stride_of,
    wrong_size,
)

Floats = NDArray[np.float64]
Coverage = NDArray[np.float32]

# Pixels of a photograph that are looked at: enough to resolve a percent of a small object.
_PIXELS = 150_000
# Photographs that don't fit after which the others aren't looked at.
_WITNESSES = 4


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

    mesh_to_world : (4, 4), where the body's mesh was put: wrong units and axes are about its own origin.
    ValueError names the first photograph that doesn't show the mesh, and what would explain it: if none shows it
    another unit or size, turned axes, another convention of poses, faces inside out, inverted masks; else what may be
    wrong with one photograph.
    """
    overlaps: list[float | None] = []
    fine: list[Look] = []
    poor: list[tuple[Look, float]] = []
    wrong: list[Look] = []
    fault = ""
    for view in views:
        stride = stride_of(view.camera, _PIXELS)
        seen = body_coverage(body, view.camera, stride)
        inside = None if view.coverage is None else view.coverage[::stride, ::stride] >= 0.5
        share = None if inside is None else overlap(seen, inside)
        look = Look(view.label, view.camera, stride, inside)
        if not seen.any() or (share is not None and share < MIN_OVERLAP):
            wrong.append(look)
            fault = fault or _fault(body, view, share)
            if len(wrong) == _WITNESSES:
                break
        elif share is not None and share < GOOD_OVERLAP:
            poor.append((look.coarse(), share))
        elif share is not None:
            fine.append(look.coarse())
        overlaps.append(share)
    if wrong:
        right = fine + [look for look, _ in poor]
        why = single_mistake(body, wrong[0], right) if right else common_mistake(body, mesh_to_world, wrong)
        raise ValueError(f"{wrong[0].label}: {fault}; {why}")
    warnings = []
    if poor:
        looks = [look for look, _ in poor[:_WITNESSES]]
        advice = None if fine else wrong_size(body, mesh_to_world, looks, GOOD_OVERLAP)
        if advice is None:
            few = len(poor) < len(fine)
            advice = "check their masks and poses" if few else "`lightfactor align` may help"
        named = ", ".join(f"{look.label} {share:.0%}" for look, share in poor[:3])
        warnings.append(
            f"mesh and mask overlap by less than {GOOD_OVERLAP:.0%} in {len(poor)} of the photographs"
            f" ({named}{', ...' if len(poor) > 3 else ''}): {advice}"
        )
    if all(share is None for share in overlaps):
        warnings.append(
            "no photograph has a mask, so nothing has shown whether the mesh lies where it is seen: look at the figure,"
            " or give masks"
        )
    return Placement(tuple(overlaps), tuple(warnings))


def _fault(body: MeshBody, view: MaskedView, share: float | None) -> str:
    camera = view.camera
    depth = camera.depth(body.mesh.vertices)
    if not camera.is_orthographic and depth.max() <= 0:
        return "the mesh lies behind the camera"
    if not camera.is_orthographic and depth.min() <= 0:
        return f"the camera stands within the mesh, from {depth.min():.3g} to {depth.max():.3g} m before it"
    if share:
        return f"mesh and mask overlap by only {share:.0%}"
    return "the object isn't seen: the mesh projects outside the mask or the photograph"

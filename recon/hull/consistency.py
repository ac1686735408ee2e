"""Where silhouettes contradict each other: what one shows of the object and others cut away.

The hull of true silhouettes fills each of them. Where it doesn't, a photograph takes a dark part for background, or
background for the object, or a pose is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.wording import some_of
from recon.mesh.bodies import MeshBody, body_coverage
from recon.mesh.trianglemesh import TriangleMesh

Floats = NDArray[np.float64]
Coverage = NDArray[np.float32]

# Pixels of a photograph that are looked at, and of what the hull leaves out, the rays that are followed.
_LOOKED_AT, _RAYS = 300_000, 300
# Points along a ray, from the hull's middle as far as its size to either side.
_STEPS = 256
# How far inside a silhouette, in pixels, the hull must reach, beside two of its cells.
_MARGIN_PX = 2.0
# Share of a silhouette that is left out, beyond which it is worth a word.
_NOTABLE = 0.005
# Share of all photographs that may cut away what one of them shows; where more do, that one is the odd one.
_FEW = 0.4
# Share of what the worst photograph cuts away, above which another one is named beside it.
_WORTH_NAMING = 0.1


@dataclass(frozen=True)
class Contradiction:
    """What the hull leaves out of one photograph's silhouette.

    photo : its place among the photographs. share : of the silhouette's pixels. column, row : amid what is left
    out. cut_by : places of the photographs that cut it away, by how much they do; empty where most others do.
    """

    photo: int
    share: float
    column: float
    row: float
    cut_by: tuple[int, ...]


def contradictions(
    mesh: TriangleMesh, cameras: Sequence[Camera], coverages: Sequence[Coverage], cells: int
) -> list[Contradiction]:
    """What a visual hull leaves out of the silhouettes (h, w) that it was made of, most first.

    cells : along its longest side.
    """
    body = MeshBody(mesh)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low))
    cell = float((high - low).max()) / cells
    insides = [coverage >= 0.5 for coverage in coverages]
    found = []
    for photo, (camera, inside) in enumerate(zip(cameras, insides, strict=True)):
        depth = 1.0 if camera.is_orthographic else abs(float(camera.depth(middle[None])[0]))
        margin = _MARGIN_PX + 2 * cell * camera.focal_px / depth
        stride = max(1, int(np.sqrt(inside.size / _LOOKED_AT)))
        # The picture's edge is no outline.
        away = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        left_out = (away[::stride, ::stride] > margin) & ~body_coverage(body, camera, stride)
        share = float(left_out.sum() / max(inside[::stride, ::stride].sum(), 1))
        if share < _NOTABLE:
            continue
        some = np.argwhere(left_out)
        row, column = stride * some[((some - some.mean(axis=0)) ** 2).sum(axis=1).argmin()] + 0.5
        some = some[:: -(-len(some) // _RAYS)] * stride
        points = _along(camera, some[:, ::-1].astype(float) + 0.5, middle, reach)
        cut_by = _dissenters(points, cameras, insides)
        found.append(Contradiction(photo, share, float(column), float(row), cut_by))
    return sorted(found, key=lambda entry: -entry.share)


def _along(camera: Camera, pixels: Floats, middle: Floats, reach: float) -> Floats:
    """Points (n, steps, 3) along the rays through pixels (n, 2), about where they pass a point nearest."""
    origins, directions = camera.rays(pixels)
    nearest = ((middle - origins) * directions).sum(axis=1)
    steps = nearest[:, None] + np.linspace(-reach, reach, _STEPS)
    return np.asarray(origins[:, None] + np.maximum(steps, 0)[..., None] * directions[:, None])


def _dissenters(
    points: Floats, cameras: Sequence[Camera], insides: Sequence[NDArray[np.bool_]]
) -> tuple[int, ...]:
    """Which photographs cut away rays (n, steps, 3) at the points that most of the others show as the object."""
    within = np.stack(
        [_shown(camera, inside, points) for camera, inside in zip(cameras, insides, strict=True)]
    )
    best = within.sum(axis=0).argmax(axis=1)
    against = ~within[:, np.arange(len(best)), best]
    few = against.sum(axis=0) <= max(_FEW * len(cameras), 1)
    if few.mean() < 0.5:
        return ()
    votes = against[:, few].mean(axis=1)
    order = np.argsort(-votes)
    return tuple(int(k) for k in order if votes[k] > 0.25 * votes[order[0]])


def _shown(camera: Camera, inside: NDArray[np.bool_], points: Floats) -> NDArray[np.bool_]:
    """Whether a photograph shows points (n, steps, 3) within its silhouette; beyond its edge that goes on."""
    pixels = np.nan_to_num(camera.project(points.reshape(-1, 3)), nan=-1.0)
    columns, rows = np.clip(pixels.astype(int), 0, np.array(inside.shape[::-1]) - 1).T
    return inside[rows, columns].reshape(points.shape[:2])


def contradiction_warning(
    found: Sequence[Contradiction], names: Sequence[str], masked: Sequence[bool], background: float
) -> str | None:
    """A sentence on the photographs that contradict each other, and what to do; None if there are none.

    names, masked : of all photographs, and whether they have masks. background : the share of brightness below which
    the others' pixels count as background.
    """
    if not found:
        return None
    shown = [
        f"{names[each.photo]} ({each.share:.1%} of its silhouette, about column {each.column:.0f}, row {each.row:.0f})"
        for each in found
    ]
    weights = {
        k: sum(each.share for each in found if k in each.cut_by) for each in found for k in each.cut_by
    }
    most = max(weights.values(), default=0.0)
    cutting = [
        names[k] for k in sorted(weights, key=lambda k: -weights[k]) if weights[k] > _WORTH_NAMING * most
    ]
    remedy = (
        "check their masks and poses"
        if all(masked)
        else f"give masks; a lower --background (now {background:g}) keeps more of the dark parts"
    )
    return (
        f"silhouettes contradict each other: the hull lacks parts that are in {some_of(shown)}."
        f" For {some_of(cutting) if cutting else 'most of the other photographs'} they are background. Look for dark"
        f" parts of the object in these, and for bright background in those; {remedy}."
    )

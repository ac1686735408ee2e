"""Whether poses and masks agree: a body seen in all masks must fill them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from recon.hull.visualhull import visual_hull
from recon.mesh.rays import RayTracer

Floats = NDArray[np.float64]
Coverage = NDArray[np.float32]
# By name, functions that turn world_to_camera as it was read into what it is if it was written in another convention.
Conventions = Mapping[str, Callable[[Floats], Floats]]

# Shares of the masks that their common body fills (mean): true poses and masks reach 0.99; below the first something is
# wrong, below the second doubtful. Another convention must fill so much more to be named.
_WRONG, _DOUBTFUL, _BETTER = 0.7, 0.95, 0.15
# Photographs and points in each mask that are looked at, and cells of the body.
_PHOTOS, _POINTS, _CELLS = 24, 300, 64


def check_silhouettes(
    cameras: Sequence[Camera],
    coverages: Sequence[Coverage],
    labels: Sequence[str],
    conventions: Conventions,
    otherwise: str,
) -> str | None:
    """None if the masks have a body in common that fills them, a warning if it hardly does.

    otherwise : what to do if the poses look like no other convention either. ValueError if there is no such body; it
    says which convention the poses look like.
    """
    chosen = np.unique(np.linspace(0, len(cameras) - 1, min(len(cameras), _PHOTOS)).astype(int))
    cameras, coverages = [cameras[n] for n in chosen], [coverages[n] for n in chosen]
    shares = filled_shares(cameras, coverages)
    share, worst = float(shares.mean()), labels[chosen[int(np.argmin(shares))]]
    if share >= _DOUBTFUL:
        return None
    what = (
        "the object doesn't project into its masks: a body that all photos show within their masks fills only"
        f" {share:.0%} of them (mean; {worst} least, {shares.min():.0%})"
    )
    others = {
        name: float(filled_shares([_reposed(camera, convert) for camera in cameras], coverages).mean())
        for name, convert in conventions.items()
    }
    best = max(others, key=others.__getitem__, default="")
    if best and others[best] > max(_WRONG, share + _BETTER):
        raise ValueError(f"{what}; the poses look like {best}")
    if share < _WRONG:
        raise ValueError(f"{what}; {otherwise}")
    return f"{what}; {otherwise}"


def check_viewing_directions(cameras: Sequence[Camera], conventions: Conventions) -> None:
    """ValueError if cameras look away from the point that they surround, and wouldn't in another convention."""
    if _looking(cameras) >= 0.5:
        return
    others = [
        name
        for name, convert in conventions.items()
        if _looking([_reposed(camera, convert) for camera in cameras]) == 1
    ]
    if others:
        raise ValueError(
            f"the cameras look away from the point that they surround; the poses look like {', or '.join(others)}"
            + ("; masks would decide which" if len(others) > 1 else "")
        )


def filled_shares(cameras: Sequence[Camera], coverages: Sequence[Coverage]) -> Floats:
    """Shares (c,) of masks that the masks' visual hull fills; zeros where they have no body in common."""
    try:
        hull = visual_hull(cameras, coverages, cells=_CELLS)
        tracer = RayTracer(hull.vertices, hull.faces)
    except ValueError:
        return np.zeros(len(cameras))
    shares = []
    for camera, coverage in zip(cameras, coverages, strict=True):
        rows, columns = np.nonzero(coverage >= 0.5)
        some = np.linspace(0, len(rows) - 1, min(len(rows), _POINTS)).astype(int)
        origins, directions = camera.rays(np.column_stack([columns, rows])[some] + 0.5)
        known = np.isfinite(directions).all(axis=1)
        shares.append(tracer.met(origins[known], directions[known]).mean())
    return np.array(shares)


def _reposed(camera: Camera, convert: Callable[[Floats], Floats]) -> Camera:
    return camera.posed(convert(camera.world_to_camera))


def _looking(cameras: Sequence[Camera]) -> float:
    """Share of cameras that have the point nearest to all optical axes before them."""
    axes = np.array([camera.world_to_camera[2, :3] for camera in cameras])
    centres = np.array([camera.centre for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    matrix = across.sum(axis=0)
    if np.linalg.cond(matrix) > 1e4:
        return 1.0
    point = np.linalg.solve(matrix, np.einsum("nij,nj->i", across, centres))
    return float((((point - centres) * axes).sum(axis=1) > 0).mean())

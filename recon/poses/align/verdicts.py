"""Whether a mesh fits its masks where it was put, whether elsewhere as well, and if not, what would explain it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture.selection import as_good
from recon.mesh.rays import RayTracer
from recon.mesh.shape import METRES
from recon.poses.align.outlines import Outline
from recon.poses.align.refine import PlaceResiduals, RefinedPlace, residuals_at
from recon.poses.align.silhouettes import overlap

Floats = NDArray[np.float64]

# Silhouettes that stay farther from the outlines than this, in pixels or as a share of the object's radius, don't fit;
# nor do those whose areas overlap the masks' by less.
_MAX_OFF_PX, _MAX_OFF_SHARE, _MIN_OVERLAP = 1.5, 0.015, 0.8
# A place is ruled out that fits worse than the best by so many standard errors, and by more than a hair: both are as
# exact as the search for the least residual, so that a tiny difference may be sure and mean nothing.
_RULED_OUT, _HAIR_PX, _HAIR_SHARE = 4.0, 0.02, 0.1
# Turn by which it is tried whether a mesh looks the same all around, degrees: no symmetry of a polygon.
_ODD_TURN = np.radians(17)


def misfit_px(refined: RefinedPlace) -> float:
    """Mean distance of silhouettes from outlines in pixels; where none is found, as far as it was looked for."""
    left = refined.left
    return float(np.where(left.found, np.abs(left.offsets), left.reach).mean()) if len(left.found) else 0.0


def off_px(left: PlaceResiduals, photos: int) -> Floats:
    """Robust distance of silhouettes from outlines, pixels, of each photo (n,): the RMS where it is Gaussian."""
    off = np.where(left.found, np.abs(left.offsets), left.reach)
    return np.array([1.4826 * float(np.median(off[left.photo == photo])) for photo in range(photos)])


def tolerated_px(outlines: Sequence[Outline]) -> float:
    """How far silhouettes may stay from outlines and still fit, pixels."""
    radius = float(np.median([outline.radius for outline in outlines])) if outlines else 0.0
    return max(_MAX_OFF_PX, _MAX_OFF_SHARE * radius)


def fits(tracer: RayTracer, outlines: Sequence[Outline], fit: RefinedPlace) -> bool:
    """Whether silhouettes lie on outlines, and areas on areas; true without outlines."""
    if not outlines:
        return True
    left = fit.left
    off = np.where(left.found, np.abs(left.offsets), left.reach)
    near = 1.4826 * float(np.median(off)) <= tolerated_px(outlines)
    areas = [overlap(tracer, fit.place, outline) for outline in outlines]
    return near and float(np.median(areas)) >= _MIN_OVERLAP


def ruled_out(best: RefinedPlace, other: RefinedPlace) -> bool:
    """Whether the other is worse beyond chance, judged by sectors of outlines."""
    cluster = best.left.photo * 1000 + best.left.sector
    _, cluster = np.unique(cluster, return_inverse=True)
    far = 4 * misfit_px(best) + 1.0
    size = np.bincount(cluster)
    losses, least = (np.bincount(cluster, _capped(fit, far)) / size for fit in (other, best))
    return not as_good(losses, least, _RULED_OUT, max(_HAIR_PX, _HAIR_SHARE * misfit_px(best)))


def _capped(fit: RefinedPlace, most: float) -> Floats:
    return np.where(fit.left.found, np.minimum(np.abs(fit.left.offsets), most), most)


def open_axis(tracer: RayTracer, outlines: Sequence[Outline], fit: RefinedPlace) -> Floats | None:
    """The axis (3,), mesh frame, about which the mesh fits as well when it is turned, if there is one.

    Asked of the fit itself, not of its derivative: a vase's facets make ripples, which look like knowledge.
    """
    corners = tracer.vertices[tracer.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    middle = np.average(corners.mean(axis=1), axis=0, weights=areas)
    arms = corners.mean(axis=1) - middle
    for axis in np.linalg.eigh((arms * areas[:, None]).T @ arms)[1].T:
        turn = np.append(_ODD_TURN * fit.place.rotation @ axis, np.zeros(4))
        pivot = fit.place.apply(middle[None])[0]
        turned = replace(fit, place=fit.place.moved(turn, pivot))
        if not ruled_out(fit, replace(fit, left=residuals_at(tracer, outlines, turned))):
            return np.asarray(axis)
    return None


def wrong_size(factor: float, unit: str) -> str:
    """The sentence for a mesh that fits if it is `factor` times as large as its unit, "m", "cm" or "mm", says."""
    metres = factor * METRES[unit]
    for name, size in METRES.items():
        if abs(np.log(metres / size)) < 0.06 and name != unit:
            return (
                f"the mesh fits its masks if it is {factor:.4g} times as large: set unit = {name!r} in"
                " [object], or give poses in metres if it is they that aren't"
            )
    if abs(np.log(metres / 0.0254)) < 0.06:
        return (
            f"the mesh fits its masks if it is {factor:.4g} times as large: it looks like inches; scale it by 25.4 in"
            " a mesh editor and set unit = 'mm' in [object]"
        )
    return (
        f"the mesh fits its masks if it is {factor:.4g} times as large: check its unit (now {unit!r}) and the scale of"
        " the poses, or let --free-scale scale the cameras' positions instead"
    )

"""Find the sphere of a photo set and check that poses, masks and camera conventions agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from recon.mesh.bodies import SphereBody, body_coverage
from recon.placement.conventions import other_conventions
from recon.placement.misplacement import INVERTED, MIN_OVERLAP, overlap
from recon.sphere.fit import fit_sphere
from recon.sphere.outline import Silhouette
from recon.sphere.sphere import Sphere

# A silhouette whose outline lies further from a sphere's than this (in pixels, or as a share of the radius)
# is not a sphere's.
_MAX_RESIDUAL_PX = 1.5
_MAX_RESIDUAL_SHARE = 0.03
# Points without which an outline determines nothing.
_LEAST_POINTS = 12


@dataclass(frozen=True, eq=False)
class LocatedPhoto:
    """What locating needs of one photograph. label : its name in messages. silhouette : of the object, if known."""

    label: str
    camera: Camera
    silhouette: Silhouette | None


def locate_sphere(
    views: Sequence[LocatedPhoto], centre: Sequence[float] | None = None, radius: float | None = None
) -> Sphere:
    """The sphere in the views: as given, or fitted to the silhouettes; ValueError names the view that disagrees."""
    if centre is not None and radius is not None:
        sphere = Sphere(np.asarray(centre, float), radius, np.zeros((4, 4)))
        _check_given(sphere, views)
        outlined = [
            v for v in views if v.silhouette is not None and len(v.silhouette.points) >= _LEAST_POINTS
        ]
        return _fit(outlined, [v.camera for v in outlined], centre, radius) if outlined else sphere
    seen = [view for view in views if view.silhouette is not None]
    if not seen:
        raise ValueError(
            f"{views[0].label}: no mask is given and no sphere was found in this photograph or another; write"
            " mask = '...' in each [[photo]] (nonzero where the object is), or give centre and radius in [object]"
        )
    for view in seen:
        _check_silhouette(view)
    sphere = _fit(seen, [view.camera for view in seen], centre, radius)
    _check_fit(sphere, seen, centre, radius)
    return sphere


def _check_silhouette(view: LocatedPhoto) -> None:
    assert view.silhouette is not None
    covered = view.silhouette.covered
    if covered is None:
        return
    border = np.concatenate([covered[0], covered[-1], covered[:, 0], covered[:, -1]])
    if border.mean() > 0.5:
        raise ValueError(f"{view.label}: its mask covers the image's border; is it inverted?")
    if covered.sum() < 50:
        raise ValueError(f"{view.label}: its mask marks fewer than 50 pixels; is it the right mask?")
    if len(view.silhouette.points) < _LEAST_POINTS:
        raise ValueError(
            f"{view.label}: its mask's outline has fewer than {_LEAST_POINTS} points; the object is too small or fills"
            " the image"
        )


def _fit(
    views: Sequence[LocatedPhoto],
    cameras: Sequence[Camera],
    centre: Sequence[float] | None,
    radius: float | None,
) -> Sphere:
    return fit_sphere(cameras, [v.silhouette for v in views if v.silhouette is not None], centre, radius)


def _tolerance_px(sphere: Sphere, camera: Camera) -> float:
    return max(_MAX_RESIDUAL_PX, _MAX_RESIDUAL_SHARE * sphere.pixel_radius(camera))


def _misfit(sphere: Sphere, views: Sequence[LocatedPhoto], cameras: Sequence[Camera]) -> tuple[float, int]:
    """The largest residual over its tolerance, and the view that has it; infinite behind a camera."""
    excess = []
    for camera, residual in zip(cameras, sphere.residual_px, strict=True):
        behind = not camera.is_orthographic and camera.depth(sphere.centre)[0] <= sphere.radius
        excess.append(np.inf if behind else residual / _tolerance_px(sphere, camera))
    worst = int(np.argmax(excess))
    return excess[worst], worst


def _check_fit(
    sphere: Sphere, views: Sequence[LocatedPhoto], centre: Sequence[float] | None, radius: float | None
) -> None:
    excess, worst = _misfit(sphere, views, [view.camera for view in views])
    if excess <= 1:
        return
    residual = sphere.residual_px[worst]
    silhouette = views[worst].silhouette
    whose = "its mask's" if silhouette is None or silhouette.packed is not None else "the object's"
    what = f"{whose} outline is {residual:.1f} px (RMS) from the sphere that fits all photos"
    if np.isinf(excess):
        what = "the sphere that fits all photos lies behind this camera"
    advice = "check this photo's mask and pose, and the camera's parameters"
    others = {}
    for name, convert in other_conventions().items():
        cameras = [view.camera.posed(convert(view.camera.world_to_camera)) for view in views]
        others[name] = _misfit(_fit(views, cameras, centre, radius), views, cameras)[0]
    # The best of them, not the first: along a short arc of cameras more than one may fit.
    best = min(others, key=others.__getitem__)
    if others[best] <= 1:
        advice = f"the poses look like {best}"
    raise ValueError(f"{views[worst].label}: {what}; {advice}")


def _check_given(sphere: Sphere, views: Sequence[LocatedPhoto]) -> None:
    for view in views:
        camera, problem = view.camera, ""
        if not camera.is_orthographic and camera.depth(sphere.centre)[0] <= sphere.radius:
            problem = "the sphere of [object] lies behind the camera (or around it)"
        else:
            disk = body_coverage(SphereBody(sphere), camera)
            if not disk.any():
                problem = "the sphere of [object] projects outside this photograph"
            elif (share := _overlap(disk, view)) is not None and share < MIN_OVERLAP:
                problem = f"the sphere of [object] and the mask overlap by only {share:.0%}"
        if problem:
            raise ValueError(f"{view.label}: {problem}; {_suspect(sphere, view)}")


def _suspect(sphere: Sphere, view: LocatedPhoto) -> str:
    inside = None if view.silhouette is None else view.silhouette.covered
    if inside is not None and overlap(body_coverage(SphereBody(sphere), view.camera), ~inside) >= MIN_OVERLAP:
        return INVERTED
    for name, convert in other_conventions().items():
        camera = view.camera.posed(convert(view.camera.world_to_camera))
        if camera.is_orthographic or camera.depth(sphere.centre)[0] > sphere.radius:
            disk = body_coverage(SphereBody(sphere), camera)
            share = _overlap(disk, view)
            if disk.any() if share is None else share >= MIN_OVERLAP:
                return f"the pose looks like {name}"
    return "check world_to_camera, the camera's parameters, and [object] centre and radius (metres)"


def _overlap(disk: NDArray[np.bool_], view: LocatedPhoto) -> float | None:
    """Intersection over union of a disk and a view's mask; None without a mask."""
    inside = None if view.silhouette is None else view.silhouette.covered
    return None if inside is None else overlap(disk, inside)

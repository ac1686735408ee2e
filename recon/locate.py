"""Find the sphere of a photo set and check that poses, masks and camera conventions agree."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from recon.lightfield import sphere_coverage
from recon.outline import largest_blob
from recon.sphere import Sphere, fit_sphere

Coverage = NDArray[np.float32]

# A mask whose outline strays further from a sphere's than this (in pixels, or as a share of the radius)
# is not a sphere's.
_MAX_RESIDUAL_PX = 1.5
_MAX_RESIDUAL_SHARE = 0.03
# Overlap (intersection over union) below which a given sphere and a mask are not the same thing.
_MIN_OVERLAP = 0.8

_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
_OTHER_CONVENTIONS: dict[str, Callable[[NDArray[np.float64]], NDArray[np.floating]]] = {
    "camera_to_world (OpenCV axes): invert it": lambda pose: np.linalg.inv(pose),
    "world_to_camera with OpenGL axes (y up, z backward): multiply by diag(1, -1, -1, 1) from the left": (
        lambda pose: _FLIP @ pose
    ),
    "camera_to_world with OpenGL or Blender axes: flip its y and z columns, then invert it": (
        lambda pose: np.linalg.inv(pose @ _FLIP)
    ),
}


@dataclass(frozen=True, eq=False)
class View:
    """What locating needs of one photograph. label : its name in messages. coverage : its mask, if any."""

    label: str
    camera: Camera
    coverage: Coverage | None


def locate_sphere(
    views: Sequence[View], centre: Sequence[float] | None = None, radius: float | None = None
) -> Sphere:
    """The sphere in the views: as given, or fitted to the masks; ValueError names the view that disagrees."""
    masked = [view for view in views if view.coverage is not None]
    if centre is not None and radius is not None:
        sphere = Sphere(np.asarray(centre, float), radius, np.zeros((4, 4)))
        _check_given(sphere, views)
        return sphere
    if not masked:
        raise ValueError(
            f"{views[0].label}: no mask is given; write mask = '...' in each [[photo]],"
            " or give centre and radius in [object]"
        )
    for view in masked:
        assert view.coverage is not None
        border = np.concatenate(
            [view.coverage[0], view.coverage[-1], view.coverage[:, 0], view.coverage[:, -1]]
        )
        if (border >= 0.5).mean() > 0.5:
            raise ValueError(f"{view.label}: its mask covers the image's border; is it inverted?")
    sphere = _fit(masked, [view.camera for view in masked], centre, radius)
    _check_fit(sphere, masked, centre, radius)
    return sphere


def disk_mask(label: str, camera: Camera, radiance: NDArray[np.float32]) -> Coverage:
    """A mask for a photograph that has none: its largest bright region, if that is a sphere's disk."""
    coverage = largest_blob(radiance)
    message = (
        f"{label}: no mask is given and no sphere was found in the photograph; write mask = '...'"
        " in its table (nonzero where the object is), or give centre and radius in [object]"
    )
    if coverage.sum() < 50:
        raise ValueError(message)
    try:
        sphere = fit_sphere([camera], [coverage])
    except ValueError as error:
        raise ValueError(message) from error
    overlap = _overlap(sphere_coverage(sphere, camera), coverage)
    if sphere.residual_px[0] > _tolerance_px(sphere, camera) or overlap < 0.95:
        raise ValueError(message)
    return coverage


def _fit(
    views: Sequence[View], cameras: Sequence[Camera], centre: Sequence[float] | None, radius: float | None
) -> Sphere:
    for view in views:
        assert view.coverage is not None
        if (view.coverage >= 0.5).sum() < 50:
            raise ValueError(f"{view.label}: its mask marks fewer than 50 pixels; is it the right mask?")
    return fit_sphere(cameras, [v.coverage for v in views if v.coverage is not None], centre, radius)


def _tolerance_px(sphere: Sphere, camera: Camera) -> float:
    return max(_MAX_RESIDUAL_PX, _MAX_RESIDUAL_SHARE * sphere.pixel_radius(camera))


def _misfit(sphere: Sphere, views: Sequence[View], cameras: Sequence[Camera]) -> tuple[float, int]:
    """The largest residual over its tolerance, and the view that has it; infinite behind a camera."""
    excess = []
    for camera, residual in zip(cameras, sphere.residual_px, strict=True):
        behind = not camera.is_orthographic and camera.depth(sphere.centre)[0] <= sphere.radius
        excess.append(np.inf if behind else residual / _tolerance_px(sphere, camera))
    worst = int(np.argmax(excess))
    return excess[worst], worst


def _check_fit(
    sphere: Sphere, views: Sequence[View], centre: Sequence[float] | None, radius: float | None
) -> None:
    excess, worst = _misfit(sphere, views, [view.camera for view in views])
    if excess <= 1:
        return
    residual = sphere.residual_px[worst]
    what = f"its mask's outline is {residual:.1f} px (RMS) from the sphere that fits all photos"
    if np.isinf(excess):
        what = "the sphere that fits all masks lies behind this camera"
    advice = "check this photo's mask and pose, and the camera's parameters"
    others = {}
    for name, convert in _OTHER_CONVENTIONS.items():
        cameras = [view.camera.posed(convert(view.camera.world_to_camera)) for view in views]
        others[name] = _misfit(_fit(views, cameras, centre, radius), views, cameras)[0]
    # The best of them, not the first: along a short arc of cameras more than one may fit.
    best = min(others, key=others.__getitem__)
    if others[best] <= 1:
        advice = f"the poses look like {best}"
    raise ValueError(f"{views[worst].label}: {what}; {advice}")


def _check_given(sphere: Sphere, views: Sequence[View]) -> None:
    for view in views:
        camera, problem = view.camera, ""
        if not camera.is_orthographic and camera.depth(sphere.centre)[0] <= sphere.radius:
            problem = "the sphere of [object] lies behind the camera (or around it)"
        else:
            disk = sphere_coverage(sphere, camera)
            if not disk.any():
                problem = "the sphere of [object] projects outside this photograph"
            elif view.coverage is not None and (overlap := _overlap(disk, view.coverage)) < _MIN_OVERLAP:
                problem = f"the sphere of [object] and the mask overlap by only {overlap:.0%}"
        if problem:
            raise ValueError(f"{view.label}: {problem}; {_suspect(sphere, view)}")


def _suspect(sphere: Sphere, view: View) -> str:
    for name, convert in _OTHER_CONVENTIONS.items():
        camera = view.camera.posed(convert(view.camera.world_to_camera))
        if camera.is_orthographic or camera.depth(sphere.centre)[0] > sphere.radius:
            disk = sphere_coverage(sphere, camera)
            fits = disk.any() if view.coverage is None else _overlap(disk, view.coverage) >= _MIN_OVERLAP
            if fits:
                return f"the pose looks like {name}"
    return "check world_to_camera, the camera's parameters, and [object] centre and radius (metres)"


def _overlap(disk: NDArray[np.bool_], coverage: Coverage) -> float:
    inside = coverage >= 0.5
    union = (disk | inside).sum()
    return float((disk & inside).sum() / union) if union else 0.0

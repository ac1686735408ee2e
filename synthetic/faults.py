"""What real captures get wrong, added on purpose: poses, shapes, alignments, pixels.

Every fault leaves the truth untouched and returns what a capture would have got instead. Backgrounds are in
`synthetic.sensing.room`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter, label
from scipy.spatial.transform import Rotation

from capture.camera import rigid_transform
from recon.mesh.scannoise import scan_noise
from recon.mesh.trianglemesh import TriangleMesh, smooth_normals

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Half of the pixels that are hit lie in specks, smooth noise of this width in pixels being above a threshold.
_SPECK_SHARE, _SPECK_PX = 0.5, 1.5
# Decades below and above the object's median brightness that outliers reach, and their colours' spread, in decades.
_OUTLIER_DECADES, _COLOUR_DECADES = 2.0, 0.3


def perturbed_pose(
    world_to_camera: ArrayLike,
    centre: ArrayLike,
    rotation_deg: float,
    translation_m: float,
    rng: np.random.Generator,
) -> Floats:
    """A pose (4, 4) as a calibration with errors would give it: turned about the object, and shifted.

    centre : (3,) metres, the point of the object about which the camera is turned, so that a turn alone keeps it in its
    place in the picture. rotation_deg, translation_m : Gaussian standard deviations, about and along each of the
    world's three axes.
    """
    _check_amount("rotation_deg", rotation_deg, "degrees")
    _check_amount("translation_m", translation_m, "metres")
    pose, about = rigid_transform(world_to_camera), _centre(centre)
    turn = rng.standard_normal(3) * np.radians(rotation_deg)
    shift = rng.standard_normal(3) * translation_m
    return np.asarray(pose @ _about(about, Rotation.from_rotvec(turn).as_matrix(), shift))


def misaligned(
    mesh_to_world: ArrayLike,
    centre: ArrayLike,
    rotation_deg: float,
    translation_m: float,
    scale: float,
    rng: np.random.Generator,
) -> Floats:
    """A mesh's place (4, 4) off by just these amounts, about a random axis and in a random direction.

    mesh_to_world : (4, 4), a rotation, translation and scale. centre : (3,) world metres, which rotation and scale keep
    in place. rotation_deg : degrees. translation_m : metres. scale : factor, 1 for none.
    """
    _check_amount("rotation_deg", rotation_deg, "degrees")
    _check_amount("translation_m", translation_m, "metres")
    if not 0 < scale < np.inf:
        raise ValueError(f"scale is {scale}; it must be a factor > 0, 1 for none")
    placed = np.asarray(mesh_to_world, float)
    if placed.shape != (4, 4) or not np.isfinite(placed).all() or placed[3].tolist() != [0, 0, 0, 1]:
        raise ValueError(
            f"mesh_to_world is {placed.tolist()}; it must be a finite 4x4 with last row [0, 0, 0, 1]"
        )
    axis, direction = (vector / np.linalg.norm(vector) for vector in rng.standard_normal((2, 3)))
    turn = Rotation.from_rotvec(np.radians(rotation_deg) * axis).as_matrix()
    return np.asarray(_about(_centre(centre), scale * turn, translation_m * direction) @ placed)


def perturbed_mesh(
    mesh: TriangleMesh, std_m: float, correlation_m: float, rng: np.random.Generator
) -> TriangleMesh:
    """A mesh as a scanner with errors would give it: moved along its normals by noise, its normals recomputed.

    std_m, correlation_m : metres, as in `recon.mesh.scannoise`; 0 as correlation_m : each vertex by itself. Seams stay
    closed.
    """
    _check_amount("std_m", std_m, "metres")
    _check_amount("correlation_m", correlation_m, "metres")
    moved = mesh.vertices + scan_noise(mesh, std_m, correlation_m, rng)[:, None] * mesh.normals
    return replace(mesh, vertices=moved, normals=smooth_normals(moved, mesh.faces))


def with_background(
    radiance: NDArray[np.floating], coverage: NDArray[np.floating], background: ArrayLike
) -> Floats:
    """The object's radiance over black (h, w, 3) put before a background: (3,), or (h, w, 3) as of `room_background`.

    coverage : (h, w), 0 to 1, the share of a pixel that the object takes.
    """
    behind = np.asarray(background, float)
    if behind.shape not in ((3,), radiance.shape) or not np.isfinite(behind).all() or (behind < 0).any():
        raise ValueError(
            f"the background is {behind.shape} with a minimum of {behind.min()}; it must be (3,) or {radiance.shape},"
            " finite and >= 0"
        )
    return np.asarray(radiance + (1 - np.asarray(coverage, float))[..., None] * behind)


def with_outliers(
    photo: NDArray[np.floating],
    coverage: NDArray[np.floating],
    share: float,
    rng: np.random.Generator,
) -> tuple[Floats, Mask]:
    """A photograph in which a share of the object's pixels are outliers, and the mask (h, w) of what was touched.

    photo : (h, w, 3) linear. coverage : (h, w), positive where the object is. share : 0 to below 1, of its pixels; half
    of these are alone (hot pixels), half in specks (dust, insects, glints) of one colour. Brightnesses lie between a
    hundredth and a hundred times the object's median, uniform in their logarithm.
    """
    if not 0 <= share < 1:
        raise ValueError(
            f"the share of outliers is {share}; it is a share of the object's pixels, 0 to below 1"
        )
    seen = np.asarray(coverage) > 0
    count = round(share * int(seen.sum()))
    result, touched = np.array(photo, float), np.zeros(seen.shape, bool)
    if count == 0:
        return result, touched
    median = float(np.median(result[seen]))
    if not median > 0:
        raise ValueError(
            f"the object's median radiance is {median}; outliers are relative to it: expose the object"
        )
    field = gaussian_filter(rng.standard_normal(seen.shape), _SPECK_PX)
    object_pixels = np.flatnonzero(seen)
    from_above = object_pixels[np.argsort(-field.ravel()[object_pixels], kind="stable")]
    specks = round(_SPECK_SHARE * count)
    touched.ravel()[from_above[:specks]] = True
    numbers, last = label(touched, np.ones((3, 3)))
    alone = rng.choice(from_above[specks:], count - specks, replace=False)
    touched.ravel()[alone] = True
    numbers.ravel()[alone] = last + 1 + np.arange(len(alone))
    decades = rng.uniform(-_OUTLIER_DECADES, _OUTLIER_DECADES, (last + len(alone), 1))
    colours = median * 10 ** (decades + rng.normal(0, _COLOUR_DECADES, (last + len(alone), 3)))
    result[touched] = colours[numbers[touched] - 1]
    return result, touched


def _about(centre: Floats, linear: Floats, shift: Floats) -> Floats:
    """The map (4, 4) of x to linear (x - centre) + centre + shift."""
    result = np.eye(4)
    result[:3, :3] = linear
    result[:3, 3] = centre - linear @ centre + shift
    return result


def _centre(centre: ArrayLike) -> Floats:
    point = np.asarray(centre, float)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise ValueError(f"centre is {point.tolist()}; it must be a point [x, y, z] in metres")
    return point


def _check_amount(name: str, amount: float, unit: str) -> None:
    if not 0 <= amount < np.inf:
        raise ValueError(f"{name} is {amount}; it must be {unit} >= 0")

"""How references lie in the world: which way what they show faces, and where."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.photoset import PhotoSet
from capture.reference import SeenReference, mean_of_parts, see_references
from recon.mesh.bodies import Body
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]

# Deviation of a normal that is given without one, degrees: of a card that was set up by eye.
_BY_EYE_DEG = 2.0
# Deviation of corners that were read off a photograph, pixels.
_CORNER_PX = 0.5
# By so many pixels, and so much of its size, corners may miss those of a rectangle.
_MOST_PX, _MOST = 2.0, 0.01
# Two ways to lie are told apart where the worse one misses its corners by so many times as much, and so many pixels.
_TOLD_APART, _MISSES_PX = 3.0, 1.0
# Share of a reference's pixels that may show the object.
_OVERLAP = 0.02


@dataclass(frozen=True, eq=False)
class Reference:
    """Something of known reflectance in a photograph: a perfect diffuser but for that.

    where, name : for messages. photo : its photograph's label. lighting : the name of the light there. normals :
    (n, 3) unit, of the pixels that show it. positions : (n, 3) metres, None where nothing says. white : (n, 3),
    radiance that a perfect white would have there. parts : (n,), which of its parts each pixel is in.
    reflectance_std : as a share of the reflectance. normal_std : radians, about either way across.
    """

    where: str
    name: str
    photo: str
    lighting: str
    normals: Floats
    positions: Floats | None
    white: Floats
    parts: NDArray[np.int64]
    reflectance_std: float
    normal_std: float

    def mean(self, values: Floats) -> Floats:
        """Mean (...) over the parts of what pixels have, (n, ...)."""
        return mean_of_parts(values, self.parts)

    def over_shown(self, fallen: Floats) -> Floats:
        """What mean irradiance (3,) makes of it, over what it shows."""
        return fallen / (np.pi * self.mean(self.white))


def find_references(photoset: PhotoSet, body: Body | None = None) -> tuple[Reference, ...]:
    """The references of a set, in its order; ValueError says what is wrong with one.

    body : the object, if it is known; a reference that lies on it is refused.
    """
    seen = see_references(photoset.manifest, photoset.references, photoset.photos, photoset.radiometry)
    return tuple(_placed(each, body) for each in seen)


def _placed(seen: SeenReference, body: Body | None) -> Reference:
    table, camera = seen.table, seen.photo.camera
    if body is not None:
        _check_beside(seen, body)
    count, positions, normal_std = len(seen.rows), None, 0.0
    try:
        if table.centre is not None:
            sphere = Sphere(np.array(table.centre, float), float(table.radius or 0), np.zeros((4, 4)))
            rays = camera.rays(np.column_stack([seen.columns, seen.rows]) + 0.5)
            normals = sphere.hits(*rays)[1]
            positions = sphere.centre + sphere.radius * normals
        elif table.normal is not None:
            normal = np.array(table.normal, float)
            normal /= np.linalg.norm(normal)
            normals = np.tile(normal, (count, 1))
            given = table.normal_std_deg
            normal_std = np.radians(_BY_EYE_DEG if given is None else given)
            if table.position is not None:
                positions = np.tile(np.array(table.position, float), (count, 1))
            if (normals * camera.views(_before(camera, positions))).sum(axis=1).max() <= 0:
                raise ValueError(
                    f"normal {list(table.normal)} faces away from the camera that shows the reference: check its sign"
                    " and its frame, the world's"
                )
        else:
            normal, normal_std, middle = _pose(seen.corners, seen.plane, camera)
            normals = np.tile(normal, (count, 1))
            # A chart's places are in cells, not in metres.
            positions = None if table.chart else np.tile(middle, (count, 1))
    except ValueError as error:
        raise ValueError(f"{seen.where}: {error}") from error
    return Reference(
        seen.where,
        seen.name,
        seen.photo.label,
        seen.photo.lighting,
        normals,
        positions,
        seen.white,
        seen.parts,
        table.reflectance_std,
        float(normal_std),
    )


def _before(camera: Camera, positions: Floats | None) -> Floats:
    """The given points, or one on the optical axis."""
    if positions is not None:
        return positions[:1]
    return (camera.centre + camera.camera_to_world[:3, 2])[None]


def _check_beside(seen: SeenReference, body: Body) -> None:
    pixels = np.column_stack([seen.columns, seen.rows]).astype(float) + 0.5
    overlap = body.hits(seen.photo.camera, pixels).hit.mean()
    if overlap > _OVERLAP:
        raise ValueError(
            f"{seen.where}: {overlap:.0%} of its pixels show the object itself: a reference lies beside it; check"
            " region or centre"
        )


def _pose(corners: Floats, plane: Floats, camera: Camera) -> tuple[Floats, float, Floats]:
    """The normal (3,) of a flat thing in the world, its deviation, radians, and its middle (3,), by its corners."""
    if camera.is_orthographic:
        raise ValueError(
            "an orthographic camera doesn't show which way it is tilted: give normal, in the world"
        )
    flat = np.column_stack([plane - plane.mean(axis=0), np.zeros(len(plane))])

    def ways(at: Floats) -> list[tuple[float, Floats, Floats]]:
        local = camera.rays(at)[1] @ camera.camera_to_world[:3, :3]
        seen = np.ascontiguousarray(local[:, None, :2] / local[:, None, 2:])
        _, turns, shifts, errors = cv2.solvePnPGeneric(flat, seen, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        found: list[tuple[float, Floats, Floats]] = []
        for turn, shift, error in zip(turns, shifts, errors.ravel(), strict=True):
            normal = cv2.Rodrigues(turn)[0][:, 2]
            normal = -np.sign(normal @ shift.ravel()) * normal
            found.append(
                (float(error) * camera.focal_px, np.asarray(normal), np.asarray(shift.ravel(), float))
            )
        return sorted(found, key=lambda way: way[0])

    (miss, normal, middle), *others = ways(corners)
    if miss > _MOST_PX + _MOST * np.ptp(corners, axis=0).max():
        raise ValueError(
            f"the corners miss those of a flat rectangle of that size by {miss:.1f} pixels: give them in turn around"
            " it, the first two along its width"
        )
    for other, turned, _ in others:
        apart = np.degrees(np.arccos(np.clip(turned @ normal, -1, 1)))
        if other < max(_TOLD_APART * miss, _MISSES_PX) and apart > 2 * _BY_EYE_DEG:
            raise ValueError(
                f"its corners leave two ways in which it may be turned, {apart:.0f} degrees apart: give normal, in the"
                " world"
            )
    moved = []
    for k in range(corners.size):
        step = np.zeros(corners.size)
        step[k] = max(_CORNER_PX, miss)
        nearest = max(ways(corners + step.reshape(corners.shape)), key=lambda way: way[1] @ normal)
        moved.append(nearest[1] - normal)
    std = np.sqrt((np.array(moved) ** 2).sum() / 2)
    rotation = camera.camera_to_world[:3, :3]
    return rotation @ normal, float(std), rotation @ middle + camera.centre

"""What rays of samples meet if a camera or the body is elsewhere than was thought: derivatives of their geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture.camera import Camera
from recon.mesh.bodies import Body, SphereBody
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Pixels by which what rays meet is moved to take a difference: less than a facet or a highlight, more than rounding.
_STEP_PX = 0.2
# A ray that goes on to another part of the surface moves unevenly: of the way, the share by which halves differ. Below
# the second, of the body's size, ways are rounding.
_UNEVEN, _SAME = 0.3, 1e-6


@dataclass(frozen=True, eq=False)
class RayChange:
    """By how much m rays' geometry changes, (m, 3) each: unit normals, unit views, positions in metres."""

    normals: Floats
    views: Floats
    positions: Floats

    def applied(self, field: LightField, way: float) -> LightField:
        """A field whose rays are changed by so many times this."""
        normals, views = field.normals + way * self.normals, field.views + way * self.views
        return replace(
            field,
            normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
            views=views / np.linalg.norm(views, axis=1, keepdims=True),
            positions=field.positions + way * self.positions,
        )


@dataclass(frozen=True, eq=False)
class SeenBody:
    """A camera and the body before it. placed : (4, 4), how the body was moved since its shape was read, or None."""

    camera: Camera
    body: Body
    placed: Floats | None = None

    def pictured(self, positions: Floats) -> Floats:
        """Where the picture shows points of the body (m, 3), which moves with it: pixels (m, 2)."""
        if self.placed is not None:
            positions = positions @ self.placed[:3, :3].T + self.placed[:3, 3]
        return self.camera.project(positions)

    def seen(self, pixels: Floats) -> tuple[NDArray[np.bool_], Floats, Floats, Floats]:
        """Whether rays through image points meet the body, and normals, views and positions (m, 3) there."""
        if self.placed is None:
            hits = self.body.hits(self.camera, pixels)
            return hits.hit, hits.normals, hits.views, hits.positions
        # A camera that is moved with the body sees it where it was.
        hits = self.body.hits(self.camera.posed(self.camera.world_to_camera @ self.placed), pixels)
        turn, shift = self.placed[:3, :3], self.placed[:3, 3]
        return hits.hit, hits.normals @ turn.T, hits.views @ turn.T, hits.positions @ turn.T + shift


# What rays meet: whether the body, normals, views, positions.
_Met = tuple[NDArray[np.bool_], Floats, Floats, Floats]
# The scene with so many times an error.
Motion = Callable[[SeenBody, float], SeenBody]


def ray_change(field: LightField, here: SeenBody, motion: Motion) -> RayChange:
    """By how much rays' geometry changes, to first order, with an error of the scene.

    Of rays that miss the body, or go on to another part of it, nothing changes.
    """
    pixels = here.camera.project(field.positions)
    size = _step(field, here, motion(here, 1.0))
    before, after = (motion(here, way * size).seen(pixels) for way in (-1, 1))
    return _change(field, here.body, before, after, size)


def pixel_change(field: LightField, here: SeenBody, way: Floats) -> RayChange:
    """By how much rays' geometry changes over a pixel of the picture; way : (2,) unit, to the right and down.

    Of rays at the body's outline, or that go on to another part of it, nothing changes.
    """
    pixels = here.camera.project(field.positions)
    before, after = (here.seen(pixels + end * _STEP_PX * way) for end in (-1, 1))
    return _change(field, here.body, before, after, _STEP_PX)


def picture_shift(field: LightField, here: SeenBody, motion: Motion) -> Floats:
    """By how many pixels (m, 2) what rays meet moves in the picture, to first order, with an error of the scene."""
    before, after = (motion(here, way).pictured(field.positions) for way in (-1, 1))
    return (after - before) / 2


def _change(field: LightField, body: Body, lower: _Met, upper: _Met, size: float) -> RayChange:
    """Differences per unit, of rays that meet the body on either side of a step of such a size."""
    (met_before, *less), (met_after, *more) = lower, upper
    steps = [(after - before) / (2 * size) for before, after in zip(less, more, strict=True)]
    # Before and after, a ray goes as far on one surface.
    before, after = field.positions - less[2], more[2] - field.positions
    uneven = np.linalg.norm(after - before, axis=1)
    kept = (
        met_before
        & met_after
        & (uneven <= _UNEVEN * np.linalg.norm(after + before, axis=1) + _SAME * body.size)
    )
    return RayChange(*(np.where(kept[:, None], step, 0.0) for step in steps))


def pose_motion(error: Floats) -> Motion:
    """The camera at [exp(w) R | t + s]; error : (6,), w in radians and s in metres."""

    def moved(scene: SeenBody, way: float) -> SeenBody:
        pose = scene.camera.world_to_camera.copy()
        pose[:3, :3] = Rotation.from_rotvec(way * error[:3]).as_matrix() @ pose[:3, :3]
        pose[:3, 3] += way * error[3:]
        return replace(scene, camera=scene.camera.posed(pose))

    return moved


def lens_motion(error: Floats) -> Motion:
    """The camera with params that are off, (p,)."""
    return lambda scene, way: replace(
        scene, camera=replace(scene.camera, params=scene.camera.params + way * error)
    )


def sphere_motion(error: Floats) -> Motion:
    """A sphere whose centre and radius are off, (4,) metres."""

    def moved(scene: SeenBody, way: float) -> SeenBody:
        assert isinstance(scene.body, SphereBody)
        sphere = scene.body.sphere
        centre, radius = sphere.centre + way * error[:3], sphere.radius + way * error[3]
        return replace(scene, body=SphereBody(replace(sphere, centre=centre, radius=radius)))

    return moved


def mesh_motion(error: Floats) -> Motion:
    """The body turned about the world's axes, then shifted, and the camera's position scaled; error : (7,)."""

    def moved(scene: SeenBody, way: float) -> SeenBody:
        motion = np.eye(4)
        motion[:3, :3] = Rotation.from_rotvec(way * error[:3]).as_matrix()
        motion[:3, 3] = way * error[3:6]
        pose = scene.camera.world_to_camera.copy()
        pose[:3, 3] *= np.exp(way * error[6])
        return SeenBody(scene.camera.posed(pose), scene.body, motion)

    return moved


def _step(field: LightField, here: SeenBody, there: SeenBody) -> float:
    """The share of an error that moves what is seen by about `_STEP_PX` pixels; 1 at most."""
    few = field.positions[:: max(len(field.positions) // 50, 1)]
    shift = there.pictured(few) - here.camera.project(few)
    if isinstance(there.body, SphereBody) and isinstance(here.body, SphereBody):
        centres = there.body.centre - here.body.centre, there.body.size - here.body.size
        shift = shift + here.body.sphere.pixel_radius(here.camera) * (
            2 * (np.linalg.norm(centres[0]) + abs(centres[1])) / here.body.size
        )
    largest = float(np.nanmax(np.abs(shift)))
    return min(1.0, _STEP_PX / max(largest, 1e-12))

"""What a photo set gives of its scene: poses, lens, mesh and light directions, off by [faults] and [uncertainty]."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from recon.mesh.trianglemesh import TriangleMesh
from synthetic.faults import misaligned, perturbed_mesh, perturbed_pose
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.staging import Staging

Floats = NDArray[np.float64]

# What random numbers are for: each use has a stream of its own, so that none changes another's. The writer has 4 to 6.
_POSES, _MESH, _ALIGNMENT, _LENS, _DIRECTIONS, _SCAN = 1, 2, 3, 7, 8, 9


def given_poses(staging: Staging) -> list[Floats]:
    """world_to_camera (4, 4) of each shot."""
    scene, faults, stated = staging.scene, staging.faults, staging.uncertainty
    rng = np.random.default_rng([scene.seed, _POSES])
    poses = [shot.camera.world_to_camera for shot in scene.shots]
    turn = np.hypot(faults.pose_deg, stated.rotation_deg or 0.0)
    shift = np.hypot(faults.pose_m, stated.position or 0.0)
    if not (turn or shift):
        return poses
    centre = scene.surface.centre
    return [perturbed_pose(pose, centre, float(turn), float(shift), rng) for pose in poses]


def given_camera(camera: Camera, staging: Staging) -> Camera:
    """One of the scene's cameras with the focal length that the set gives: all are off alike."""
    if not staging.uncertainty.focal_length:
        return camera
    rng = np.random.default_rng([staging.scene.seed, _LENS])
    return camera.zoomed(1 + staging.uncertainty.focal_length * float(rng.standard_normal()))


def given_mesh(staging: Staging, mesh: TriangleMesh) -> TriangleMesh:
    """The object's mesh, as a scanner with errors gives it."""
    faults, stated, seed = staging.faults, staging.uncertainty, staging.scene.seed
    if faults.mesh_m:
        rng = np.random.default_rng([seed, _MESH])
        mesh = perturbed_mesh(mesh, faults.mesh_m, faults.mesh_correlation_m, rng)
    if stated.height:
        rng = np.random.default_rng([seed, _SCAN])
        mesh = perturbed_mesh(mesh, stated.height, stated.height_correlation or 0.0, rng)
    return mesh


def given_place(staging: Staging) -> Floats:
    """mesh_to_world (4, 4)."""
    faults = staging.faults
    if not (faults.misaligned_deg or faults.misaligned_m):
        return staging.mesh_to_world
    rng = np.random.default_rng([staging.scene.seed, _ALIGNMENT])
    centre = staging.scene.surface.centre
    return misaligned(staging.mesh_to_world, centre, faults.misaligned_deg, faults.misaligned_m, 1.0, rng)


def given_light(light: Illumination, staging: Staging) -> Illumination:
    """A lighting whose sources are in the directions, seen from the object's centre, where they were measured to be."""
    std_deg = staging.uncertainty.direction_deg
    if not std_deg:
        return light
    index = [id(each) for each in staging.scene.illuminations].index(id(light))
    rng = np.random.default_rng([staging.scene.seed, _DIRECTIONS, index])
    centre = np.asarray(staging.scene.surface.centre)
    sources: list[DirectionalSource | PointSource] = []
    for source in light.sources:
        off = np.radians(std_deg) * rng.standard_normal(3)
        if isinstance(source, DirectionalSource):
            sources.append(replace(source, direction=_turned(source.direction, off)))
        else:
            offset = source.position - centre
            sources.append(replace(source, position=centre + _turned(offset, off)))
    return replace(light, sources=tuple(sources))


def _turned(vector: Floats, off: Floats) -> Floats:
    """A vector of the same length towards its direction plus what of `off`, radians, is across."""
    length = np.linalg.norm(vector)
    moved = vector / length + np.cross(np.cross(vector, off), vector) / length**2
    return np.asarray(length * moved / np.linalg.norm(moved))

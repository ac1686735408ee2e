"""Fit and poses by turns: the fit predicts the photographs, these tell their poses, and the fit gets sharper.

Photographs that a texture was fitted to have their poses moved together, its values free; others one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo
from capture.parallel import one_blas_thread, parallel_map
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from invrender.pipeline import Run, process
from invrender.refine.followed import Followed, Lobe, followed_in
from invrender.refine.photometric import RefinedPose, Sight, refine_pose
from invrender.refine.rim import outline_in
from invrender.refine.shared import refine_together
from invrender.solve.noise import NoiseModel
from invrender.texture.layout import SurfacePoints
from recon.bodies import MeshBody
from recon.lightfield import LightField
from recon.sampling import NO_SOURCES, sample_body

Floats = NDArray[np.float64]

_ROUNDS = 8
# A round that leaves more than this share of the error has moved nothing that matters, and isn't kept.
_STALLS = 0.98
# Pixels of a photograph that its pose is read off, in patches of so many a side.
_PIXELS, _PATCH = 8000, 24
# Points of a texture that are followed through the photographs.
_POINTS = 20_000


@dataclass(frozen=True, eq=False)
class Refined:
    """Refined poses of a set.

    photoset : with them. sights, poses : per photograph of the set, what its pose was read off, and what was found.
    errors : relative RMS on unseen photographs, at the poses as given and after each round that was kept.
    """

    photoset: PhotoSet
    sights: tuple[Sight, ...]
    poses: tuple[RefinedPose, ...]
    errors: tuple[float, ...]


def refine_poses(
    photoset: PhotoSet, samples: int, turn_deg: float, shift_px: float, track: Track = silent
) -> Refined:
    """Refine the pose of every photograph of a mesh under known light; those that are held out, too.

    samples : as `process` has it. turn_deg, shift_px : how far off the poses may be, standard deviations: turns about
    each axis of the object, and shifts in the picture. ValueError as `process` raises it, and for spheres, whose place
    is read off their masks by the poses.
    """
    if photoset.object.shape != "mesh":
        raise ValueError(
            f"{photoset.manifest}: [object] shape is {photoset.object.shape!r}; only poses of meshes"
            " are refined: a sphere looks the same however it is turned, and its place is read off the masks"
        )
    poses = [RefinedPose(np.zeros(6), np.eye(6), np.nan, np.nan)] * len(photoset.photos)
    best: Refined | None = None
    sights: list[Sight] = []
    for _ in range(_ROUNDS + 1):
        moved = photoset if best is None else _moved(photoset, sights, poses)
        run = process(moved, samples, track)
        error = run.result.model.error
        if best is not None and error > _STALLS * best.errors[-1]:
            break
        seen = _seen(photoset, run, (turn_deg, shift_px))
        sights = [sight for sight, _ in seen]
        best = Refined(moved, tuple(sights), tuple(poses), (*(best.errors if best else ()), error))
        poses = _round(seen, [pose.change for pose in poses], track)
    assert best is not None
    return best


def _moved(photoset: PhotoSet, sights: Sequence[Sight], poses: Sequence[RefinedPose]) -> PhotoSet:
    photos = [
        replace(photo, camera=sight.at(pose.change))
        for photo, sight, pose in zip(photoset.photos, sights, poses, strict=True)
    ]
    return replace(photoset, photos=tuple(photos))


def _seen(given: PhotoSet, run: Run, off: tuple[float, float]) -> list[tuple[Sight, Followed | None]]:
    """Photographs at the poses as given, and how a run predicts them at those that they now have."""
    points, textures = None, run.result.textures
    if textures is not None:
        known = np.flatnonzero(textures.known)
        points = textures.layout.points.where(np.sort(np.random.default_rng(0).permutation(known)[:_POINTS]))
    return list(parallel_map(partial(_looked_at, given, run, off, points), range(len(given.photos))))


def _looked_at(
    given: PhotoSet, run: Run, off: tuple[float, float], points: SurfacePoints | None, index: int
) -> tuple[Sight, Followed | None]:
    """A photograph, and in it the points of a texture that it was fitted to."""
    photo, body = given.photos[index], run.specimen.body
    assert isinstance(body, MeshBody)
    vertices = body.mesh.vertices
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    image = decode_photo(given, photo)
    rng = np.random.default_rng(index)
    mask = run.specimen.found.mask_of(photo)
    now = run.photoset.photos[index].camera
    field = sample_body(body, now, image, mask, NO_SOURCES, None, rng)
    chosen = _patches(field, rng)
    sight = Sight(
        body=body,
        camera=photo.camera,
        image=image,
        centre=centre,
        units=np.ones(6),
        rows=field.rows[chosen],
        columns=field.columns[chosen],
        radiance=lambda field: run.solved.radiance(photo, field),
        noise=NoiseModel(run.result.noise_floor, run.result.noise_relative),
        outline=outline_in(photo.camera, mask),
    )
    sight = replace(sight, units=np.repeat([np.radians(off[0]), off[1] / sight.px_per_metre], 3))
    if points is None or photo.held_out:
        return sight, None
    textures, transfers = run.result.textures, run.solved.transfers
    assert textures is not None
    assert transfers is not None
    lobe = Lobe(run.result.brdf.ks, textures.ks_varies)
    return sight, followed_in(sight, now, field, points, partial(transfers, photo), lobe)


def _patches(field: LightField, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which samples lie in patches of the picture, chosen at random, that hold about as many as are wanted."""
    patch = np.unique(
        (field.rows // _PATCH) * 100_000 + field.columns // _PATCH, return_inverse=True, return_counts=True
    )
    order = rng.permutation(len(patch[2]))
    before = np.cumsum(patch[2][order]) - patch[2][order]
    return np.isin(patch[1], order[before < _PIXELS])


def _round(
    seen: Sequence[tuple[Sight, Followed | None]], changes: Sequence[Floats], track: Track
) -> list[RefinedPose]:
    """Poses of all photographs: of those that share a texture together, of others one by one."""
    together = [k for k, (_, followed) in enumerate(seen) if followed is not None]
    alone = [k for k in range(len(seen)) if k not in together]
    poses: dict[int, RefinedPose] = {}
    with one_blas_thread():
        if together:
            followed = [own for _, own in seen if own is not None]
            start = np.array([changes[k] for k in together])
            poses |= zip(together, refine_together(followed, start, track), strict=True)
        work = parallel_map(lambda k: refine_pose(seen[k][0], changes[k]), alone)
        poses |= {k: next(work) for k in track(alone, "Refining poses")}
    return [poses[k] for k in range(len(seen))]

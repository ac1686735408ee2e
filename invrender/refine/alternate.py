"""Fit and poses by turns: the fit predicts the photographs, these give their poses, and the fit gets sharper.

Photographs that a texture was fitted to have their poses moved together, its values free; others one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.blocks import block_means
from capture.camera import Camera
from capture.decode import decode_photo
from capture.parallel import one_blas_thread, parallel_map
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from capture.radiance import RadianceImage
from capture.tasks.stage import kept_result
from invrender.estimate.noise import NoiseModel
from invrender.estimate.textured.layout import SurfacePoints
from invrender.process.pipeline import process
from invrender.refine.photometric import PoseTarget, RefinedPose, refine_pose
from invrender.refine.posechange import LoosePose
from invrender.refine.rim import outline_in
from invrender.refine.shared import refine_together
from invrender.refine.surface_tracking import Followed, Lobe, followed_in
from invrender.result.run import Run, TexturedRun
from recon.mesh.bodies import Body, MeshBody, body_coverage, larger_pixels
from recon.sampling.draw import NO_SOURCES, sample_body
from recon.sampling.find import check_unfiltered
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

_ROUNDS = 8
# A round that leaves more than this share of the error has moved nothing that matters, and isn't kept.
_STALLS = 0.98
# Pixels of a photograph that its pose is read off, in patches of so many a side.
_PIXELS, _PATCH = 8000, 24
# Points of a texture that are followed through the photographs.
_POINTS = 20_000
# About how many pixels a photograph is kept in that points are followed through, what is around the object included: no
# texture, of at most 1024 texels a side, shows more.
_PAINTED = 1_500_000
# Patches of a large photograph are chosen before it is looked at, so many times the pixels that are wanted.
_SPARE = 8


@dataclass(frozen=True, eq=False)
class RefinedPoses:
    """Refined poses of a set.

    photoset : with them. given, poses : per photograph of the set, its pose as it was, and what was found.
    errors : relative RMS on unseen photographs, at the poses as given and after each round that was kept.
    """

    photoset: PhotoSet
    given: tuple[LoosePose, ...]
    poses: tuple[RefinedPose, ...]
    errors: tuple[float, ...]


def refine_poses(
    photoset: PhotoSet, samples: int, turn_deg: float, shift_px: float, track: Track = silent
) -> RefinedPoses:
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
    check_unfiltered(photoset)
    best: RefinedPoses | None = None
    poses = tuple([RefinedPose(np.zeros(6), np.eye(6), 0, np.nan, np.nan)] * len(photoset.photos))
    for _ in range(_ROUNDS + 1):
        moved = photoset if best is None else _moved(photoset, best.given, poses)
        limit = np.inf if best is None else _STALLS * best.errors[-1]
        given_to = (photoset, moved, poses, limit, samples, turn_deg, shift_px)
        found = kept_result("pose-rounds", partial(_round, *given_to, track), given_to)
        if found is None:
            break
        best = RefinedPoses(moved, found.given, poses, (*(best.errors if best else ()), found.error))
        poses = found.poses
    assert best is not None
    return best


@dataclass(frozen=True, eq=False)
class _Round:
    """What a round finds; as of `RefinedPoses`, with the error at the poses that it began with."""

    error: float
    given: tuple[LoosePose, ...]
    poses: tuple[RefinedPose, ...]


def _round(
    photoset: PhotoSet,
    moved: PhotoSet,
    poses: Sequence[RefinedPose],
    limit: float,
    samples: int,
    turn_deg: float,
    shift_px: float,
    track: Track,
) -> _Round | None:
    """Fit the set at the poses that it now has, and refine these; None where the error is above a limit."""
    # Causes of what is left over would be looked for in every round, and nobody reads them.
    run = process(moved, samples, track, causes=False)
    error = run.solution.model.error
    if error > limit:
        return None
    centre = _middle(run.geometry.body)
    given = [LoosePose.of(photo.camera, centre, np.radians(turn_deg), shift_px) for photo in photoset.photos]
    refined = _refined(_seen(photoset, run, given), [pose.change for pose in poses], track)
    return _Round(error, tuple(given), tuple(refined))


def _middle(body: Body) -> Floats:
    assert isinstance(body, MeshBody)
    return (body.mesh.vertices.min(axis=0) + body.mesh.vertices.max(axis=0)) / 2


def _moved(photoset: PhotoSet, given: Sequence[LoosePose], poses: Sequence[RefinedPose]) -> PhotoSet:
    photos = [
        replace(photo, camera=own.at(pose.change))
        for photo, own, pose in zip(photoset.photos, given, poses, strict=True)
    ]
    return replace(photoset, photos=tuple(photos))


def _seen(
    photoset: PhotoSet, run: Run, given: Sequence[LoosePose]
) -> list[tuple[PoseTarget, Followed | None]]:
    """Photographs at the poses as given, and how a run predicts them at those that they now have."""
    points, textures = None, run.textures
    if textures is not None:
        known = np.flatnonzero(textures.known)
        points = textures.layout.points.where(np.sort(np.random.default_rng(0).permutation(known)[:_POINTS]))
    return list(parallel_map(partial(_looked_at, photoset, run, given, points), range(len(given))))


def _looked_at(
    photoset: PhotoSet, run: Run, given: Sequence[LoosePose], points: SurfacePoints | None, index: int
) -> tuple[PoseTarget, Followed | None]:
    """A photograph, and in it the points of a texture that it was fitted to, these as larger pixels would show them."""
    photo, body = photoset.photos[index], run.geometry.body
    assert isinstance(body, MeshBody)
    followed = points is not None and not photo.held_out
    binning = larger_pixels(body, photo.camera, _PAINTED) if followed else 1
    camera, now = (own.photos[index].camera.binned(binning) for own in (photoset, run.photoset))
    image, mask = _decoded(photoset, run, photo, binning)
    rng = np.random.default_rng(index)
    if not followed:
        image = _in_patches(image, body, now, rng)
    field = sample_body(body, now, image, mask, NO_SOURCES, None, rng)
    chosen, noise = _patches(field, rng), run.solution.noise
    target = PoseTarget(
        camera=camera,
        centre=given[index].centre,
        units=given[index].units,
        body=body,
        rows=field.rows[chosen],
        columns=field.columns[chosen],
        observed=field.radiance[chosen],
        radiance=lambda field: run.radiance(photo, field),
        noise=NoiseModel(noise.floor / binning, noise.relative / binning),
        outline=outline_in(camera, mask),
    )
    if points is None or not followed:
        return target, None
    assert isinstance(run, TexturedRun)
    assert run.textures is not None
    lobe = Lobe(run.solution.brdf.ks, run.textures.ks_varies)
    return target, followed_in(target, image, now, field, points, partial(run.transfers, photo), lobe)


def _decoded(
    photoset: PhotoSet, run: Run, photo: Photo, binning: int
) -> tuple[RadianceImage, NDArray[np.float32] | None]:
    """A photograph and its mask in larger pixels. Its noise is left out: what a fit leaves says more of it."""
    image, mask = decode_photo(photoset.radiometry, photo), run.geometry.found.mask_of(photo)
    noiseless = RadianceImage.black(*image.saturated.shape).variance
    image = RadianceImage(image.radiance, noiseless, image.saturated)
    if binning == 1:
        return image, mask
    return image.binned(binning), None if mask is None else block_means(mask, binning)


def _in_patches(
    image: RadianceImage, body: MeshBody, camera: Camera, rng: np.random.Generator
) -> RadianceImage:
    """A photograph; of a large one only patches on the body, chosen at random: all else counts as saturated."""
    starts = _PATCH * np.argwhere(body_coverage(body, camera, _PATCH))
    count = _SPARE * _PIXELS // _PATCH**2
    if len(starts) <= count:
        return image
    passed_over = np.ones_like(image.saturated)
    for row, column in rng.permutation(starts)[:count]:
        passed_over[row : row + _PATCH, column : column + _PATCH] = False
    return RadianceImage(image.radiance, image.variance, image.saturated | passed_over)


def _patches(field: LightField, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which samples lie in patches of the picture, chosen at random, that hold about as many as are wanted."""
    patch = np.unique(
        (field.rows // _PATCH) * 100_000 + field.columns // _PATCH, return_inverse=True, return_counts=True
    )
    order = rng.permutation(len(patch[2]))
    before = np.cumsum(patch[2][order]) - patch[2][order]
    return np.isin(patch[1], order[before < _PIXELS])


def _refined(
    seen: Sequence[tuple[PoseTarget, Followed | None]], changes: Sequence[Floats], track: Track
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

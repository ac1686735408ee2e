"""Structure from motion: poses and points from matches, by COLMAP, refined by a bundle adjustment of our own.

Schönberger & Frahm 2016, "Structure-from-motion revisited". COLMAP's last adjustment counts every feature alike; ours
lets large features, whose place is less sure, count less, and outliers hardly at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from recon.poses.register.bundle import Bundle, spread
from recon.poses.register.features import feature_sizes, quiet_colmap
from recon.poses.register.posecovariance import pose_covariance

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A feature of size s has the standard deviation sqrt(1 + (s / this)^2), up to a factor (measured on photographs).
_SIZE = 2.0
# Residuals beyond so many standard deviations are false matches, whose points don't enter the cloud.
_OUTLIER = 5.0
# What the sandwich doesn't see, as a factor on variances: places of overlapping patches err alike, and surfaces bend
# within them. Measured on rendered bodies: without it poses were off by 1.2 of their standard deviations, behind a lens
# that distorts by 1 (turns) to 2.4 (shifts) of them.
_SHARED = 3.0
# The smallest model that is one.
_FEWEST = 3


@dataclass(frozen=True, eq=False)
class Structure:
    """Poses and points in a frame of their own, and what they rest on.

    photos : (c,) places in the set of the photographs that were placed. poses : (c, 4, 4), world to camera.
    covariance : (6c, 6c) as in `recon.poses.register.posecovariance.pose_covariance`; None where undetermined.
    points : (p, 3), colours : (p, 3) uint8.
    rms_px : (c,) RMS distance of features from where their points project, false matches left out.
    observations : (c,) how many points each photograph sees.
    disagreement : by how many of their stated standard deviations observations are off (robust); 1 is as it should be.
    """

    photos: Ints
    poses: Floats
    covariance: Floats | None
    points: Floats
    colours: NDArray[np.uint8]
    rms_px: Floats | None = None
    observations: Ints | None = None
    disagreement: float = 1.0


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Points that are recognised one by one, such as a board's corners.

    photo, point : (n,) which photograph of the set saw which of them. pixels : (n, 2), where.
    """

    photo: Ints
    point: Ints
    pixels: Floats


@dataclass(frozen=True, eq=False)
class SparseModel:
    """A reconstruction as a bundle.

    photos : (c,), the places in the set of the bundle's photographs. colours : (p, 3) uint8 of its points.
    shapes : (n, 2, 2), affine shapes of the observations' features.
    """

    bundle: Bundle
    photos: Ints
    colours: NDArray[np.uint8]
    shapes: Floats


def map_incrementally(database: Path, pictures: Path, photos: int) -> Any | None:
    """The largest reconstruction that COLMAP finds in a database of matches; None if it finds none.

    Intrinsics stay as they are. One thread and a fixed seed: equal input gives an equal result.
    """
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = options.ba_refine_principal_point = options.ba_refine_extra_params = (
        False
    )
    options.mapper.abs_pose_refine_focal_length = options.mapper.abs_pose_refine_extra_params = False
    options.min_model_size = min(_FEWEST, photos)
    # Points that two photographs see are many, and patches show which of them are true.
    options.triangulation.ignore_two_view_tracks = False
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = 0
    out = database.parent / "models"
    out.mkdir()
    with quiet_colmap():
        models = pycolmap.incremental_mapping(database, pictures, out, options=options)
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def bundle_of(
    model: Any,
    place_of: Mapping[int, int],
    lenses: Sequence[Camera],
    lens_of: Ints,
    shapes: Sequence[Floats] | None = None,
) -> SparseModel:
    """What a COLMAP reconstruction knows.

    place_of : the place in the set of the model's images, by their numbers; others are left out.
    lens_of : of every photograph of the set. shapes : of every photograph the affine shapes (k, 2, 2) of its features;
        without them all features count as equally small.
    """
    images = sorted(
        (place_of[number], image)
        for number, image in model.images.items()
        if image.has_pose and number in place_of
    )
    points = sorted(model.points3D.items())
    row_of = {number: row for row, (number, _) in enumerate(points)}
    poses = np.tile(np.eye(4), (len(images), 1, 1))
    photo, point, pixels, shape = [], [], [], [np.zeros((0, 2, 2))]
    for row, (place, image) in enumerate(images):
        poses[row, :3] = image.cam_from_world().matrix()
        seen = image.get_observation_point2D_idxs()
        photo += [row] * len(seen)
        for index in seen:
            observed = image.point2D(index)
            point.append(row_of[observed.point3D_id])
            pixels.append(observed.xy)
        own = np.tile(np.eye(2), (len(seen), 1, 1)) if shapes is None else shapes[place]
        shape.append(own if shapes is None else own[np.asarray(seen, int)])
    photos = np.array([place for place, _ in images], np.int64)
    bundle = Bundle(
        lenses=tuple(lenses),
        lens=lens_of[photos],
        poses=poses,
        points=np.array([entry.xyz for _, entry in points], float).reshape(-1, 3),
        photo=np.array(photo, np.int64),
        point=np.array(point, np.int64),
        pixels=np.array(pixels, float).reshape(-1, 2),
        widths=np.sqrt(1 + (feature_sizes(np.concatenate(shape)) / _SIZE) ** 2),
    )
    # Of a model's points some may be seen by images that are left out.
    enough = np.bincount(bundle.point, minlength=len(points)) >= 2
    colours = np.array([entry.color for _, entry in points], np.uint8).reshape(-1, 3)
    kept = bundle.kept(np.ones(len(point), bool))
    return SparseModel(kept, photos, colours[enough], np.concatenate(shape)[enough[bundle.point]])


def with_landmarks(bundle: Bundle, photos: Ints, landmarks: Landmarks) -> tuple[Bundle, Ints]:
    """The bundle with landmarks added that two or more of its photographs see, and those landmarks' numbers.

    They are the bundle's last points, in the order of their numbers.
    """
    row = {photo: number for number, photo in enumerate(photos.tolist())}
    known = np.array([photo in row for photo in landmarks.photo.tolist()], bool)
    photo = np.array([row[p] for p in landmarks.photo[known].tolist()], np.int64)
    point, pixels = landmarks.point[known], landmarks.pixels[known]
    numbers, counts = np.unique(point, return_counts=True)
    numbers = numbers[counts >= 2]
    keep = np.isin(point, numbers)
    photo, point, pixels = photo[keep], np.searchsorted(numbers, point[keep]), pixels[keep]
    return (
        replace(
            bundle,
            points=np.concatenate([bundle.points, _triangulated(bundle, photo, point, pixels, len(numbers))]),
            photo=np.concatenate([bundle.photo, photo]),
            point=np.concatenate([bundle.point, point + len(bundle.points)]),
            pixels=np.concatenate([bundle.pixels, pixels]),
            widths=np.concatenate([bundle.widths, np.ones(len(photo))]),
        ),
        numbers,
    )


def structure_of(bundle: Bundle, photos: Ints, colours: NDArray[np.uint8]) -> Structure:
    """What an adjusted bundle says; points that a false match took part in are left out of the cloud."""
    far = np.linalg.norm(bundle.residuals, axis=1) > _OUTLIER * spread(bundle) * bundle.widths
    wrong = np.bincount(bundle.point[far], minlength=len(bundle.points))[: len(colours)] > 0
    residuals = (bundle.residuals[~far] ** 2).sum(axis=1)
    count = np.bincount(bundle.photo[~far], minlength=len(photos))
    squares = np.bincount(bundle.photo[~far], residuals, minlength=len(photos))
    return Structure(
        photos=photos,
        poses=bundle.poses,
        covariance=_SHARED * pose_covariance(bundle),
        points=bundle.points[: len(colours)][~wrong],
        colours=colours[~wrong],
        rms_px=np.sqrt(squares / np.maximum(count, 1)),
        observations=count,
        disagreement=spread(bundle),
    )


def _triangulated(bundle: Bundle, photo: Ints, point: Ints, pixels: Floats, count: int) -> Floats:
    """Points (count, 3) nearest to the rays on which photographs saw them."""
    origins, directions = np.empty((len(photo), 3)), np.empty((len(photo), 3))
    for row in np.unique(photo):
        own = photo == row
        camera = bundle.lenses[bundle.lens[row]].posed(bundle.poses[row])
        origins[own], directions[own] = camera.rays(pixels[own])
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    matrix, vector = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(matrix, point, across)
    np.add.at(vector, point, np.einsum("nij,nj->ni", across, origins))
    return np.asarray(np.linalg.solve(matrix, vector[..., None])[..., 0], float)

"""What a photo set holds to align its mesh by: outlines of masks, picks, a cloud of points, the scale of its poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from capture.decode import decode_photo, photo_mask
from capture.files.documents import read_json
from capture.files.tables import Table
from capture.found import POSES_NAME
from capture.manifest import read_manifest
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track
from capture.radiometry import Radiometry
from capture.tasks.stage import stage_results
from recon.poses.align.cloud import LEAST_POINTS, read_cloud
from recon.poses.align.outlines import Outline, outline_of
from recon.poses.align.picks import Picks
from recon.poses.align.pixelrays import joined, pixel_rays
from recon.poses.align.task import PickedPoints
from recon.sphere.outline import largest_blob

Floats = NDArray[np.float64]
Coverage = NDArray[np.float32]

# A background counts as dark if its radiance is below this share of the object's; and an object as one that isn't the
# whole picture if it covers at most so much of the image's rim.
_DARK, _MOST_RIM = 0.1, 0.05
# A point of a cloud is the object's if so many of the masks that could show it do.
_IN_MASKS = 0.9


@dataclass(frozen=True, eq=False)
class Evidence:
    """What there is. outlines : by index of the photo in the set. metric : the poses are in metres.

    cloud : (n, 3) world, the points that may be the object's, if they are more than a few.
    """

    outlines: dict[int, Outline]
    cloud: Floats | None
    metric: bool
    warnings: tuple[str, ...]


class _Scale(Table):
    model_config = ConfigDict(extra="ignore")
    metric: bool


class _PosesFile(Table):
    model_config = ConfigDict(extra="ignore")
    scale: _Scale
    points: str | None


def registered_poses(photoset: PhotoSet) -> Path | None:
    """The poses.json that the set's poses come from, if they do."""
    path = photoset.resolve(read_manifest(photoset.manifest).poses or POSES_NAME)
    return path if path in photoset.calibration_files else None


def gather(photoset: PhotoSet, poses: Path | None, without_masks: bool, track: Track) -> Evidence:
    """Read what there is. without_masks : look for the object before a dark background if no photo has a mask.

    poses : the poses.json in use, None if the manifest gives the poses.
    """
    metric, cloud, warnings = True, None, []
    if poses is not None:
        what = "a poses.json, as `lightfactor register` writes it, holds scale and points"
        table = read_json(poses, _PosesFile, ("scale", "points"), what)
        metric = table.scale.metric
        if table.points is not None:
            cloud = read_cloud(poses.parent / table.points)
    masked = [i for i, photo in enumerate(photoset.photos) if photo.mask is not None]
    from_background = not masked and without_masks
    chosen = list(range(len(photoset.photos))) if from_background else masked
    votes = np.zeros((2, 0 if cloud is None else len(cloud)))
    outlines: dict[int, Outline] = {}
    looked_at = _LookedAt(photoset.radiometry, from_background, cloud)
    photos = [photoset.photos[i] for i in chosen]
    found = stage_results("silhouettes", looked_at, photos, lambda photo: str(photo.file))
    for index in track(chosen, "Reading masks"):
        outline, seen = next(found)
        votes = votes + seen
        if isinstance(outline, Outline):
            outlines[index] = outline
        elif not from_background:
            warnings.append(f"{photoset.photos[index].label}: {outline}; it isn't used")
    if from_background and len(outlines) * 2 < len(chosen):
        outlines = {}
    elif from_background:
        warnings.append(
            "no photo has a mask: the object's outlines are those of what is bright before the dark background; masks"
            " are more exact where the object itself is dark"
        )
    if cloud is not None and masked:
        own = cloud[(votes[1] > 0) & (votes[0] >= _IN_MASKS * votes[1])]
        # Without its background a cloud may be gone altogether: the object had no features.
        cloud = own if len(own) >= LEAST_POINTS else None
    return Evidence(outlines, cloud, metric, tuple(warnings))


@dataclass(frozen=True, eq=False)
class _LookedAt:
    """Reads where a photograph shows the object. from_background : not by its mask; cloud : points (n, 3), if any."""

    radiometry: Radiometry
    from_background: bool
    cloud: Floats | None

    def __call__(self, photo: Photo) -> tuple[Outline | str, NDArray[np.bool_]]:
        """The outline, or why there is none, and which points lie in it and in the picture, (2, n)."""
        seen = np.zeros((2, 0 if self.cloud is None else len(self.cloud)), bool)
        coverage = _object_on_dark(self.radiometry, photo) if self.from_background else photo_mask(photo)
        if coverage is None:
            return "its background isn't dark", seen
        if self.cloud is not None:
            seen = _seen(photo, coverage, self.cloud)
        try:
            return outline_of(photo.camera, coverage), seen
        except ValueError as error:
            return str(error), seen


def picked_points(picks: Picks, photos: Sequence[Photo], file: str, swapped: bool = False) -> PickedPoints:
    """Picks as rays. swapped : as if u were the row and v the column."""
    # pycolmap takes no reversed view.
    pixels = np.ascontiguousarray(picks.pixels[:, ::-1]) if swapped else picks.pixels
    rays = [
        pixel_rays(photos[photo].camera, pixel[None])
        for photo, pixel in zip(picks.photos, pixels, strict=True)
    ]
    cameras = [photos[photo].camera for photo in picks.photos]
    # Where pixels are per metre, the picture's width says what a click may be off.
    focal = [max(c.width, c.height) if c.is_orthographic else c.focal_px for c in cameras]
    names = [
        f"the pick of line {line} of {file} ({photos[photo].label})"
        for line, photo in zip(picks.lines, picks.photos, strict=True)
    ]
    return PickedPoints(joined(rays), picks.points, float(np.median(focal)), names)


def _object_on_dark(radiometry: Radiometry, photo: Photo) -> Coverage | None:
    """The largest bright region of a photograph, if everything else is dark and it isn't all of the picture."""
    radiance = decode_photo(radiometry, photo).radiance
    coverage = largest_blob(radiance)
    inside = coverage >= 0.5
    rim = np.concatenate([inside[0], inside[-1], inside[:, 0], inside[:, -1]])
    if not inside.any() or inside.all() or rim.mean() > _MOST_RIM:
        return None
    luminance = radiance.mean(axis=2)
    dark = float(np.median(luminance[~inside])) < _DARK * float(np.median(luminance[inside]))
    return coverage if dark else None


def _seen(photo: Photo, coverage: Coverage, cloud: Floats) -> NDArray[np.bool_]:
    """Whether points (n, 3) lie in the mask, and whether in the picture, (2, n)."""
    pixels = photo.camera.project(cloud)
    size = np.array([photo.camera.width, photo.camera.height])
    with np.errstate(invalid="ignore"):
        within = ((pixels >= 0) & (pixels < size)).all(axis=1)
    column, row = np.floor(pixels[within]).astype(int).T
    inside = np.zeros(len(cloud), bool)
    # Points on the rim lie in one mask and beside the next, as they err by a pixel or two.
    inside[within] = cv2.dilate(coverage, np.ones((5, 5)))[row, column] >= 0.5
    return np.stack([inside, within])

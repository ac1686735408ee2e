"""A photo set of one camera and many lamps, read into stacks of pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.decode import decode_photo, photo_mask
from capture.lighting import Lighting, seen_from
from capture.parallel import parallel_map
from capture.photo import Photo
from capture.photoset import UNKNOWN_NORMALS, PhotoSet
from capture.progress import Track, silent
from invrender.estimate.known_scale import given_scale
from invrender.photometric_stereo.models import FEWEST_FOR_A_LOBE
from invrender.photometric_stereo.stack import PixelStack
from recon.lighting import frame_warnings, read_lighting
from recon.mesh.bodies import SphereBody
from recon.normals.integration import surface_points
from recon.normals.normalmap import picture_axes, read_normal_map
from recon.reference import find_references
from recon.sampling.find import check_unfiltered
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]
# Photographs that a normal and an albedo take, under lamps that span space by at least this (least over largest
# singular value of their directions).
_FEWEST, _LEAST_SPAN = 3, 0.03
# Cameras are one where their matrices differ by no more.
_ONE_CAMERA = 1e-9
# Coverage from which a pixel counts as the object.
_COVERED = 0.99


@dataclass(frozen=True, eq=False)
class StereoCapture:
    """Photographs of one camera, each under one lamp.

    inside : (h, w), the object's pixels, p of them. radiance, variance : (p, j, 3) and (p, j) float32; usable : (p, j).
    lightings : of each photograph, one source each. normals : (p, 3), in the picture's axes; None where they are
    sought. depth : metres, of the plane that the object lies about. warnings : sentences.
    """

    photoset: PhotoSet
    inside: NDArray[np.bool_]
    radiance: NDArray[np.float32]
    variance: NDArray[np.float32]
    usable: NDArray[np.bool_]
    lightings: tuple[Lighting, ...]
    normals: Floats | None
    depth: float
    warnings: tuple[str, ...]

    @property
    def camera(self) -> Camera:
        return self.photoset.photos[0].camera

    def places(self, held_out: bool) -> NDArray[np.int64]:
        """Numbers of the photographs that are fitted, or of those that are held out."""
        return np.flatnonzero([photo.held_out == held_out for photo in self.photoset.photos])

    def plane(self) -> Floats:
        """Depths (h, w) of the plane that the object lies about, NaN outside."""
        return np.where(self.inside, self.depth, np.nan)

    def stack(self, photos: NDArray[np.int64], depths: Floats) -> PixelStack:
        """The stack of some photographs, of a surface at given depths (h, w)."""
        points, axes = surface_points(self.camera, depths), picture_axes(self.camera)
        positions = points @ axes + self.camera.centre
        lamps, irradiances = self._seen([self.lightings[place] for place in photos], positions)
        views = np.array([[0.0, 0.0, 1.0]])
        if not self.camera.is_orthographic:
            views = -points / np.linalg.norm(points, axis=1, keepdims=True)
        radiance, usable = self.radiance[:, photos], self.usable[:, photos]
        reflected = (radiance / irradiances).astype(np.float32)
        variance = self.variance[:, photos] / (irradiances**2).mean(axis=2)
        return PixelStack(reflected, variance.astype(np.float32), usable, lamps @ axes.T, views)

    def irradiances(self, photos: NDArray[np.int64], depths: Floats) -> Floats:
        """Irradiances across the beam (1 or p, j, 3) of photographs' lamps."""
        axes = picture_axes(self.camera)
        positions = surface_points(self.camera, depths) @ axes + self.camera.centre
        return self._seen([self.lightings[place] for place in photos], positions)[1]

    def _seen(self, lightings: Sequence[Lighting], positions: Floats) -> tuple[Floats, Floats]:
        """Directions (1 or p, j, 3) in the world, and irradiances (1 or p, j, 3), of lamps from positions (p, 3)."""
        near = any(lighting.closeness is not None and lighting.closeness.any() for lighting in lightings)
        seen = positions if near else positions[:1]
        directions, irradiances = [], []
        for lighting in lightings:
            towards, factors = seen_from(lighting.sources, seen)
            directions.append(np.broadcast_to(towards.reshape(-1, 1, 3), (len(seen), 1, 3)))
            strength = np.broadcast_to(factors.reshape(-1, 1, 1), (len(seen), 1, 1))
            irradiances.append(strength * lighting.irradiances)
        return np.concatenate(directions, axis=1), np.concatenate(irradiances, axis=1)


def read_capture(photoset: PhotoSet, track: Track = silent) -> StereoCapture:
    """Read a set whose [object] shape is "normals"; ValueError says what doesn't fit photometric stereo, where."""
    check_unfiltered(photoset)
    _check_camera(photoset)
    inside = _inside(photoset, track)
    depth = _depth(photoset)
    body = SphereBody(_around(photoset.photos[0].camera, inside, depth))
    by_name = {table.name: read_lighting(photoset, table, body) for table in photoset.lightings}
    lightings = tuple(by_name[photo.lighting] for photo in photoset.photos)
    for photo in photoset.photos:
        _check_lamp(photoset, photo, by_name[photo.lighting])
    fitted = [
        lighting for photo, lighting in zip(photoset.photos, lightings, strict=True) if not photo.held_out
    ]
    _check_span(photoset, fitted)
    used = {photo.lighting: by_name[photo.lighting] for photo in photoset.photos}
    scale = given_scale(find_references(photoset), used)
    rows, columns = np.nonzero(inside)
    read = partial(_read, photoset, rows, columns)
    photos = list(parallel_map(read, track(photoset.photos, "Reading photographs")))
    for photo, (seen, _, good) in zip(photoset.photos, photos, strict=True):
        _check_light(photo, seen, good)
    radiance, variance, usable = (np.stack(parts, axis=1) for parts in zip(*photos, strict=True))
    is_fitted = np.array([not photo.held_out for photo in photoset.photos])
    enough = usable[:, is_fitted].sum(axis=1) >= _FEWEST
    if not enough.any():
        raise ValueError(
            f"{photoset.manifest}: no pixel is unsaturated in {_FEWEST} photographs; expose them for less light"
        )
    inside[inside] = enough
    return StereoCapture(
        photoset,
        inside,
        radiance[enough],
        variance[enough],
        usable[enough],
        lightings,
        _given_normals(photoset, inside),
        depth,
        (*frame_warnings(photoset), *_shortcomings(int(is_fitted.sum()), enough), *scale.remarks),
    )


def _read(
    photoset: PhotoSet, rows: NDArray[np.int64], columns: NDArray[np.int64], photo: Photo
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    image = decode_photo(photoset.radiometry, photo)
    variance = image.variance_at(rows, columns).mean(axis=1)
    return image.radiance[rows, columns], variance, ~image.saturated[rows, columns]


def _check_light(photo: Photo, radiance: NDArray[np.float32], usable: NDArray[np.bool_]) -> None:
    """ValueError for a photograph that shows nothing of the object."""
    if not usable.any():
        raise ValueError(
            f"{photo.file}: the whole object is saturated; expose for less, or leave the photograph out"
        )
    if not (radiance[usable] > 0).any():
        raise ValueError(
            f"{photo.file}: the object is black; name the photograph of that lamp, or leave it out"
        )


def _shortcomings(photos: int, enough: NDArray[np.bool_]) -> list[str]:
    """Sentences on what so many photographs, and pixels that most of them saturate, leave open."""
    said = []
    if not enough.all():
        said.append(
            f"{int((~enough).sum())} of {len(enough)} pixels are saturated in all but {_FEWEST - 1} photographs or"
            " fewer and have no normal; expose for less light"
        )
    if photos < FEWEST_FOR_A_LOBE:
        said.append(
            f"{photos} photographs don't show what is shadow, highlight or noise: the surface is taken for Lambertian,"
            f" and error bars hold little but noise; photograph it under {FEWEST_FOR_A_LOBE} lamps or more"
        )
    return said


def _check_camera(photoset: PhotoSet) -> None:
    first, *others = photoset.photos
    for photo in others:
        camera = photo.camera
        alike = camera.model == first.camera.model and np.array_equal(camera.params, first.camera.params)
        moved = np.abs(camera.world_to_camera - first.camera.world_to_camera).max()
        if not alike or (camera.width, camera.height) != (first.camera.width, first.camera.height):
            raise ValueError(
                f"{photo.file}: has another camera than {first.file}; shape = 'normals' compares photographs pixel by"
                " pixel: give one camera on a tripod"
            )
        if moved > _ONE_CAMERA:
            raise ValueError(
                f"{photo.file}: its camera stands elsewhere than that of {first.file} (world_to_camera differs by"
                f" {moved:.2g}); shape = 'normals' takes one camera that doesn't move"
            )


def _inside(photoset: PhotoSet, track: Track) -> NDArray[np.bool_]:
    """Pixels that all photographs' masks hold; a file that several photographs name is read once."""
    masked = {photo.mask: photo for photo in photoset.photos if photo.mask is not None}
    if not masked:
        raise ValueError(
            f"{photoset.manifest}: no photo has a mask; give mask = a picture that is nonzero where the object is"
        )
    inside = None
    for photo in track(list(masked.values()), "Reading masks"):
        mask = photo_mask(photo)
        assert mask is not None
        covered = mask >= _COVERED
        inside = covered if inside is None else inside & covered
        if not inside.any():
            raise ValueError(f"{photo.mask}: has no pixel in common with the other photographs' masks")
    assert inside is not None
    return inside


def _depth(photoset: PhotoSet) -> float:
    """Depth of the object's plane, metres: of [object] centre, the world's origin unless given."""
    camera = photoset.photos[0].camera
    depth = float(camera.depth(np.array(photoset.object.centre or (0.0, 0.0, 0.0)))[0])
    if depth <= 0 and not camera.is_orthographic:
        raise ValueError(
            f"{photoset.manifest}: [object] centre lies {-depth:.3g} m behind the camera; give centre, in metres in the"
            " world, or world_to_camera, so that the object is in front of it"
        )
    return depth


def _around(camera: Camera, inside: NDArray[np.bool_], depth: float) -> Sphere:
    """A sphere about the object's plane, half as wide as the mask: what near lamps must stand clear of."""
    points = surface_points(camera, np.where(inside, depth, np.nan)) @ picture_axes(camera) + camera.centre
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = max(float(np.ptp(points, axis=0).max()) / 4, 1e-9)
    return Sphere(centre, radius, np.zeros((4, 4)))


def _check_lamp(photoset: PhotoSet, photo: Photo, lighting: Lighting) -> None:
    where = f'{photoset.manifest}: photo {photo.label}: [[lighting]] "{lighting.name}"'
    if lighting.radiance_map is not None or len(lighting.directions) != 1:
        has = f"{len(lighting.directions)} lamps" if len(lighting.directions) != 1 else "a map of light"
        raise ValueError(
            f"{where}: has {has}; shape = 'normals' takes one lamp per photograph in a dark room: a directional or near"
            " source (`lightfactor mirrorball` finds its direction)"
        )
    if lighting.recovers:
        raise ValueError(
            f"{where}: recovers {lighting.recovers[0]}; shape = 'normals' takes measured lamps, and fits the light that"
            " comes back from the room anyway: give the lamp's irradiance, [1, 1, 1] for lamps that are all alike"
        )
    if not (lighting.irradiances > 0).all():
        raise ValueError(
            f"{where}: the lamp is dark in a channel: irradiance {lighting.irradiances[0].tolist()}"
        )


def _check_span(photoset: PhotoSet, lightings: Sequence[Lighting]) -> None:
    """ValueError where the lamps can't determine a normal."""
    if len(lightings) < _FEWEST:
        raise ValueError(
            f"{photoset.manifest}: has {len(lightings)} photo(s) to fit; a normal and an albedo take {_FEWEST} under"
            " different lamps, error bars and highlights a dozen"
        )
    if photoset.object.normals != UNKNOWN_NORMALS:
        return
    directions = np.concatenate([lighting.directions for lighting in lightings])
    spans = np.linalg.svd(directions, compute_uv=False)
    if spans[-1] < _LEAST_SPAN * spans[0]:
        raise ValueError(
            f"{photoset.manifest}: the lamps lie on a line as the object sees them (spread across it"
            f" {spans[-1] / spans[0]:.3f} of that along it, least {_LEAST_SPAN}): normals are ambiguous to its sides;"
            " add photographs with lamps off that line"
        )


def _given_normals(photoset: PhotoSet, inside: NDArray[np.bool_]) -> Floats | None:
    name = photoset.object.normals
    assert name is not None
    if name == UNKNOWN_NORMALS:
        return None
    path = photoset.resolve(name)
    found = read_normal_map(path)
    if found.inside.shape != inside.shape:
        raise ValueError(
            f"{path}: is {found.inside.shape[1]}x{found.inside.shape[0]} pixels, but the photographs are"
            f" {inside.shape[1]}x{inside.shape[0]}; give the normal map of these photographs"
        )
    lacking = int((inside & ~found.inside).sum())
    if lacking:
        raise ValueError(
            f"{path}: has no normal at {lacking} of the mask's {int(inside.sum())} pixels; shrink the mask"
        )
    return found.normals[inside]

"""A set of one camera and many lamps, solved: maps of its normals, and predicted photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from invrender.photometric_stereo.bounces import CONCAVE_FROM, bounced_light
from invrender.photometric_stereo.photographs import StereoCapture, read_capture
from invrender.photometric_stereo.solve import SolvedSurface, solve_stereo
from invrender.photometric_stereo.stack import PixelStack, PixelSurface
from recon.normals.integration import integrate
from recon.normals.normalmap import NormalMap

Floats = NDArray[np.float64]
# A photograph is odd whose error is so many times the usual one, and more than a share of its radiance.
_ODD, _ODD_LEAST = 4.0, 0.1


@dataclass(frozen=True, eq=False)
class StereoResult:
    """A set whose normals and albedo are solved. depths : (h, w) metres along the camera's axis, NaN outside."""

    capture: StereoCapture
    solved: SolvedSurface
    depths: Floats

    @property
    def normal_map(self) -> NormalMap:
        """Normals in the picture's axes with standard deviations; without these where the normals were given."""
        sought = self.capture.normals is None
        std_deg = self.as_picture(self.solved.deviations.normal_deg) if sought else None
        return NormalMap(self.as_picture(self.solved.surface.normals), std_deg)

    def as_picture(self, values: Floats) -> Floats:
        """Values of pixels (p, ...) as a picture (h, w, ...), NaN outside."""
        picture = np.full((*self.capture.inside.shape, *values.shape[1:]), np.nan)
        picture[self.capture.inside] = values
        return picture

    @cached_property
    def _every_photo(self) -> PixelStack:
        """The stack of all photographs, held-out ones as well, of the surface that was found."""
        stack = self.capture.stack(np.arange(len(self.capture.photoset.photos)), self.depths)
        if self.solved.stack.bounced is None:
            return stack
        bounced, _ = bounced_light(self.solved.surface, stack, self.capture.camera, self.depths)
        return replace(stack, bounced=bounced)

    def predicted(self, photo: int) -> tuple[Floats, Floats]:
        """Radiance (p, 3) that one of the set's photographs should have, and its error, relative RMS."""
        places = np.array([photo])
        stack = self._every_photo.of_photos(places)
        shown = self.solved.reflection.predicted(self.solved.surface, stack)
        shown = (shown * self.capture.irradiances(places, self.depths))[:, 0]
        usable, seen = self.capture.usable[:, photo], self.capture.radiance[:, photo].astype(float)
        off = np.sqrt(((shown - seen)[usable] ** 2).mean() / max((seen[usable] ** 2).mean(), 1e-300))
        return shown, off


def odd_photographs(photos: Sequence[Photo], errors: Sequence[float]) -> list[str]:
    """Sentences on photographs that are predicted far worse than usual; errors : of each, relative RMS."""
    usual = float(
        np.median([error for photo, error in zip(photos, errors, strict=True) if not photo.held_out])
    )
    return [
        f"{photo.label} is predicted {error:.0%} off, a usual photograph {usual:.1%}: check whether its lamp is another"
        " one's, and whether the camera or the object had moved"
        for photo, error in zip(photos, errors, strict=True)
        if error > max(_ODD * usual, _ODD_LEAST)
    ]


def photometric_stereo(photoset: PhotoSet, track: Track = silent) -> StereoResult:
    """Normals, albedo and the shared lobe of a set whose [object] shape is "normals"; ValueError says what it lacks."""
    return solve_capture(read_capture(photoset, track), track)


def solve_capture(capture: StereoCapture, track: Track = silent) -> StereoResult:
    """The same of photographs that were read."""
    fitted = capture.places(held_out=False)
    plane = capture.stack(fitted, capture.plane())
    near = len(plane.lamps) > 1

    def depths_of(surface: PixelSurface) -> Floats:
        normals = np.full((*capture.inside.shape, 3), np.nan)
        normals[capture.inside] = surface.normals
        return integrate(NormalMap(normals), capture.camera, capture.depth)

    def surroundings(surface: PixelSurface) -> PixelStack | None:
        depths = depths_of(surface)
        stack = capture.stack(fitted, depths) if near else plane
        bounced, share = bounced_light(surface, stack, capture.camera, depths)
        if share > CONCAVE_FROM:
            return replace(stack, bounced=bounced)
        return stack if near else None

    lamp_std = float(np.radians(capture.photoset.direction_std_deg))
    solved = solve_stereo(plane, capture.inside, surroundings, capture.normals, lamp_std, track)
    return StereoResult(capture, solved, depths_of(solved.surface))

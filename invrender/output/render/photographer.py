"""What takes pictures of a result: its object of its material under one light. No options as text, no terminal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.lighting import Lighting
from capture.photoset import PhotoSet
from invrender.output.render.interreflection import bounces_of
from invrender.output.render.light import light_element, turned
from invrender.output.render.picture import TOLERANCE, Picture, pixel_terms, take_picture
from invrender.output.render.subject import Subject, mesh_subject, photographed_subject, sphere_subject
from invrender.output.render.view import View, ViewCamera, new_optics, seen_from
from invrender.result.reflectance import Reflectance, assumption_notes, reflectance
from invrender.result.saved import SavedResult
from invrender.result.source_set import find_photoset, photo_camera
from invrender.transport.radiosity import Bounced
from invrender.transport.transfer import LightElement

Floats = NDArray[np.float64]

_MADE_UP = (
    "The photo set isn't beside the result (--set names it): what of the camera isn't given is made up, ten radii"
    " away, the object filling three quarters of the picture."
)


@dataclass(frozen=True, eq=False)
class Photographer:
    """Takes pictures of a subject under a lighting.

    photoset : that the result was made from; None where it wasn't found.
    """

    result: SavedResult
    photoset: PhotoSet | None
    subject: Subject
    material: Reflectance
    lighting: Lighting

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of every picture, in sentences."""
        return (
            *self.material.notes,
            *assumption_notes(self.material, self.lighting),
            *self.subject.warnings,
        )

    def optics(self, size: tuple[int, int] | None = None, fov_deg: float | None = None) -> ViewCamera:
        """The camera for new views: the photographs', as far as size (pixels) and field of view leave it."""
        photographs = None
        if self.photoset is not None:
            known = self.result.content.object
            cameras = [photo.camera for photo in self.photoset.photos]
            photographs = (cameras, np.array(known.centre), known.radius)
        return new_optics(photographs, self.subject.radius, size, fov_deg)

    def camera(self, view: View, optics: ViewCamera) -> Camera:
        """The camera at a view of the subject."""
        return seen_from(optics, view, self.subject.centre, self.subject.radius)

    def made_up(self, view: View, size: tuple[int, int] | None, fov_deg: float | None) -> tuple[str, ...]:
        """A sentence where something of a new view's camera is made up, for want of the photographs'."""
        given = fov_deg is not None and size is not None and view.distance is not None
        return () if given or self.photoset is not None else (_MADE_UP,)

    def photo_camera(self, label: str) -> Camera:
        """The camera of a photograph; ValueError names the nearest where there is none of that name."""
        return photo_camera(self.result, self.photoset, label)

    def take(
        self,
        camera: Camera,
        light_turn: float = 0.0,
        with_std: bool = False,
        percent: float | None = None,
    ) -> Picture:
        """The picture from a camera, the light turned about +Z by so many degrees; percent : as `--tolerance`."""
        if with_std and not np.isfinite(self.material.covariance).all():
            raise ValueError("--std: the result has no standard deviations; leave it out")
        element = self._under(light_turn)
        if percent and (element.slow_map is None or self.material.brdf.form.axis is not None):
            why = (
                "the light holds no map"
                if element.slow_map is None
                else "a brushed lobe is integrated for each ray"
            )
            raise ValueError(f"--tolerance: nothing is interpolated, for {why}; leave it out")
        bounced = self.bounced(element)
        allowed = TOLERANCE if percent is None else percent / 100
        return take_picture(self.subject, camera, self.material, element, with_std, bounced, allowed)

    def terms(self, camera: Camera, row: int, column: int) -> tuple[Floats, Floats, Floats]:
        """Radiance (3,) of a camera's pixel by the base, by the lobe, and by what the subject sends itself."""
        element = self._under(0.0)
        bounced = self.bounced(element)
        return pixel_terms(self.subject, camera, self.material, element, (row, column), bounced)

    def bounced(self, element: LightElement) -> Bounced | None:
        """What the subject's parts send each other under an element; None where that isn't to be added."""
        return None if self._bounces is None else self._bounces(element)

    @cached_property
    def _under(self) -> Callable[[float], LightElement]:
        # Pictures in which the light rests share what is prepared of it.
        return lru_cache(maxsize=1)(partial(turned, light_element(self.lighting), self.subject.centre))

    @cached_property
    def _bounces(self) -> Callable[[LightElement], Bounced | None] | None:
        if not self.result.bounces:
            return None
        return bounces_of(self.subject, self.material, self.result.albedo)


def photographer(
    result: SavedResult,
    lighting: Lighting,
    photoset: Path | None = None,
    assumed: Mapping[str, float] | None = None,
    means: bool = False,
    mesh: Path | None = None,
    mesh_to_world: Path | None = None,
    radius: float | None = None,
) -> Photographer:
    """What takes pictures of a result, or of its material on another object, under a lighting.

    photoset : the set that the result was made from, looked for around it if None. assumed : values of mu or sigma that
    are undetermined. means : of textures. mesh, mesh_to_world : another mesh, and a JSON file that places it. radius :
    of a sphere, metres. ValueError where something is undetermined, missing, or doesn't go together.
    """
    if mesh is not None and radius is not None:
        raise ValueError("--radius is a sphere's; it excludes --mesh")
    if mesh_to_world is not None and mesh is None:
        raise ValueError("--mesh-to-world places a mesh; give --mesh")
    material = reflectance(result, assumed or {}, means)
    found = find_photoset(result, photoset)
    if mesh is not None:
        subject = mesh_subject(mesh, mesh_to_world)
    elif radius is not None:
        subject = sphere_subject(np.array(result.content.object.centre), radius)
    else:
        subject = photographed_subject(result, found)
    _check_textures(material, subject, mesh, radius)
    return Photographer(result, found, subject, material, lighting)


def _check_textures(material: Reflectance, subject: Subject, mesh: Path | None, radius: float | None) -> None:
    """ValueError where textures don't go with what is rendered."""
    if material.textures is not None and material.textures.at_vertices:
        if mesh is not None or radius is not None:
            raise ValueError(
                "the result's Kd and Ks vary from vertex to vertex of its own mesh; leave --mesh and --radius out, or"
                " give --mean for the means"
            )
    elif material.textures is not None and not subject.has_texture_coordinates:
        what = f"{mesh}: has no texture coordinates" if mesh else "a sphere has none"
        raise ValueError(
            f"the result's Kd and Ks vary over its mesh by its texture coordinates, and {what}; give a mesh that has"
            " them (OBJ, GLB), or --mean for the means"
        )

"""A scene: a surface of a material, the light on it, and where it is photographed from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture.camera import Camera
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import PointSource
from synthetic.materials.energy import check_energy
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.texture import Textured
from synthetic.shapes.surface import Surface


@dataclass(frozen=True)
class Effort:
    """How finely a photograph is integrated.

    directions : per pixel, light and lobe, a power of two. Halving it doubles the error at shadows' edges.
    per_side : sub-samples along a pixel's side, 1, 2, 4 or 8. bounces : reflections between parts of the object.
    """

    directions: int = 1024
    per_side: int = 4
    bounces: int = 0

    def __post_init__(self) -> None:
        if self.per_side not in (1, 2, 4, 8):
            raise ValueError(f"per_side is {self.per_side}; it must be 1, 2, 4 or 8")
        if self.directions < self.per_side**2 or self.directions & (self.directions - 1):
            raise ValueError(
                f"directions is {self.directions}; it must be a power of two and at least per_side^2 ="
                f" {self.per_side**2}"
            )
        if not 0 <= self.bounces <= 16:
            raise ValueError(f"bounces is {self.bounces}; it must be 0 to 16")


@dataclass(frozen=True, eq=False)
class Shot:
    """One photograph to be taken. held_out : it is kept for scoring."""

    camera: Camera
    illumination: Illumination
    held_out: bool = False


@dataclass(frozen=True, eq=False)
class Scene:
    """What is photographed, in front of black. seed : of all that is random in rendering."""

    name: str
    surface: Surface
    material: Material
    shots: tuple[Shot, ...]
    effort: Effort = Effort()
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.shots:
            raise ValueError(f"scene {self.name!r} has no photograph: give it a camera")
        names = [illumination.name for illumination in self.illuminations]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(
                    f"scene {self.name!r}: two lightings are named {name!r}; a turntable's are NAME-000, NAME-001, ...:"
                    " rename one"
                )
        check_energy(self.material)
        plain = self.material.material if isinstance(self.material, Textured) else self.material
        if self.effort.bounces and isinstance(plain, MicrofacetMaterial):
            raise ValueError(
                f"scene {self.name!r}: RH01's lobe as printed reflects without bound at grazing angles, so light can't"
                " bounce between its surfaces: use model = 'smith' (half-angle Fresnel, shadowing-masking)"
            )
        for illumination in self.illuminations:
            self._check_lights(illumination)
        for index, shot in enumerate(self.shots):
            self._check_camera(index, shot.camera)

    @property
    def illuminations(self) -> tuple[Illumination, ...]:
        """All lightings, each once, in the order of the photographs."""
        return tuple({id(shot.illumination): shot.illumination for shot in self.shots}.values())

    def _check_lights(self, illumination: Illumination) -> None:
        points = [
            source
            for source in illumination.sources
            if not (isinstance(source, PointSource) and source.radius)
        ]
        if self.material.is_mirror and points:
            raise ValueError(
                f"scene {self.name!r}: a mirror shows lamps only if they have a size: give the sources of lighting"
                f" {illumination.name!r} a radius_deg"
            )
        for source in illumination.sources:
            if isinstance(source, PointSource) and self.surface.contains(source.position[None])[0]:
                raise ValueError(
                    f"scene {self.name!r}: the lamp at {source.position.tolist()} m stands inside the object"
                )

    def _check_camera(self, index: int, camera: Camera) -> None:
        if not camera.is_orthographic:
            if self.surface.contains(camera.centre[None])[0]:
                raise ValueError(
                    f"scene {self.name!r}: camera {index} at {camera.centre.round(4).tolist()} m is inside the object"
                )
            if camera.depth(self.surface.centre)[0] <= 0:
                raise ValueError(f"scene {self.name!r}: the object is behind camera {index}")
        size = np.array([camera.width, camera.height])
        middle = camera.project(self.surface.centre[None])[0]
        if not (np.isfinite(middle).all() and (middle > 0).all() and (middle < size).all()):
            raise ValueError(
                f"scene {self.name!r}: the object's centre is at pixel {middle.round(1).tolist()} of camera {index},"
                f" outside its {camera.width} x {camera.height} picture: point the camera at the object"
            )

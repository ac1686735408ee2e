"""What is planned: an object, the light on it, the views and the sensor, as plain arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from capture.calibrationerrors import NO_ERRORS, CalibrationErrors
from capture.camera import Camera
from capture.lighting import Lighting, latlong_solid_angles
from invrender.brdf.microfacet import Microfacet
from recon.mesh.bodies import Body

Floats = NDArray[np.float64]

# What a plan leaves aside, wherever its object comes from.
MEANS_NOTE = "the object is planned as if it had the mean Kd and Ks of its texture everywhere"
INTERFACE_NOTE = "the base under an interface is planned as a Lambertian one, which says less of mu"
BOUNCES_NOTE = "light that bounces between parts of the object isn't planned with"


class PlannedSensor(Protocol):
    """What noise photographs will have."""

    @property
    def exposures(self) -> int:
        """Photographs of a set that one view makes: 1, or those of a bracket."""

    def exposure_s(self, photographs: Sequence[Floats]) -> float:
        """Exposure time for a set whose object shows radiances (k, 3), a picture of it, in each photograph."""

    def information(self, radiance: Floats, photograph: Floats, exposure_s: float) -> Floats:
        """Inverse variance (n, 3) of radiance (n, 3), mean over the exposures; 0 where they saturate.

        photograph : (k, 3), what the object shows in the same photograph.
        """


@dataclass(frozen=True, eq=False)
class PlannedLight:
    """A lighting as it is, and whether the photo set gives it."""

    lighting: Lighting
    known: bool

    @property
    def near(self) -> tuple[int, ...]:
        """Which of its sources are near."""
        closeness = self.lighting.closeness
        return () if closeness is None else tuple(np.flatnonzero(closeness).tolist())

    @property
    def total(self) -> Floats:
        """Radiance summed over all directions, plus the irradiances of all sources, (3,)."""
        total = self.lighting.irradiances.sum(axis=0)
        if self.lighting.radiance_map is not None:
            weights = latlong_solid_angles(len(self.lighting.radiance_map))[:, :, None]
            total = total + (self.lighting.radiance_map * weights).sum(axis=(0, 1))
        return np.asarray(total, float)


@dataclass(frozen=True, eq=False)
class PlannedView:
    """One photograph to be taken. light : which of the experiment's. name : as its file is called, "007"."""

    camera: Camera
    light: int
    name: str = ""


@dataclass(frozen=True, eq=False)
class Experiment:
    """An object of known shape and reflectance, photographed in known light: the truth that a plan starts from.

    brdf : sigma is None, and Ks zero, for matte objects; mu is None where there is no Fresnel factor.
    centre : (3,) metres, of the object: directions of views count from there.
    notes : sentences on what the plan takes for something else than scene or result say.
    errors : of what the set will give; those of light directions are in the lights.
    found_place : (4,), what of a sphere's centre and radius its outlines will give.
    """

    name: str
    body: Body
    centre: Floats
    brdf: Microfacet
    lights: tuple[PlannedLight, ...]
    views: tuple[PlannedView, ...]
    sensor: PlannedSensor
    notes: tuple[str, ...] = ()
    errors: CalibrationErrors = NO_ERRORS
    found_place: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(4, bool))

    def __post_init__(self) -> None:
        if not self.views:
            raise ValueError(f"{self.name}: there is no photograph to plan; give the scene views")
        if not (self.brdf.kd.any() or self.brdf.ks.any()):
            raise ValueError(
                f"{self.name}: Kd and Ks are zero: the object reflects nothing; give it a colour"
            )
        if (self.brdf.sigma is None) == bool(self.brdf.ks.any()):
            raise ValueError(
                f"{self.name}: Ks is {self.brdf.ks.tolist()} and sigma {self.brdf.sigma}; a specular part needs both"
            )

    @property
    def distance(self) -> float:
        """Median distance of the cameras from the object's centre, metres."""
        return float(np.median([np.linalg.norm(view.camera.centre - self.centre) for view in self.views]))

    def direction(self, view: PlannedView) -> Floats:
        """The unit direction (3,) from the object to a view's camera."""
        offset = view.camera.centre - self.centre
        return np.asarray(offset / np.linalg.norm(offset))

    @property
    def gauge_light(self) -> int | None:
        """The light whose total fixes the scale where the set gives no light at all; None where it gives some."""
        used = sorted({view.light for view in self.views})
        return None if any(self.lights[k].known for k in used) else used[0]


def angles_deg(direction: Floats) -> tuple[float, float]:
    """Azimuth, from +X towards +Y, and elevation above the horizon of a direction (3,), as scenes have them."""
    x, y, z = direction / np.linalg.norm(direction)
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arcsin(np.clip(z, -1, 1))))

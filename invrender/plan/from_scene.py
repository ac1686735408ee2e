"""A synthetic scene as an experiment to plan: what is staged, in plain arrays. The only module here that imports
`synthetic`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.calibrationerrors import CalibrationErrors, lens_errors, stated_pose
from capture.lighting import Lighting
from invrender.brdf.microfacet import Microfacet
from invrender.brdf.phong import phong_sigma
from invrender.plan.experiment import (
    BOUNCES_NOTE,
    INTERFACE_NOTE,
    MEANS_NOTE,
    Experiment,
    PlannedLight,
    PlannedView,
)
from recon.mesh.bodies import MeshBody, SphereBody
from recon.mesh.shape import placed
from recon.sphere.sphere import Sphere
from synthetic.lights.disc import DiscLight
from synthetic.lights.illumination import Given, Illumination, latlong_map
from synthetic.lights.sources import PointSource
from synthetic.materials.facets import GGXSlopes
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.plastic import Plastic
from synthetic.materials.smith import SmithMaterial
from synthetic.materials.texture import Textured
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_path
from synthetic.sensing.autoexposure import choose_exposure, object_brightness
from synthetic.sensing.development import Development
from synthetic.sensing.noise import Noise
from synthetic.sensing.sensor import signal_of
from synthetic.shapes.ball import Ball
from synthetic.staging import Staging

Floats = NDArray[np.float64]

_MAP_HEIGHT = 128
# Discs up to this radius are planned as sources: a map's pixels, 1.4 degrees, would hold them as badly.
_SMALL_DISC = np.radians(3.0)


def read_experiment(scene: str, given: Given | None = None) -> tuple[Experiment, Path]:
    """The experiment of a built-in scene's name, or of a scene file; and the file.

    given : what the set gives of the light, instead of what the file says. ValueError says what is wrong.
    """
    path = scene_path(scene)
    # Paint is planned by its mean, so that nobody asks where on the surface it lies.
    return experiment_of(read_staging(path, given, atlas=False)), path


def experiment_of(staging: Staging) -> Experiment:
    """What is to be planned of a staged scene: photographs that are held out, and faults, are left aside.

    ValueError for materials that RH01's parameters can't stand for.
    """
    scene, stated = staging.scene, staging.uncertainty
    brdf, notes = _brdf(scene.name, scene.material)
    shots = [(f"{index:03d}", shot) for index, shot in enumerate(scene.shots) if not shot.held_out]
    if not shots:
        raise ValueError(f"{scene.name}: all photographs are held out; leave some to fit")
    used = list({id(shot.illumination): shot.illumination for _, shot in shots}.values())
    for light in used:
        notes += _light_notes(light, np.asarray(scene.surface.centre))
    if isinstance(scene.material, Textured):
        notes.append(MEANS_NOTE)
        if any(light.given == "nothing" for light in used):
            notes.append(
                "texture and light, both unknown, can't be separated (RH01, section 6.4), whatever is said here"
            )
    if any(value for key, value in staging.faults.model_dump().items() if key not in _HARMLESS):
        notes.append(
            "what is wrong on purpose ([faults]: poses, mesh, outliers, background) isn't planned with"
        )
    if scene.effort.bounces:
        notes.append(BOUNCES_NOTE)
    surface = scene.surface
    if isinstance(surface, Ball):
        body: SphereBody | MeshBody = SphereBody(Sphere(surface.centre, surface.radius, np.zeros((4, 4))))
    else:
        assert staging.mesh is not None, "what isn't a ball has a mesh"
        body = MeshBody(placed(staging.mesh, staging.mesh_to_world))
    cameras = {name: shot.camera for name, shot in shots}
    errors = CalibrationErrors(
        stated_pose=stated_pose(stated.rotation_deg, stated.position),
        lenses=lens_errors(cameras, {}, stated.focal_length),
        height=stated.height or 0.0,
        height_correlation=stated.height_correlation or 0.0,
        stated=any(stated.model_dump().values()),
    )
    index = {id(light): k for k, light in enumerate(used)}
    sensor = staging.sensor
    return Experiment(
        name=scene.name,
        body=body,
        # A view of a scene file looks at the object's frame, wherever its middle lies.
        centre=staging.mesh_to_world[:3, 3] if staging.mesh is not None else np.asarray(surface.centre),
        brdf=brdf,
        lights=tuple(_light(light, surface.centre, stated.direction_deg or 0.0) for light in used),
        views=tuple(PlannedView(shot.camera, index[id(shot.illumination)], name) for name, shot in shots),
        sensor=DevelopedSensor(sensor) if isinstance(sensor, Development) else NoisySensor(sensor),
        notes=tuple(notes),
        errors=errors,
        found_place=np.full(4, isinstance(surface, Ball) and not staging.stated),
    )


_HARMLESS = ("background", "mesh_correlation_m")


@dataclass(frozen=True)
class NoisySensor:
    """The ideal sensor's noise, `Noise`."""

    noise: Noise

    @property
    def exposures(self) -> int:
        return 1

    def exposure_s(self, photographs: Sequence[Floats]) -> float:
        return 1.0

    def information(self, radiance: Floats, photograph: Floats, exposure_s: float) -> Floats:
        floor = self.noise.floor * float(photograph.mean())
        return np.asarray(1 / np.maximum((self.noise.relative * radiance) ** 2 + floor**2, 1e-300))


@dataclass(frozen=True, eq=False)
class DevelopedSensor:
    """A camera's noise: of photons, of reading out, and of rounding to codes behind the response curve."""

    development: Development

    @property
    def exposures(self) -> int:
        return len(self.development.bracket)

    def exposure_s(self, photographs: Sequence[Floats]) -> float:
        # Vignetting goes by places in a picture, and these pixels have none.
        sensor = replace(self.development.sensor, focal_px=np.inf)
        seen = [
            object_brightness(radiance[None], np.ones((1, len(radiance))), sensor) for radiance in photographs
        ]
        return choose_exposure(seen, self.development)

    def information(self, radiance: Floats, photograph: Floats, exposure_s: float) -> Floats:
        sensor = self.development.sensor
        top = 2**sensor.bits - 1
        white = float(signal_of(1 - 0.5 / top, sensor))
        total = np.zeros_like(radiance)
        times = self.development.times(exposure_s)
        for time in times:
            signal = np.clip(radiance * time, 0, 1)
            # Half a code below and above: how much signal a code stands for.
            low, high = np.clip(signal - _SLOPE, 0, 1), np.clip(signal + _SLOPE, 0, 1)
            step = (high - low) / np.maximum(sensor.curve(high) - sensor.curve(low), 1e-12) / top
            variance = signal / sensor.full_well + (sensor.read_noise / sensor.full_well) ** 2 + step**2 / 12
            total += np.where(radiance * time < white, time**2 / variance, 0.0)
        return np.asarray(total / len(times))


_SLOPE = 1e-4


def _brdf(name: str, material: Material) -> tuple[Microfacet, list[str]]:
    """RH01's parameters of a material, and what was taken for what."""
    match material:
        case Textured():
            plain, notes = _brdf(name, material.material)
            return replace(plain, kd=material.kd, ks=material.ks), notes
        case Lambertian():
            return Microfacet(material.kd, np.zeros(3), None, None), []
        case MicrofacetMaterial():
            return _microfacet(material, material.mu, material.sigma), []
        case Plastic():
            plain, notes = _brdf(name, material.gloss)
            return plain, [*notes, INTERFACE_NOTE]
        case SmithMaterial() if not material.is_isotropic:
            raise ValueError(
                f"{name}: an anisotropic lobe has two roughnesses, and a plan is for RH01's one: plan it with model ="
                " 'ggx' and an alpha between them"
            )
        case SmithMaterial():
            width, mu = material.facets.along, material.mu
            notes = []
            if isinstance(material.facets, GGXSlopes):
                notes.append(
                    f"GGX of alpha {width:g} is planned as RH01's lobe of sigma {width:g}, of the same peak"
                )
            else:
                notes.append("the exact (Smith) lobe is planned as RH01's: same Kd, Ks, sigma and mu")
            if isinstance(mu, complex) and mu.imag:
                notes.append(f"a metal of index {mu} is planned without a Fresnel factor")
                mu = None
            return _microfacet(material, None if mu is None else float(np.real(mu)), width), notes
        case PhongMaterial() if material.exponent > 0:
            # cos^s of twice the half-angle falls off as exp(-2 s theta_h^2); peaks (s + 2) / 2 pi and 1 / 4 pi sigma^2.
            sigma = phong_sigma(material.exponent)
            notes = [f"Phong's exponent {material.exponent:g} is planned as RH01's lobe of sigma {sigma:.3g}"]
            scaled = material.ks * (material.exponent + 2) / (2 * np.pi) * 4 * np.pi * sigma**2
            return _microfacet(replace(material, ks=scaled), None, sigma), notes
        case _:
            raise ValueError(
                f"{name}: a material of model {type(material).__name__.lower()!r} has no roughness and index that could"
                " be planned; give it model = 'microfacet' (kd, ks, sigma, mu) of a material like it"
            )


def _microfacet(material: Material, mu: float | None, sigma: float) -> Microfacet:
    if not material.ks.any():
        return Microfacet(material.kd, material.ks, None, None)
    return Microfacet(material.kd, material.ks, mu, sigma)


def _light(light: Illumination, centre: Floats, direction_std_deg: float) -> PlannedLight:
    discs = [one for one in light.extended if isinstance(one, DiscLight) and one.radius_rad <= _SMALL_DISC]
    extended = [one for one in light.extended if one not in discs]
    sources: list[tuple[Floats, Floats]] = [(disc.direction, disc.irradiance) for disc in discs]
    distances = [np.inf] * len(discs)
    for source in light.sources:
        directions, away, irradiances = source.at(np.asarray(centre)[None])
        sources.append((directions[0], irradiances[0]))
        # A set that calls them distant is solved with distances that are found; what these cost isn't planned.
        distances.append(np.inf if light.given == "distant" else float(away[0]))
    closeness = 1 / np.array(distances)
    lighting = Lighting(
        light.name,
        latlong_map(extended, _MAP_HEIGHT) if extended else None,
        np.array([direction for direction, _ in sources]).reshape(-1, 3),
        np.array([irradiance for _, irradiance in sources]).reshape(-1, 3),
        direction_std_deg=np.full(len(sources), direction_std_deg) if direction_std_deg else None,
        closeness=closeness if closeness.any() else None,
        centre=np.asarray(centre),
    )
    return PlannedLight(lighting, light.given != "nothing")


def _light_notes(light: Illumination, centre: Floats) -> list[str]:
    lamps = [source for source in light.sources if isinstance(source, PointSource)]
    if not lamps or light.given != "distant":
        return []
    nearest = min(float(np.linalg.norm(lamp.position - centre)) for lamp in lamps)
    return [
        f"lamps of lighting {light.name!r}, {nearest:.2g} m away or more, are planned as if they were distant, as the"
        " set calls them: what their nearness distorts isn't in these numbers"
    ]

"""A sphere under a light, its photographs by brute force, what fits say of them, and what theory says beforehand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.arc.gantry import Arc
from capture.camera import Camera
from capture.lighting import Lighting
from capture.polarisation import Polariser
from invrender.brdf import microfacet
from invrender.estimate.identifiability import lighting_degree
from invrender.estimate.quantities import Quantity
from invrender.estimate.solution import Solution, factorize
from invrender.estimate.unknown_light import BlindSolution, factorize_blind
from invrender.plan.experiment import Experiment, PlannedLight, PlannedView
from invrender.plan.from_scene import NoisySensor
from invrender.plan.information import Marginal, Posterior
from invrender.plan.photographs import Draw, unexposed
from invrender.plan.prepared import Bench
from invrender.plan.prospect import AskedBrdf
from invrender.transport.columns import all_columns
from invrender.transport.transfer import light_elements
from recon.mesh.bodies import SphereBody
from recon.sampling.draw import NO_SOURCES, sample_body
from recon.sampling.lightfield import LightField, off_terminators
from recon.sphere.sphere import Sphere
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.render.lobes import reflected_radiance
from synthetic.sensing.noise import Noise

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TEFLON = radiometric(RH01_MATERIALS["teflon"])
AREA = AreaLight(np.array([-0.26, 0.72, 0.64]), np.array([1.5, 1.6, 1.8]), width_rad=0.35)
SOURCE = DirectionalSource(np.array([0.85, -0.31, 0.42]), np.array([1.6, 1.5, 1.35]))
SPHERE = Sphere(np.zeros(3), 0.02, np.zeros((4, 4)))
QUANTITIES = ("Ks share", "mu", "sigma")
_KEYS = {"Ks share": "ks_normalised", "mu": "mu", "sigma": "sigma"}
# The share is the green channel's.
_GREEN = 1
_CAMERA_DISTANCE = 0.6
_MAP_HEIGHT = 128
# What crossed filters pass of highlights, as if it had been measured.
_EXTINCTION = 0.01
# Samples by which theory is evaluated.
_LOOKED_AT = 1500


@dataclass(frozen=True, eq=False)
class Stage:
    """What is photographed, and whether the fit is told the light.

    views : how many photographs, evenly over half a circle about the sphere. samples : of all of them. l_max : of the
    lighting that a blind fit looks for. noise : relative, with a floor of a tenth of it. polarised : whether
    photographs are taken through filters, in turn parallel and crossed.
    """

    material: MicrofacetMaterial = TEFLON
    areas: tuple[AreaLight, ...] = (AREA,)
    sources: tuple[DirectionalSource, ...] = (SOURCE,)
    known: bool = False
    views: int = 6
    samples: int = 1500
    radius_px: float = 30.0
    l_max: int = 8
    relative: float = 0.01
    polarised: bool = False

    @property
    def noise(self) -> Noise:
        return Noise(self.relative, self.relative / 10)

    @property
    def lighting(self) -> Lighting:
        """The light as a fit may be told it."""
        return Lighting(
            "light",
            latlong_map(self.areas, _MAP_HEIGHT) if self.areas else None,
            np.array([source.direction for source in self.sources]).reshape(-1, 3),
            np.array([source.irradiance for source in self.sources]).reshape(-1, 3),
        )

    @property
    def cameras(self) -> list[Camera]:
        focal, side = self.radius_px * _CAMERA_DISTANCE / SPHERE.radius, int(2.2 * self.radius_px)
        poses = [
            Arc(np.zeros(3), [0, 0, 1], _CAMERA_DISTANCE, [1, 0, 0]).pose(angle)
            for angle in np.pi * np.arange(self.views) / self.views
        ]
        return [
            Camera("PINHOLE", np.array([focal, focal, side / 2, side / 2]), side, side, pose)
            for pose in poses
        ]

    def fields(self) -> list[LightField]:
        """Samples, still black."""
        found = []
        directions = self.lighting.directions if self.known else NO_SOURCES
        for index, camera in enumerate(self.cameras):
            rng = np.random.default_rng(index)
            budget = max(self.samples // self.views, 1)
            field = sample_body(SphereBody(SPHERE), camera, unexposed(camera), None, directions, budget, rng)
            found.append(off_terminators(field, directions).through(self.polariser(index)))
        return found

    def polariser(self, index: int) -> Polariser | None:
        """The filter of a photograph, by its number."""
        if not self.polarised:
            return None
        return Polariser("cross" if index % 2 else "parallel", 0.5, _EXTINCTION)

    def photographs(self) -> list[LightField]:
        """Without noise."""
        return [lit(self, field, field.normals, field.views) for field in self.fields()]

    def drawn(self, number: int) -> list[LightField]:
        """Photographs with a draw of the noise, by its number."""
        return self.noisy(self.photographs(), np.random.default_rng(number))

    def noisy(self, photos: Sequence[LightField], rng: np.random.Generator) -> list[LightField]:
        return [
            replace(photo, radiance=self.noise.applied(photo.radiance, np.ones(len(photo)), rng))
            for photo in photos
        ]


# Known light tells more: fewer samples will do.
TOLD = Stage(known=True, views=4, samples=800)


def lit(
    stage: Stage,
    field: LightField,
    normals: Floats,
    views: Floats,
    lamps: Sequence[DirectionalSource | PointSource] | None = None,
) -> LightField:
    """Samples with the radiance that normals and views (m, 3) of their rays send, by brute force.

    lamps : instead of the stage's sources; those near by are at their distance from the field's positions.
    """

    def sent(material: MicrofacetMaterial) -> Floats:
        radiance = reflected_radiance(material, stage.areas, [], normals, views)
        for lamp in stage.sources if lamps is None else lamps:
            towards, _, irradiance = lamp.at(field.positions)
            cosine = np.maximum((normals * towards).sum(axis=1), 0)[:, None]
            radiance = radiance + material.evaluate(normals, towards, views) * cosine * irradiance
        return np.asarray(field.mean_over_rays(radiance))

    if field.lobe_share is None:
        return replace(field, radiance=sent(stage.material))
    base, lobe = replace(stage.material, ks=np.zeros(3)), replace(stage.material, kd=np.zeros(3))
    return replace(field, radiance=sent(base) + field.lobe_share[:, None] * sent(lobe))


@dataclass(frozen=True)
class Finding:
    """What a fit, or theory beforehand, says of one number: its error, its standard deviation, its status.

    error : of what the fit holds, whether it stands behind it or not; None where its model lacks the number. status :
    "determined", "weak", "undetermined", or "absent" where the model lacks it.
    """

    error: float | None
    std: float | None
    status: str

    @property
    def stated(self) -> bool:
        """Whether a number is given."""
        return self.status in ("determined", "weak")


ABSENT = Finding(None, None, "absent")


def fitted(stage: Stage, photos: Sequence[LightField]) -> dict[str, Finding]:
    """What a fit says of the Ks share, mu and sigma, with the light told or not."""
    return (
        known_findings(stage, told(stage, photos))
        if stage.known
        else blind_findings(stage, blind(stage, photos))
    )


def told(stage: Stage, photos: Sequence[LightField]) -> Solution:
    """The fit under known light."""
    lighting = stage.lighting
    elements = light_elements(lighting)
    columns = all_columns([lighting.name] * len(photos), {lighting.name: elements}, photos)
    return factorize(columns, [lighting])


def blind(stage: Stage, photos: Sequence[LightField]) -> BlindSolution:
    """The fit under unknown light."""
    return factorize_blind(photos, orders=[stage.l_max], ladder=False)


def known_findings(stage: Stage, solution: Solution) -> dict[str, Finding]:
    brdf = solution.brdf
    share = float(brdf.ks[_GREEN] / max(brdf.kd[_GREEN] + brdf.ks[_GREEN], 1e-300))
    std = _deviations(solution, "ks_normalised.g")
    return _findings(stage, (share, brdf.mu, brdf.sigma), std, solution.quantities)


def blind_findings(stage: Stage, solution: BlindSolution) -> dict[str, Finding]:
    share = float(solution.brdf_share[_GREEN])
    std = _deviations(solution, "share g")
    return _findings(stage, (share, solution.mu, solution.sigma), std, solution.quantities)


def _deviations(solution: Solution | BlindSolution, share: str) -> dict[str, float]:
    std = np.sqrt(np.diag(solution.covariance))
    by_name = dict(zip(solution.covariance_names, std.tolist(), strict=True))
    return {
        "Ks share": by_name.get(share, 0.0),
        "mu": by_name.get("mu", 0.0),
        "sigma": by_name.get("sigma", 0.0),
    }


def truths(material: MicrofacetMaterial) -> dict[str, float | None]:
    """The Ks share, mu and sigma of a material."""
    share = material.ks[_GREEN] / (material.kd[_GREEN] + material.ks[_GREEN])
    return {"Ks share": float(share), "mu": material.mu, "sigma": material.sigma}


def _findings(
    stage: Stage,
    found: Sequence[float | None],
    std: Mapping[str, float],
    quantities: Mapping[str, Quantity],
) -> dict[str, Finding]:
    findings = {}
    for (name, truth), value in zip(truths(stage.material).items(), found, strict=True):
        quantity = quantities.get(_KEYS[name])
        if value is None or truth is None or quantity is None:
            findings[name] = ABSENT
        else:
            findings[name] = Finding(value - truth, std[name], quantity.status)
    return findings


def expected(stage: Stage, keep: Callable[[LightField, Floats], Bools] | None = None) -> dict[str, Finding]:
    """What theory says of the same numbers beforehand: the bound of Cramer and Rao, and the status that follows.

    keep : which samples (n,) of a photograph are used, from the samples and their radiance (n, 3); None for all.
    """
    material = stage.material
    brdf = microfacet.Microfacet(material.kd, material.ks, material.mu, material.sigma)
    experiment = Experiment(
        name="atlas",
        body=SphereBody(SPHERE),
        centre=np.zeros(3),
        brdf=brdf,
        lights=(PlannedLight(stage.lighting, stage.known),),
        views=tuple(PlannedView(camera, 0) for camera in stage.cameras),
        sensor=NoisySensor(stage.noise),
    )
    bench = Bench(experiment, stage.l_max, _LOOKED_AT)
    told, fields = bench.nothing(0), []
    draws = [
        replace(draw, field=draw.field.through(stage.polariser(index)))
        for index, draw in enumerate(bench.draws(experiment.views))
    ]
    for view, drawn, seen in zip(experiment.views, draws, bench.shown(0, draws), strict=True):
        use = np.ones(len(drawn.field), bool) if keep is None else keep(drawn.field, seen.radiance)
        stands_for = stage.samples / stage.views / len(drawn.field)
        fields.append(drawn.field.where(use))
        some = Draw(fields[-1], stands_for)
        shown = seen.where(use)
        weights = bench.weights(some, shown, bench.brightness(view), 1.0)
        told += bench.information(0, some, shown, weights)
    posterior = Posterior([Marginal(bench.unknowns.lights[0], told, np.zeros((0, len(told.pull))))])
    degree = lighting_degree([stage.lighting])
    prospect = AskedBrdf.of(bench.unknowns, absolute=False).quantities(posterior, degree, fields)
    found = {one.name: one for one in prospect}
    return {
        name: Finding(None, float(found[key].noise_std[-1]), found[key].quantity.status)
        if key in found
        else ABSENT
        for name, key in _KEYS.items()
    }

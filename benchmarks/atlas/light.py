"""Boundaries of the light: sigma where light is soft, light where sigma is wide, sources close by or close together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.atlas.processed import processed
from benchmarks.atlas.stage import (
    AREA,
    SOURCE,
    SPHERE,
    TOLD,
    Finding,
    Stage,
    blind,
    blind_findings,
    expected,
    fitted,
    lit,
)
from benchmarks.atlas.sweep import Boundary
from invrender.brdf import microfacet
from invrender.estimate.identifiability import lighting_degree
from invrender.inverse_lighting.coefficients import DETERMINED, UNDETERMINED, estimate_coefficients
from invrender.theory.conditioning import Conditioning, inverse_filter
from invrender.theory.specialcases import microfacet_transfer
from invrender.transport.harmonic_rows import photo_rows
from recon.harmonics.basis import (
    clamped_cosine_transfer,
    degrees,
    evaluate_harmonics,
    sphere_directions,
)
from recon.mesh.tangents import tangents
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.materials.microfacet import MicrofacetMaterial

Floats = NDArray[np.float64]

# Light of one width under which roughness is swept: 99% of its varying power lies in degrees up to 6.
_SOFT = 0.35
# The highest degrees that are fitted aren't drawn: what lies beyond shows in them.
_SAMPLES_OF_LIGHT, _DEGREE, _DRAWN = 3000, 16, 12
# The light that is recovered ends below that degree: what lies above would count as noise.
_WHOLE = AreaLight(AREA.axis, AREA.radiance, 0.2)
# A posterior a tenth of the prior counts as determined.
_TENTH = 0.1
_GREEN = 1


def soft_light(width_rad: float) -> Stage:
    """Teflon in known light without sources, of a width."""
    return replace(TOLD, areas=(AreaLight(AREA.axis, AREA.radiance, width_rad),), sources=())


def rough_body(sigma: float) -> Stage:
    """As shiny as teflon and of another roughness, in unknown light of one width, without sources."""
    stage = Stage(sources=(), areas=(AreaLight(AREA.axis, AREA.radiance, _SOFT),))
    return replace(stage, material=replace(stage.material, sigma=sigma))


def _filtering(stage: Stage) -> float:
    """sigma times the degree of the light: at 1 the lobe begins to show [RH01, eq. 20]."""
    degree = lighting_degree([stage.lighting])
    return np.inf if degree is None else stage.material.sigma * degree


def soft_light_at(width_rad: float) -> float:
    return _filtering(soft_light(width_rad))


def rough_body_at(sigma: float) -> float:
    return _filtering(rough_body(sigma))


def soft_light_draw(width_rad: float, number: int) -> dict[str, Finding]:
    return _one_draw(soft_light(width_rad), number)


def soft_light_theory(width_rad: float) -> dict[str, Finding]:
    return expected(soft_light(width_rad))


def rough_body_draw(sigma: float, number: int) -> dict[str, Finding]:
    return _one_draw(rough_body(sigma), number)


def rough_body_theory(sigma: float) -> dict[str, Finding]:
    return expected(rough_body(sigma))


def _one_draw(stage: Stage, number: int) -> dict[str, Finding]:
    return fitted(stage, stage.drawn(number))


def shiny(sharpness: float) -> Stage:
    """A body that only shines, 1 / sigma being `sharpness`; at 0 it is matte instead."""
    white = np.full(3, 0.2)
    material = (
        MicrofacetMaterial(0 * white, white, None, 1 / sharpness)
        if sharpness
        else MicrofacetMaterial(white, 0 * white, None, 0.1)
    )
    return Stage(material=material, areas=(_WHOLE,), sources=(), samples=_SAMPLES_OF_LIGHT)


def degree_draw(sharpness: float, number: int) -> dict[str, Finding]:
    """Per degree, root mean squares of what is found of the light through a known BRDF, over its degree 0."""
    stage = shiny(sharpness)
    photos = stage.drawn(number)
    material = stage.material
    brdf = microfacet.Microfacet(
        material.kd, material.ks, None, material.sigma if material.ks.any() else None
    )
    found = estimate_coefficients([photo_rows(photo, brdf, _DEGREE) for photo in photos], brdf, _DEGREE)
    truth = true_coefficients(stage, _DEGREE)
    squares = [values[:, _GREEN] ** 2 / truth[0, _GREEN] ** 2 for values in (found.values - truth, found.std)]
    l = degrees(_DEGREE)
    error, std = (np.sqrt(np.bincount(l, square) / np.bincount(l)) for square in squares)
    shares = found.share_per_degree
    return {
        f"degree {k}": Finding(float(error[k]), float(std[k]), _status(float(shares[k])))
        for k in range(_DRAWN + 1)
    }


def degree_theory(sharpness: float) -> dict[str, Finding]:
    """Degrees that stand out of the noise of as many samples, evenly spread [R02, eq. 2.62]."""
    stage = shiny(sharpness)
    # Evenly spread samples of relative noise s leave s / sqrt(N) of degree 0's signal in each coefficient.
    noise = stage.relative / np.sqrt(stage.samples)
    gains = conditioning(sharpness)
    spread = gains.condition * noise
    known = gains.determined(noise / _TENTH)
    return {
        f"degree {k}": Finding(None, float(min(spread[k], 1.0)), "determined" if known[k] else "undetermined")
        for k in range(_DRAWN + 1)
    }


def conditioning(sharpness: float) -> Conditioning:
    """How well posed each degree of the light is, seen in a body that only shines, or in a matte one."""
    if not sharpness:
        return inverse_filter(clamped_cosine_transfer(_DEGREE))
    return inverse_filter(microfacet_transfer(1 / sharpness, _DEGREE))


def _status(share: float) -> str:
    return "determined" if share >= DETERMINED else "weak" if share >= UNDETERMINED else "undetermined"


def true_coefficients(stage: Stage, l_max: int) -> Floats:
    """Coefficients ((l_max + 1)^2, 3) of a stage's area lights, by equal solid angles."""
    grid = sphere_directions(40000)
    radiance = sum((area.radiance_from(grid) for area in stage.areas), np.zeros((len(grid), 3)))
    return np.asarray(4 * np.pi / len(grid) * evaluate_harmonics(grid, l_max).T @ radiance)


def two_sources(apart: float) -> Stage:
    """A second source, so many sigma beside the first, sharing its light."""
    stage = Stage()
    turn = Rotation.from_rotvec(apart * stage.material.sigma * tangents(SOURCE.direction)[0]).as_matrix()
    beside = DirectionalSource(turn @ SOURCE.direction, 0.4 * SOURCE.irradiance)
    first = DirectionalSource(SOURCE.direction, 0.6 * SOURCE.irradiance)
    return replace(stage, sources=(first, beside))


def two_sources_draw(apart: float, number: int) -> dict[str, Finding]:
    """As usual, and how far off the worse of both sources is, degrees: undetermined where one was found instead."""
    stage = two_sources(apart)
    solution = blind(stage, stage.drawn(number))
    ways = solution.light.sources.directions
    off, std = None, None
    if len(ways):
        cosines = np.array([ways @ source.direction for source in stage.sources])
        off = float(np.degrees(np.arccos(np.clip(cosines.max(axis=1), -1, 1)).max()))
        std = float(solution.light.sources.direction_std_deg.max())
    both = Finding(off, std, "determined" if len(ways) == 2 else "undetermined")
    return {**blind_findings(stage, solution), "sources": both}


def two_sources_theory(apart: float) -> dict[str, Finding]:
    return expected(two_sources(apart))


def near_lamp(nearness: float) -> PointSource:
    """A lamp towards the source whose 1/d is `nearness` times 2 k, k the sphere's curvature [RMB07, sec. 4.5].

    At the sphere's centre it is as bright as the source.
    """
    distance = SPHERE.radius / (2 * nearness)
    return PointSource(distance * SOURCE.direction, distance**2 * SOURCE.irradiance)


def near_known_draw(nearness: float, number: int) -> dict[str, Finding]:
    """As `process` has it: a lamp that one fit leaves too much of is sought nearer by, and all is fitted again."""
    return processed(TOLD, [near_lamp(nearness)], number)


def near_unknown_draw(nearness: float, number: int) -> dict[str, Finding]:
    stage, lamps = Stage(), [near_lamp(nearness)]
    photos = [lit(stage, field, field.normals, field.views, lamps) for field in stage.fields()]
    return fitted(stage, stage.noisy(photos, np.random.default_rng(number)))


def distant_known_theory(_: float) -> dict[str, Finding]:
    return expected(TOLD)


def distant_unknown_theory(_: float) -> dict[str, Finding]:
    return expected(Stage())


_BAND = "sigma times the degree that holds 99% of the light's varying power"
_NEARNESS = "1 / (2 k d), curvature k, distance d of the lamp"

SIGMA_KNOWN = Boundary(
    "sigma-known-light",
    "Roughness in known light: the softer the light, the less it shows",
    _BAND,
    (1.5, 1.0, 0.7, 0.5, 0.35, 0.25, 0.17, 0.1),
    (0, 6),
    soft_light_draw,
    soft_light_theory,
    "Left of 1 the lobe passes all that the light has, and only its slight loss tells of sigma.",
    edge=1.0,
    edge_label="sigma l = 1 [RH01, eq. 20]",
    at=soft_light_at,
    log=True,
)
SIGMA_UNKNOWN = Boundary(
    "sigma-unknown-light",
    "Roughness in unknown light without sources",
    _BAND,
    (0.05, 0.08, 0.12, 0.17, 0.25, 0.35),
    (0, 4),
    rough_body_draw,
    rough_body_theory,
    "Nobody tells what light the lobe has taken away: sigma stays open without a small source.",
    edge=1.0,
    edge_label="sigma l = 1 [RH01, eq. 20]",
    at=rough_body_at,
    log=True,
)
LIGHT_DEGREE = Boundary(
    "light-degree",
    "Light recovered through a known BRDF, degree by degree",
    "1 / sigma (0: a matte body)",
    (0.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0),
    (0, 5),
    degree_draw,
    degree_theory,
    "A lobe of width sigma passes degrees up to about 1 / sigma. Good photographs reach beyond: noise is low, and"
    " across grazing views the lobe is narrower than head-on, where theory has it.",
    quantities=tuple(f"degree {k}" for k in range(_DRAWN + 1)),
)
TWO_SOURCES = Boundary(
    "two-sources",
    "Two sources: told apart, or taken for one",
    "angle between the sources / sigma",
    (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0),
    (1, 5),
    two_sources_draw,
    two_sources_theory,
    "Nearer than the lobe is wide they count as one, and the bars of all else must hold what that costs.",
    edge=1.0,
    edge_label="as far apart as the lobe is wide",
    quantities=("Ks share", "mu", "sigma", "sources"),
)
NEAR_KNOWN = Boundary(
    "near-light-known",
    "A lamp near by that is told as distant",
    _NEARNESS,
    (0.003, 0.01, 0.03, 0.1, 0.2),
    (0, 4),
    near_known_draw,
    distant_known_theory,
    "`process` asks whether the lamp is near, and finds its distance with the rest. Then bars are little more than"
    " theory's for a lamp far away.",
    edge=1.0,
    edge_label="1/d = 2k [RMB07]",
    log=True,
)
NEAR_UNKNOWN = replace(
    NEAR_KNOWN,
    name="near-light-unknown",
    title="A lamp near by in unknown light",
    says="Its distance is found with all else: bars are little more than theory's for a lamp far away.",
    draw=near_unknown_draw,
    theory=distant_unknown_theory,
)

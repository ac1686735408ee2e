"""Where unknown light can't tell something, by theory: no number then, but why, and which photograph would help."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from invrender.estimate.unknown_light import factorize_blind
from recon.mesh.tangents import tangents
from recon.sampling.lightfield import LightField
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.render.lobes import reflected_radiance

TEFLON = radiometric(RH01_MATERIALS["teflon"])


def photographs(
    bench: SimpleNamespace,
    rng: np.random.Generator,
    material: MicrofacetMaterial = TEFLON,
    angles: Sequence[float] = (0, 45, 90, 135),
    lights: Sequence[AreaLight] = (),
    sources: Sequence[DirectionalSource] = (),
    least_cos: float = 0.0,
    samples: int = 400,
) -> list[LightField]:
    """Photographs of a sphere with 1% noise, of what is seen within an exitant angle only."""
    photos = []
    for angle in angles:
        field = bench.sphere_field(angle, samples, 90.0)
        field = field.where(field.cos_exitant > least_cos)
        clean = field.mean_over_rays(
            reflected_radiance(material, lights, sources, field.normals, field.views)
        )
        deviation = np.hypot(0.01 * clean, 0.001 * clean.mean())
        photos.append(replace(field, radiance=clean + deviation * rng.standard_normal(clean.shape)))
    return photos


def test_a_single_photograph_is_explained_by_any_light(bench: SimpleNamespace, rng: np.random.Generator):
    one = photographs(bench, rng, angles=[0], sources=[bench.source])
    with pytest.raises(
        ValueError, match=r"one can't separate light from reflectance .* add photographs from other"
    ):
        factorize_blind(one)


def test_light_without_high_degrees_hides_the_lobes_width(bench: SimpleNamespace, rng: np.random.Generator):
    soft = AreaLight(bench.area_light.axis, bench.area_light.radiance, width_rad=0.9)
    found = factorize_blind(photographs(bench, rng, lights=[soft]), orders=[6], ladder=False)
    sigma = found.quantities["sigma"]
    assert (sigma.status, sigma.value) == ("undetermined", None)
    assert "light's varying power lies in degrees up to" in sigma.reason
    assert sigma.remedy == "add a photograph under a small, bright source"


def test_without_grazing_views_mu_stays_open(bench: SimpleNamespace, rng: np.random.Generator):
    # Of each sphere the middle only: nothing is seen at more than 25 degrees.
    photos = photographs(
        bench,
        rng,
        angles=(-60, -20, 20, 60, 100),
        sources=[bench.source],
        lights=[bench.area_light],
        least_cos=np.cos(np.radians(25)),
        samples=600,
    )
    found = factorize_blind(photos, orders=[6], ladder=False)
    mu = found.quantities["mu"]
    assert (mu.status, mu.value) == ("undetermined", None)
    assert "samples reach 25 degrees" in mu.reason
    assert "grazing" in mu.remedy


def test_directions_that_no_reflection_reaches_are_said_to_be_open(
    bench: SimpleNamespace, rng: np.random.Generator
):
    # Close beside each other, and of each sphere the middle third: mirrored rays go to one side of the world only.
    photos = photographs(
        bench,
        rng,
        angles=(-8, 0, 8),
        lights=[bench.area_light],
        sources=[bench.source],
        least_cos=0.75,
        samples=600,
        material=radiometric(RH01_MATERIALS["steel"]),
    )
    found = factorize_blind(photos, orders=[6], ladder=False)
    doubt = found.light.doubt
    assert doubt is not None
    assert found.light.determined_degree == 2
    share = int(doubt.reason.split("mirrored rays look at ")[1].split("%")[0])
    # A cone of twice 41 degrees and the five by which it is widened is 48% of the sphere; between samples are gaps.
    assert 38 < share < 52
    assert doubt.remedy == "add photographs from more sides"


def test_two_sources_within_the_lobe_count_as_one(bench: SimpleNamespace, rng: np.random.Generator):
    sources = [
        DirectionalSource(bench.direction(azimuth, 25), np.array([1.2, 1.1, 1.0])) for azimuth in (-20, -16)
    ]
    photos = photographs(bench, rng, lights=[bench.area_light], sources=sources, samples=1000)
    found = factorize_blind(photos, orders=[8], ladder=False)
    (only,) = found.light.sources.directions
    assert only @ bench.direction(-18, 25) > np.cos(np.radians(1))
    # It is said to be where either of them is, not only where the one is that stands for both.
    (way,) = found.light.sources.direction_std_deg
    apart = [np.degrees(np.arccos(only @ source.direction)) for source in sources]
    assert max(apart) < 2 * way < 8
    assert "nearer to another than the lobe is wide" in found.warnings[0]
    assert "treated as one" in found.warnings[0]


def test_a_tenth_of_nonsense_among_the_samples_does_no_harm(bench: SimpleNamespace, rng: np.random.Generator):
    photos = photographs(bench, rng, lights=[bench.area_light], sources=[bench.source], samples=500)
    median = float(np.median([np.median(photo.radiance) for photo in photos]))
    spoilt = []
    for photo in photos:
        radiance = photo.radiance.copy()
        hit = rng.random(len(photo)) < 0.1
        # Of all brightnesses from a hundredth to a hundred times the object's, as dust and hot pixels have.
        radiance[hit] = median * 10 ** (
            rng.uniform(-2, 2, (hit.sum(), 1)) + rng.normal(0, 0.3, (hit.sum(), 3))
        )
        spoilt.append(replace(photo, radiance=radiance))
    found = factorize_blind(spoilt, orders=[8], ladder=False)
    truth = [*(TEFLON.ks / (TEFLON.kd + TEFLON.ks)), TEFLON.mu, TEFLON.sigma]
    std = np.sqrt(np.diag(found.covariance))[:5]
    off = np.array([*found.brdf_share, found.mu, found.sigma]) - truth
    # Five numbers, three of them much alike.
    assert (np.abs(off) < 3 * std).all()
    assert (std < [0.003, 0.003, 0.003, 0.03, 0.001]).all()


@pytest.mark.parametrize("angle", [20.0, pytest.param(200.0, marks=pytest.mark.sweep)])
@pytest.mark.parametrize(
    ("irradiance", "told"), [pytest.param(6.0, True, marks=pytest.mark.sweep), (1.0, False)]
)
def test_a_matte_object_shows_a_lamp_on_either_side_alike(
    bench: SimpleNamespace, rng: np.random.Generator, irradiance: float, told: bool, angle: float
):
    # A sky of radiance 1 has an irradiance of pi: light of its power makes up for a lamp's antipode only where the
    # lamp's is less than twice that.
    sky = AreaLight(np.array([0.0, 0.0, 1.0]), np.ones(3), width_rad=30.0)
    along = np.radians(angle)
    lamp = DirectionalSource(np.array([np.cos(along), np.sin(along), 0.4]), np.full(3, irradiance * np.pi))
    matte = MicrofacetMaterial(TEFLON.kd, 0 * TEFLON.ks, TEFLON.mu, TEFLON.sigma)
    angles = [0, 72, 144, 216, 288]
    found = factorize_blind(photographs(bench, rng, matte, angles, [sky], [lamp]), orders=[4])
    sources = found.light.sources
    # The likelier side is the true one: the rest of the light is even.
    off = np.degrees(np.arccos(np.clip(sources.directions[0] @ lamp.direction, -1, 1)))
    assert (len(sources.directions), off < 1) == (1, True)
    said = [warning for warning in found.warnings if "may as well be on the opposite side" in warning]
    if told:
        assert (sources.direction_std_deg[0] < 1, said) == (True, [])
    else:
        assert (sources.direction_std_deg[0] >= 180, len(said)) == (True, 1)
        # Where the lamp is, light of degree 1 isn't: at the antipode it would be twice the lamp's.
        assert (found.light.coefficients_std[1:4].max(axis=0) > 0.5 * sources.irradiances[0]).all()


@pytest.mark.parametrize(
    ("half_width", "sigma"),
    [
        pytest.param(0.08, 0.03, marks=pytest.mark.slow),
        pytest.param(0.08, 0.06, marks=pytest.mark.sweep),
        pytest.param(0.0, 0.03, marks=pytest.mark.sweep),
    ],
)
def test_a_window_is_told_from_a_lamp_and_sigma_is_doubted(
    bench: SimpleNamespace, rng: np.random.Generator, few_forms: None, half_width: float, sigma: float
):
    # A window of 9 degrees: lamps of no size, nearer to each other than the lobe is wide.
    steps = np.linspace(-half_width, half_width, 15) if half_width else np.zeros(1)
    across, along = tangents(bench.source.direction)
    irradiance = bench.source.irradiance / len(steps) ** 2
    window = [
        DirectionalSource(bench.source.direction + x * across + y * along, irradiance)
        for x in steps
        for y in steps
    ]
    material = replace(TEFLON, sigma=sigma)
    angles = (0, 36, 72, 108, 144, 180)
    photos = photographs(bench, rng, material, angles, [bench.area_light], window, samples=600)
    found = factorize_blind(photos, orders=[4, 8])
    told = found.quantities["sigma"]
    assert told.value is not None
    assert told.std is not None
    assert abs(told.value[0] - sigma) < 2.5 * told.std[0]
    warned = any("windows and lamps that are no points" in warning for warning in found.warnings)
    # Light as narrow as a point costs nothing.
    expected = ("weak", True) if half_width else ("determined", False)
    assert (told.status, warned) == expected
    assert half_width or told.std[0] < 0.01 * sigma

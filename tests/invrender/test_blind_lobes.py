"""Factorization under unknown light where the lobe is not RH01's, and by RH01's own coarser transfers."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.source_region import SourceRegion
from invrender.brdf.lobes import BECKMANN, GGX_FORM, PLASTICS
from invrender.estimate.unknown_light import factorize_blind, predict_blind
from invrender.estimate.unknown_light.start import NOTHING
from invrender.estimate.unknown_light.state import FIRST_MU
from invrender.transport.lobe_table import TRANSFERS
from recon.harmonics.basis import sphere_directions
from recon.sampling.lightfield import LightField
from synthetic.lights.arealight import AreaLight
from synthetic.materials import facets
from synthetic.materials.plastic import Plastic
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.materials.smith import SmithMaterial
from synthetic.render.lobes import reflected_radiance

from .anylobe import radiance_of
from .test_blind import NOISE, TEFLON, degrees_apart, noisy, photographs, share

PAINTED = radiometric(RH01_MATERIALS["painted"])
PLASTIC = Plastic(
    SmithMaterial(np.array([0.3, 0.25, 0.2]), np.full(3, 0.05), 1.5, facets.BeckmannSlopes(0.12, 0.12))
)


def _smith(field: LightField, bench: SimpleNamespace) -> np.ndarray:
    """What a half-angle twin of the painted sphere sends to a photograph."""
    material = SmithMaterial(
        PAINTED.kd, PAINTED.ks, PAINTED.mu, facets.BeckmannSlopes(PAINTED.sigma, PAINTED.sigma)
    )
    lights, sources = [bench.area_light], [bench.source]
    rays = radiance_of(material, PAINTED.sigma, lights, sources, field.normals, field.views)
    return field.mean_over_rays(rays)


def test_brute_force_of_any_lobe_is_that_of_the_renderer_for_its_own(bench: SimpleNamespace):
    field = bench.sphere_field(40.0, 60, 90.0)
    lights, sources = [bench.area_light], [bench.source]
    expected = reflected_radiance(PAINTED, lights, sources, field.normals, field.views)
    found = radiance_of(PAINTED, PAINTED.sigma, lights, sources, field.normals, field.views)
    assert_allclose(found, expected, rtol=1e-4)


@pytest.mark.slow
def test_the_ladder_tells_half_angle_lobes_from_rh01s(bench: SimpleNamespace, rng: np.random.Generator):
    angles = np.linspace(0, 177, 8)
    fields = [bench.sphere_field(angle, 200, 90.0) for angle in angles]
    photos = noisy([replace(field, radiance=_smith(field, bench)) for field in fields], rng)
    found = factorize_blind(photos, orders=[10])
    assert found.model == "half-angle microfacet, lighting of degree 10, 1 source"
    assert found.form is BECKMANN
    assert found.mu is not None
    assert found.sigma is not None
    assert degrees_apart(found.light.sources.directions[0], bench.source.direction) < 0.05
    std = np.sqrt(np.diag(found.covariance))
    error = [*(found.brdf_share - share(PAINTED)), found.mu - PAINTED.mu, found.sigma - PAINTED.sigma]
    # Five numbers, of which four agree by more than chance: all within 3 standard deviations.
    assert (np.abs(error) < 3 * std[:5]).all()
    # Error bars that say something: three per mille of a share, 0.005 of mu.
    assert (std[:5] < [0.003, 0.003, 0.003, 0.005, 0.001]).all()
    # What was tried instead is told, and predicts photographs that it has not seen far worse.
    tried = {candidate.name.split(",")[0]: candidate.error for candidate in found.candidates}
    assert {"microfacet", "GGX", "Phong"} <= tried.keys()
    assert (
        min(tried[name] for name in ("microfacet", "GGX", "Phong")) > 3 * found.candidates[found.chosen].error
    )
    unseen = bench.sphere_field(30.0, 500, 90.0, seed=5)
    expected = _smith(unseen, bench)
    error = predict_blind(found, unseen) - expected
    assert np.sqrt(np.mean(error**2)) < 0.5 * NOISE * np.sqrt(np.mean(expected**2))
    # RH01's form would answer with shares that are off by many of these error bars.
    as_printed = next(
        candidate.fit.state for candidate in found.candidates if candidate.name.startswith("microfacet,")
    )
    assert np.abs(as_printed.specular_share - share(PAINTED)).min() > 5 * std[:3].max()


def _of_plastic(field: LightField, bench: SimpleNamespace) -> np.ndarray:
    """What a plastic sphere sends to a photograph: its gloss, and its base by sums over all directions."""
    light, source, gloss = bench.area_light, bench.source, PLASTIC.gloss
    bare = replace(gloss, kd=np.zeros(3))
    rays = radiance_of(bare, 0.12, [light], [source], field.normals, field.views)
    base = replace(PLASTIC, gloss=replace(gloss, ks=np.zeros(3)))
    # The light is round: what comes in depends on the angle to its axis alone.
    up, angles, directions = _tilted(np.ones(1)), np.linspace(0, np.pi, 200), sphere_directions(20_000)
    axes = np.stack([np.sin(angles), np.zeros(200), np.cos(angles)], axis=-1)
    falling = base.lobe(directions, up) * np.maximum(directions[:, 2:], 0) * (4 * np.pi / len(directions))
    window = np.array([light.profile(directions @ axis) @ falling for axis in axes])
    angle = np.arccos(np.clip(field.normals @ light.axis, -1, 1))
    sent = np.stack([np.interp(angle, angles, window[:, c]) for c in range(3)], axis=-1) * light.radiance
    cos = np.clip(field.normals @ source.direction, 0, 1)
    sent += base.lobe(_tilted(cos), up) * cos[:, None] * source.irradiance
    out = base.lobe(up, _tilted((field.normals * field.views).sum(axis=1))) / base.lobe(up, up)
    return field.mean_over_rays(rays + sent * out)


def _tilted(cos: np.ndarray) -> np.ndarray:
    """Local directions (m, 3) at cosines to the normal."""
    return np.stack([np.sqrt(1 - cos**2), np.zeros_like(cos), cos], axis=-1)


@pytest.mark.sweep
def test_the_ladder_tells_a_base_under_an_interface(bench: SimpleNamespace, rng: np.random.Generator):
    fields = [bench.sphere_field(angle, 200, 90.0) for angle in np.linspace(0, 177, 6)]
    photos = noisy([replace(field, radiance=_of_plastic(field, bench)) for field in fields], rng)
    found = factorize_blind(photos, orders=[8, 10])
    assert found.form is PLASTICS[BECKMANN]
    assert found.mu is not None
    assert found.sigma is not None
    gloss, std = PLASTIC.gloss, np.sqrt(np.diag(found.covariance))
    error = [*(found.brdf_share - share(gloss)), found.mu - gloss.mu, found.sigma - 0.12]
    # Five numbers, of which four agree by more than chance: all within 3 standard deviations.
    assert (np.abs(error) < 3 * std[:5]).all()
    assert (std[:5] < [0.003, 0.003, 0.003, 0.005, 0.001]).all()
    # Over a Lambertian base each lobe explains a tenth at best; the other plastic's lobe is what gives it away.
    errors = {
        candidate.fit.state.form: candidate.error
        for candidate in found.candidates
        if candidate.fit.state.sigma is not None
    }
    best = found.candidates[found.chosen].error
    assert errors[BECKMANN] > 8 * best
    assert errors[GGX_FORM] > 8 * best
    assert errors[PLASTICS[GGX_FORM]] > 3 * best
    unseen = bench.sphere_field(30.0, 500, 90.0, seed=5)
    expected = _of_plastic(unseen, bench)
    error = predict_blind(found, unseen) - expected
    assert np.sqrt(np.mean(error**2)) < 0.5 * NOISE * np.sqrt(np.mean(expected**2))


def test_coarser_transfers_lose_specular_reflection(bench: SimpleNamespace):
    # Without noise or sources, and hardly any light beyond degree 7, so that few samples show what transfers leave out.
    light = AreaLight(bench.area_light.axis, bench.area_light.radiance, width_rad=0.5)
    photos = photographs(bench, TEFLON, 8, 1600, lights=[light], sources=[])
    elsewhere = SourceRegion(bench.direction(-70, -60), 0.1)
    exact, filtered, mirror = (
        factorize_blind(
            photos, orders=[7], ladder=False, source_regions={"light": elsewhere}, transfer=transfer
        )
        for transfer in TRANSFERS
    )
    off = [np.abs(found.brdf_share - share(TEFLON)).max() for found in (exact, filtered, mirror)]
    # Eq. 22 alone leaves out that the lobe blurs, eq. 20 that it grows at grazing angles.
    assert off[0] < 0.0002
    assert 0.003 < off[1] < off[2] < 0.012
    for found in (exact, filtered, mirror):
        # Each predicts by its own transfer: light that is seen blurred stays so.
        error = predict_blind(found, photos[3]) - photos[3].radiance
        assert np.sqrt(np.mean(error**2) / np.mean(photos[3].radiance ** 2)) < 0.005
    # A mirror shows nothing of its roughness.
    assert mirror.quantities["sigma"].status == "undetermined"


def test_transfers_that_are_none_are_refused(bench: SimpleNamespace):
    photos = photographs(bench, TEFLON, 2, 600, sources=[])
    with pytest.raises(ValueError, match="transfer is 'exakt'; it must be one of exact, filtered, mirror"):
        factorize_blind(photos, transfer="exakt")  # type: ignore[arg-type]


def test_an_interface_starts_from_an_index_of_its_own() -> None:
    """From an index of 2.3 without one a search for a plastic of 1.35 ended at 4: it left twice what it should."""
    bare = replace(NOTHING, specular_share=np.full(3, 0.2), mu=2.3, sigma=0.26)
    plastic = bare.with_form(PLASTICS[BECKMANN])
    assert plastic.mu == FIRST_MU
    # From one to another it is the same number.
    assert replace(plastic, mu=1.35).with_form(PLASTICS[GGX_FORM]).mu == 1.35

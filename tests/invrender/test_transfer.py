"""What light of each kind sends through the BRDF, against integrals over the directions it comes from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import Lighting, latlong_directions, latlong_solid_angles, read_latlong
from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.transport.half_vectors import PreparedMap
from invrender.transport.transfer import (
    LightElement,
    diffuse_transfer,
    light_elements,
    map_transfer,
    specular_transfer,
    split_map,
)
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.render.lobes import irradiance, reflected_radiance

SOFT = AreaLight(np.array([-0.2, 0.8, 0.6]), np.array([1.0, 2.0, 3.0]), 0.35)
# exp((cos - 1) / 1e12) is 1 to rounding.
UNIFORM = AreaLight(np.array([0.2, 0.3, 0.9]), np.ones(3), 1e6)
AMBIENT = LightElement("ambient", np.zeros((0, 3)), np.zeros((0, 1)), uniform=1.0)


def mirror_lobe(sigma: float) -> MicrofacetMaterial:
    """Specular only, no Fresnel, Ks = 1: its reflected radiance is the specular transfer."""
    return MicrofacetMaterial(np.zeros(3), np.ones(3), None, sigma)


def surface_points(rng: np.random.Generator, cos_o: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals and views (n, 3) all over the sphere of directions, at the given exitant cosines."""
    views = rng.normal(size=(len(cos_o), 3))
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    tangent = np.cross(views, rng.normal(size=views.shape))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return cos_o[:, None] * views + np.sqrt(1 - cos_o[:, None] ** 2) * tangent, views


def test_a_source_is_the_brdf_times_irradiance(rng):
    normals, views = surface_points(rng, rng.uniform(0.1, 1, 4000))
    directions = np.array([[0.6, 0.0, 0.8], [0.0, -0.8, -0.6]])
    irradiances = rng.random((2, 3)) + 0.5
    element = LightElement("known", directions, irradiances)
    cos_i = normals @ directions.T
    assert (cos_i < 0).any()
    for sigma in (0.05, 0.3):
        found = specular_transfer(element, normals, views, np.array([sigma]))[:, 0]
        sources = [DirectionalSource(*pair) for pair in zip(directions, irradiances, strict=True)]
        expected = reflected_radiance(mirror_lobe(sigma), [], sources, normals, views)
        # Rounding of arccos near theta_h = 0: 1e-8 rad.
        assert_allclose(found, expected, rtol=1e-6, atol=1e-8 * expected.max(), equal_nan=False)
    # Seen from the light's own side at 60 degrees, by hand: theta_h = 0, S / (4 cos_o) = 1 / (0.02 pi).
    side = np.sqrt(3) / 2
    one = LightElement("known", np.array([[side, 0, 0.5]]), np.ones((1, 1)))
    peak = specular_transfer(one, np.array([[0, 0, 1.0]]), np.array([[-side, 0, 0.5]]), np.array([0.1]))
    assert_allclose(peak, [[[1 / (0.02 * np.pi)]]], rtol=1e-12)
    expected = np.maximum(cos_i, 0) @ irradiances
    assert_allclose(diffuse_transfer(element, normals), expected, rtol=1e-12, atol=1e-15)


# Of the brightest: half-vector rings that the horizon cuts cost the wide lobes, the map's pixels (0.025 rad,
# looked up by cubics) the narrow ones.
@pytest.mark.parametrize(
    ("sigma", "worst", "rms"),
    [(0.02, 1e-3, 6e-4), (0.05, 1e-3, 5e-4), (0.12, 2e-3, 1e-3), (0.3, 5e-3, 2.5e-3), (0.7, 1e-2, 7e-3)],
)
def test_a_smooth_map_is_the_integral_over_incident_directions(sigma: float, worst: float, rms: float, rng):
    # All exitant angles that a fit uses, the most grazing and the normal view themselves.
    normals, views = surface_points(rng, np.linspace(0.15, 1, 400))
    expected = reflected_radiance(mirror_lobe(sigma), [SOFT], [], normals, views, order=40)
    found = map_transfer(PreparedMap.of(latlong_map([SOFT], 128)), normals, views, np.array([sigma]))[:, 0]
    assert np.abs(found - expected).max() < worst * SOFT.radiance.max()
    assert np.sqrt(((found - expected) ** 2).mean()) < rms * np.sqrt((expected**2).mean())


def test_diffuse_part_of_a_map_is_its_irradiance(rng):
    normals, _ = surface_points(rng, np.ones(300))
    element = LightElement("known", np.zeros((0, 3)), np.zeros((0, 3)), latlong_map([SOFT], 64))
    expected = irradiance(SOFT, normals)[:, None] * SOFT.radiance
    found = diffuse_transfer(element, normals)
    # The map's pixels: 0.1%.
    assert_allclose(found, expected, atol=1e-3 * expected[:, 2].max(), equal_nan=False)


@pytest.mark.parametrize("sigma", [SIGMA_RANGE[0], 0.12, 0.3, SIGMA_RANGE[1]])
def test_uniform_light_is_a_map_of_ones_and_the_integral(sigma: float, rng):
    # Just inside of an outline the lobe sends most, and a table must say how much.
    grazing = [0.01, 0.02, 0.05] if sigma > 0.01 else []
    normals, views = surface_points(rng, np.concatenate([grazing, np.linspace(0.15, 1, 200 - len(grazing))]))
    expected = reflected_radiance(mirror_lobe(sigma), [UNIFORM], [], normals, views, order=40)[:, :1]
    ones = LightElement("known", np.zeros((0, 3)), np.zeros((0, 1)), np.ones((64, 128, 1), np.float32))
    for element in (AMBIENT, ones):
        found = specular_transfer(element, normals, views, np.array([sigma]))[:, 0]
        # Rings cut by the horizon, as above.
        tolerance = 6e-3 if sigma < 0.5 else 1e-2
        assert_allclose(found, expected, rtol=tolerance, equal_nan=False)
    assert_allclose(diffuse_transfer(AMBIENT, normals), np.full((200, 1), np.pi), rtol=1e-12)
    assert_allclose(diffuse_transfer(ones, normals), np.full((200, 1), np.pi), rtol=1e-3)


@pytest.mark.parametrize(("row", "column"), [(0, 5), (20, 0), (20, 127), (40, 64), (63, 100)])
def test_a_hot_pixel_is_split_off_and_the_light_is_kept(row: int, column: int, rng):
    height = 64
    radiance = rng.uniform(0.5, 1.0, (height, 2 * height, 3)).astype(np.float32)
    radiance[row, column] = [3000.0, 2000.0, 4000.0]
    slow, directions, irradiances = split_map(radiance)
    assert_allclose(directions, [latlong_directions(height)[row, column]], rtol=1e-12, atol=1e-15)
    solid_angle = latlong_solid_angles(height)
    # What the neighbourhood, 0.5 to 1, would have sent from there stays in the map.
    below = solid_angle[row] * radiance[row, column] - irradiances[0]
    assert ((below > 0.5 * solid_angle[row]) & (below < 1.0 * solid_angle[row])).all()
    total = (slow * solid_angle[:, :, None]).sum(axis=(0, 1)) + irradiances.sum(axis=0)
    assert_allclose(total, (radiance.astype(float) * solid_angle[:, :, None]).sum(axis=(0, 1)), rtol=1e-5)
    changed = (slow != radiance).any(axis=2)
    assert changed[row, column]
    assert changed.sum() == 1


def test_a_smooth_map_has_no_sources():
    slow, directions, _ = split_map(latlong_map([SOFT], 64))
    assert directions.shape == (0, 3)
    assert_allclose(slow, latlong_map([SOFT], 64), rtol=0)


# Lamps, windows, and 250 rows, which don't halve evenly. What is left is the windows' edges between the nodes of rings.
@pytest.mark.parametrize(("sigma", "rms"), [(0.1, 0.015), (0.2, 0.012), (0.3, 0.02)])
def test_a_real_room_is_the_sum_over_its_pixels(
    sigma: float, rms: float, data_dir: Path, rng: np.random.Generator
):
    room = read_latlong(data_dir / "probes" / "Grace_Cathedral.hdr")
    normals, views = surface_points(rng, rng.uniform(0.25, 1, 75))
    (element,) = light_elements(Lighting("room", room, np.zeros((0, 3)), np.zeros((0, 3))))
    found = specular_transfer(element, normals, views, np.array([sigma]))[:, 0]
    directions = latlong_directions(len(room)).reshape(-1, 3)
    flux = (room.astype(float) * latlong_solid_angles(len(room))[:, :, None]).reshape(-1, 3)
    expected = np.empty_like(found)
    for k, (normal, view) in enumerate(zip(normals, views, strict=True)):
        lit = directions @ normal > 0
        half = directions[lit] + view
        angle = np.arccos(np.clip(half @ normal / np.linalg.norm(half, axis=1), -1, 1))
        lobe = np.exp(-((angle / sigma) ** 2)) / (np.pi * sigma**2)
        expected[k] = lobe @ flux[lit] / (4 * normal @ view)
    assert np.sqrt(((found - expected) ** 2).mean() / (expected**2).mean()) < rms


@pytest.mark.parametrize("size", [1, 2])
def test_a_tiny_bright_spot_is_a_source(size: int, rng):
    height = 128
    spot = np.zeros((height, 2 * height, 3), np.float32)
    spot[45 : 45 + size, 100 : 100 + size] = np.array([1.0, 2.0, 4.0]) * 2000 / size**2
    flux = spot * latlong_solid_angles(height)[:, :, None]
    towards = (flux[..., 0, None] * latlong_directions(height)).sum(axis=(0, 1))
    source = LightElement("s", towards[None] / np.linalg.norm(towards), flux.sum(axis=(0, 1))[None])
    base = latlong_map([SOFT], height)
    (known,) = light_elements(Lighting("room", base + spot, np.zeros((0, 3)), np.zeros((0, 3))))
    (soft,) = light_elements(Lighting("room", base, np.zeros((0, 3)), np.zeros((0, 3))))

    # Views whose half vector with the source is near the normal: the highlight itself.
    normals, views = surface_points(rng, rng.uniform(0.5, 1, 30000))
    half = views + source.directions
    cos_half = (half * normals).sum(axis=1) / np.linalg.norm(half, axis=1)
    bright = (cos_half > np.cos(0.1)) & (normals @ source.directions[0] > 0.1)
    normals, views = normals[bright], views[bright]
    assert len(normals) > 50
    sigma = np.array([0.15])
    expected = sum(specular_transfer(part, normals, views, sigma) for part in (source, soft))
    found = specular_transfer(known, normals, views, sigma)
    # Two pixels lie 0.012 rad to either side, half vectors up to as much: (0.012 / sigma)^2 and twice that for
    # two axes is the blur at the peak. One pixel is a point: what is left is the slow light at its place, levelled.
    tolerance = {1: 5e-5, 2: 1.3e-2}[size]
    assert np.abs(found / expected - 1).max() < tolerance
    scale = diffuse_transfer(source, normals).max(axis=0)
    lambert = diffuse_transfer(known, normals) - diffuse_transfer(soft, normals)
    assert (np.abs(lambert - diffuse_transfer(source, normals)) / scale).max() < 1e-3


@pytest.mark.parametrize("axis_turns", [1, 2])
def test_turning_everything_changes_nothing(axis_turns: int, rng):
    height = 64
    radiance = latlong_map([SOFT], height)
    direction = np.array([0.48, -0.6, 0.64])
    turn = np.linalg.matrix_power(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), axis_turns)
    normals, views = surface_points(rng, np.linspace(0.15, 1, 300))
    # From +X towards +Y: a quarter of a turn is a quarter of the columns onwards.
    turned_map = np.roll(radiance, axis_turns * height // 2, axis=1)
    before = LightElement("known", direction[None], np.ones((1, 3)), radiance)
    after = LightElement("known", (turn @ direction)[None], np.ones((1, 3)), turned_map)
    sigmas = np.array([0.05, 0.2])
    found = specular_transfer(after, normals @ turn.T, views @ turn.T, sigmas)
    expected = specular_transfer(before, normals, views, sigmas)
    # The rings' frames don't all turn along (their helper axis is fixed): quadrature noise, as above.
    assert_allclose(found, expected, atol=4e-3 * SOFT.radiance.max(), equal_nan=False)
    diffuse = diffuse_transfer(after, normals @ turn.T)
    assert_allclose(diffuse, diffuse_transfer(before, normals), rtol=1e-10)


def test_elements_name_what_is_known_and_what_is_not(bench):
    for recover, names in [
        ({}, ["known"]),
        ({"recover_irradiance": True}, ["known", "source 1"]),
        ({"recover_irradiance": True, "recover_ambient": True}, ["source 1", "ambient"]),
        ({"recover_ambient": True}, ["known", "ambient"]),
    ]:
        elements = light_elements(bench.known_lighting(**recover))
        assert [element.name for element in elements] == names
    # A recovered source has unit irradiance per unit strength; a recovered ambient replaces the map.
    source, ambient = light_elements(bench.known_lighting(recover_irradiance=True, recover_ambient=True))
    facing = bench.source.direction[None]
    assert_allclose(diffuse_transfer(source, facing), [[1.0]], rtol=1e-12)
    assert_allclose(diffuse_transfer(ambient, facing), [[np.pi]], rtol=1e-12)

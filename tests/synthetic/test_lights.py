"""Lights: what they give against closed forms, and that they propose directions as they say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from capture.lighting import latlong_directions, latlong_solid_angles
from synthetic.lights.arealight import AreaLight
from synthetic.lights.disc import DiscLight
from synthetic.lights.illumination import Illumination, latlong_map
from synthetic.lights.latlong import LatLongLight
from synthetic.lights.light import ExtendedLight
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.lights.values import about_axis

Floats = NDArray[np.float64]

AXIS = np.array([0.36, -0.48, 0.8])
COLOUR = np.array([1.0, 2.0, 3.0])
TURN = Rotation.from_rotvec([0.4, -0.9, 1.3]).as_matrix()
ANOTHER_TURN = Rotation.from_rotvec([-1.1, 0.2, 0.6]).as_matrix()


def chequered(height: int) -> Floats:
    """A map of random colours, a third of it black."""
    rng = np.random.default_rng(11)
    pixels = rng.uniform(0, 3, (height, 2 * height, 3)) ** 2
    return pixels * (rng.random((height, 2 * height, 1)) > 1 / 3)


# Each with an axis, and the angle from it within which most of its light is.
LIGHTS: dict[str, tuple[ExtendedLight, Floats, float]] = {
    "narrow": (AreaLight(AXIS, COLOUR, 0.05), AXIS, 0.2),
    "wide": (AreaLight(-AXIS, COLOUR, 1.5), -AXIS, np.pi),
    "uniform": (AreaLight(AXIS, COLOUR, 1e6), AXIS, np.pi),
    "sun": (DiscLight(AXIS, COLOUR, 0.0047), AXIS, 0.0047),
    "sky": (DiscLight(-AXIS, COLOUR, 1.4), -AXIS, 1.4),
    "map": (LatLongLight(chequered(6)), np.array([0, 0, 1.0]), np.pi),
    "turned map": (LatLongLight(chequered(6), TURN), TURN[:, 2], np.pi),
}
ALL = pytest.mark.parametrize("name", LIGHTS)


def directions(rng: np.random.Generator, count: int) -> Floats:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def even_grid(count: int) -> Floats:
    """Midpoints (count^2, 2) of the unit square."""
    share = (np.arange(count) + 0.5) / count
    return np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)


def cells(axis: Floats, reach: float, rings: int, sectors: int, fine: int) -> tuple[Floats, Floats]:
    """Directions (rings * sectors, fine^2, 3) in cells about an axis, up to an angle, and the cells' solid angle."""
    # 1 - cos without cancellation, for small lights.
    versine = 2 * np.sin(reach / 2) ** 2
    share = (np.arange(rings * fine) + 0.5) / (rings * fine)
    phi = 2 * np.pi * (np.arange(sectors * fine) + 0.5) / (sectors * fine)
    grid = about_axis(axis, *np.broadcast_arrays(versine * share[:, None], phi))
    grid = grid.reshape(rings, fine, sectors, fine, 3).swapaxes(1, 2).reshape(rings * sectors, fine**2, 3)
    return grid, np.array(2 * np.pi * versine / (rings * sectors))


@ALL
def test_samples_are_as_dense_as_the_density_says(name: str, rng: np.random.Generator) -> None:
    light, axis, reach = LIGHTS[name]
    rings, sectors, count = 12, 12, 100_000
    grid, solid_angle = cells(axis, reach, rings, sectors, 24)
    expected = light.density(grid).mean(axis=1) * solid_angle
    # What lies beyond the reach: of a Gaussian light at four widths, exp(-8). Pixels' edges cross the cells: 1e-3.
    assert_allclose(expected.sum(), 1, atol=1e-3)
    samples = light.sample(rng.random((count, 2)))
    assert_allclose(np.linalg.norm(samples, axis=1), 1, rtol=1e-12)  # rounding
    # A frame of its own: chord for angle, since the smallest light is 5e-3 rad wide.
    first = about_axis(axis, np.ones(1), np.zeros(1))[0]
    second = np.cross(axis, first)
    ring = ((samples - axis) ** 2).sum(axis=1) / (2 * np.sin(reach / 2)) ** 2 * rings
    sector = np.arctan2(samples @ second, samples @ first) / (2 * np.pi) % 1 * sectors
    # Rounding may take a sample just beyond the edge of a disc.
    inside = ring < rings * (1 + 1e-9)
    place = np.minimum(ring[inside].astype(int), rings - 1) * sectors + sector[inside].astype(int)
    counts = np.bincount(place, minlength=rings * sectors)
    enough = expected * count > 10
    assert counts[~enough].sum() <= 5 + 2 * expected[~enough].sum() * count
    statistic = ((counts - expected * count)[enough] ** 2 / (expected[enough] * count)).sum()
    assert statistic < chi2.isf(1e-4, enough.sum())  # one seed in ten thousand exceeds it by chance


@ALL
def test_every_direction_that_light_comes_from_is_proposed(name: str, rng: np.random.Generator) -> None:
    light, *_ = LIGHTS[name]
    towards = np.concatenate([directions(rng, 20_000), light.sample(rng.random((20_000, 2)))])
    radiance, density = light.radiance_from(towards), light.density(towards)
    assert radiance.shape == (40_000, 3)
    assert radiance.any()
    assert (density[radiance.any(axis=1)] > 0).all()
    # Density follows radiance: no sample weighs much more than the mean one, which is the light's power.
    power = (radiance.sum(axis=1) / np.where(density > 0, density, np.inf))[20_000:]
    assert power.max() < 3 * power.mean()


@ALL
def test_single_precision_stays_and_is_good_to_its_digits(name: str, rng: np.random.Generator) -> None:
    light, *_ = LIGHTS[name]
    u = rng.random((5000, 2)).astype(np.float32)
    samples = light.sample(u)
    assert samples.dtype == np.float32
    assert_allclose(
        samples, light.sample(u.astype(float)), atol=1e-5
    )  # roundings of 6e-8, times 20 in far tails
    for function in (light.radiance_from, light.density):
        single, double = function(samples), function(samples.astype(float))
        assert single.dtype == np.float32
        # Where the light ends at an edge, a rounding decides between all and nothing: 1e-3 of the narrowest disc.
        same = np.isclose(single, double, rtol=1e-3, atol=1e-3 * double.max())
        assert same.mean() > 0.999


@ALL
def test_turning_a_light_turns_the_directions_it_comes_from(name: str, rng: np.random.Generator) -> None:
    light, *_ = LIGHTS[name]
    towards = np.concatenate([directions(rng, 1000), light.sample(rng.random((1000, 2)))])
    turned = light.turned(ANOTHER_TURN)
    # Rounding, times the 1 / width^2 of the narrow light.
    assert_allclose(turned.radiance_from(towards @ ANOTHER_TURN.T), light.radiance_from(towards), atol=1e-9)
    assert_allclose(turned.density(towards @ ANOTHER_TURN.T), light.density(towards), rtol=1e-9)


def flux(light: ExtendedLight, count: int = 400) -> Floats:
    """The integral of radiance times direction (3, channels), by the light's own proposals."""
    towards = light.sample(even_grid(count))
    return towards.T @ (light.radiance_from(towards) / light.density(towards)[:, None]) / len(towards)


@pytest.mark.parametrize("radius", [1e-4, 0.0047, 0.3, 1.5])
def test_a_disc_gives_the_irradiance_that_it_is_told_whatever_the_plane(radius: float) -> None:
    # By symmetry the flux is along the axis; a plane that sees all of the disc gets its projection.
    disc = DiscLight(3 * AXIS, COLOUR, radius)
    assert_allclose(
        flux(disc), np.outer(AXIS, COLOUR), atol=2e-5
    )  # midpoints in the square of the sine: 1 / 400^2


@pytest.mark.parametrize("width", [0.05, 0.35, 1.5, 20.0])
def test_an_area_light_gives_the_flux_of_its_formula(width: float) -> None:
    # The integral of c exp((c - 1) / w^2) over the sphere.
    tail, w2 = np.exp(-2 / width**2), width**2
    closed = 2 * np.pi * (w2 * (1 + tail) - w2**2 * (1 - tail))
    # Midpoints in the cumulated profile: 1e-4 where its far side is cut into 400; the closed form cancels at w = 20.
    assert_allclose(flux(AreaLight(AXIS, COLOUR, width)), np.outer(AXIS, COLOUR) * closed, atol=3e-4 * np.pi)


def test_a_constant_map_is_uniform_light(rng: np.random.Generator) -> None:
    light = LatLongLight(np.broadcast_to(COLOUR, (5, 10, 3)), TURN)
    poles = np.concatenate([directions(rng, 1000), np.eye(3), -np.eye(3), TURN.T, -TURN.T])
    assert_allclose(light.radiance_from(poles), np.tile(COLOUR, (len(poles), 1)), rtol=1e-12)  # rounding
    assert_allclose(light.density(poles), 1 / (4 * np.pi), rtol=1e-12)  # rounding


def test_a_map_is_linear_between_the_centres_of_its_pixels() -> None:
    height, pixels = 6, chequered(6)
    light = LatLongLight(pixels)
    assert_allclose(light.radiance_from(latlong_directions(height)), pixels, atol=1e-12)  # rounding
    theta = np.pi / height * np.array([2.5, 2.75, 3.5])
    phi = np.pi / height * np.array([4.0, 4.5, 0.25])  # the last across the seam, a quarter pixel after it
    towards = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    expected = [
        (pixels[2, 3] + pixels[2, 4]) / 2,
        pixels[2, 4] * 0.75 + pixels[3, 4] * 0.25,
        pixels[3, -1] * 0.25 + pixels[3, 0] * 0.75,
    ]
    assert_allclose(light.radiance_from(towards), expected, rtol=1e-12)  # rounding
    # Beyond the first and last centres there is no further row: up to the pole the same.
    near_pole = np.array([[np.sin(0.1) * np.cos(phi[1]), np.sin(0.1) * np.sin(phi[1]), np.cos(0.1)]])
    assert_allclose(light.radiance_from(near_pole), pixels[:1, 4], rtol=1e-12)  # rounding


def test_the_smallest_map_works() -> None:
    light = LatLongLight(np.array([[[1.0, 0, 0], [0, 1.0, 0]]]))
    assert_allclose(
        light.radiance_from(np.array([[0, 1.0, 0], [0, -1.0, 0]])), [[1, 0, 0], [0, 1, 0]], atol=1e-12
    )


def test_lamps_fall_off_with_the_square_of_the_distance_and_distant_sources_do_not(
    rng: np.random.Generator,
) -> None:
    lamp = PointSource(np.array([0.1, 0.2, 0.3]), COLOUR)
    ways, distances = directions(rng, 50), rng.uniform(0.01, 10, 50)
    towards, found, irradiance = lamp.at(lamp.position - distances[:, None] * ways)
    assert_allclose(towards, ways, atol=1e-13)  # rounding
    assert_allclose(found, distances, rtol=1e-12)  # rounding
    assert_allclose(irradiance * distances[:, None] ** 2, np.tile(COLOUR, (50, 1)), rtol=1e-12)  # rounding
    distant = DirectionalSource(5 * AXIS, COLOUR)
    towards, found, irradiance = distant.at(ways)
    assert_allclose(towards, np.tile(AXIS, (50, 1)), rtol=1e-15)
    assert np.isinf(found).all()
    assert_array_equal(irradiance, np.tile(COLOUR, (50, 1)))


def test_turning_an_illumination_turns_all_of_it(rng: np.random.Generator) -> None:
    lamp, distant = PointSource(np.array([0.1, 0.2, 0.3]), COLOUR), DirectionalSource(AXIS, COLOUR)
    lights = tuple(light for light, *_ in LIGHTS.values())
    light = Illumination("lab", lights, (lamp, distant), "nothing")
    turned = light.turned(TURN, "lab-001")
    assert (turned.name, turned.given) == ("lab-001", "nothing")
    points, towards = rng.normal(size=(20, 3)), directions(rng, 500)
    for before, after in zip(light.sources, turned.sources, strict=True):
        ways, distances, irradiance = before.at(points)
        ways_after, distances_after, irradiance_after = after.at(points @ TURN.T)
        assert_allclose(ways_after, ways @ TURN.T, atol=1e-13)  # rounding
        assert_allclose(distances_after, distances, rtol=1e-12)
        assert_allclose(irradiance_after, irradiance, rtol=1e-12)
    radiance = light.radiance_from(towards)
    assert_allclose(radiance, sum(one.radiance_from(towards) for one in lights), rtol=1e-12)  # rounding
    assert_allclose(
        turned.radiance_from(towards @ TURN.T), radiance, rtol=1e-9
    )  # rounding over narrow widths


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), AXIS, -AXIS, np.full(3, -(3**-0.5))])
def test_directions_about_an_axis_keep_their_angle_and_go_all_round(axis: Floats) -> None:
    cosine, azimuth = np.meshgrid(np.linspace(-1, 1, 9), np.arange(8) * np.pi / 4, indexing="ij")
    around = about_axis(axis, 1 - cosine, azimuth)
    assert_allclose(np.linalg.norm(around, axis=-1), 1, rtol=1e-12)  # rounding
    assert_allclose(around @ axis, cosine, atol=1e-12)  # rounding
    # Eighths of a turn, counter-clockwise seen from the tip.
    steps = np.cross(around[4], np.roll(around[4], -1, axis=0)) @ axis
    assert_allclose(steps, np.sin(np.pi / 4), rtol=1e-12)  # rounding


@pytest.mark.parametrize("radius_deg", [0.01, 0.1, 0.27, 1.5, 5.0, 6.0, 30.0, 80.0])
@pytest.mark.parametrize("towards", [AXIS, np.array([0.02, 0.01, 1]), np.array([-1, 1e-3, -0.2])])
def test_a_map_holds_all_of_a_disc_however_small(radius_deg: float, towards: Floats) -> None:
    height = 128
    disc = DiscLight(towards, COLOUR, np.radians(radius_deg))
    flux = (latlong_solid_angles(height)[..., None] * latlong_directions(height)).reshape(-1, 3)
    flux = flux.T @ latlong_map([disc], height).reshape(-1, 3)
    # Whole to 2%: subsamples of 0.47 degrees at the edge; in its place to half a pixel, 0.7 degrees.
    assert_allclose(np.linalg.norm(flux, axis=0), COLOUR, rtol=0.02)
    assert_allclose(flux / np.linalg.norm(flux, axis=0), np.tile(disc.direction[:, None], 3), atol=0.0125)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DiscLight(AXIS, COLOUR, 0.0), r"radius of a disc is 0\.0 rad; it must lie between"),
        (lambda: DiscLight(AXIS, COLOUR, np.pi / 2), "between 0 and pi / 2"),
        (lambda: DiscLight(AXIS, -COLOUR, 0.1), r"irradiance of a disc is \[-1\.0, -2\.0, -3\.0\]"),
        (lambda: DiscLight(np.zeros(3), COLOUR, 0.1), "direction of a disc is"),
        (lambda: AreaLight(np.array([1.0, np.nan, 0]), COLOUR, 0.1), "axis of an area light is"),
        (lambda: AreaLight(AXIS, np.ones(4), 0.1), "radiance of an area light is"),
        (lambda: AreaLight(AXIS, COLOUR, np.nan), "width of an area light is nan rad"),
        (lambda: PointSource(np.array([0, 0, np.inf]), COLOUR), "position of a lamp is"),
        (lambda: PointSource(AXIS, np.array([0, 0, np.nan])), "intensity of a lamp is"),
        (lambda: DirectionalSource(AXIS, np.ones(1)), r"irradiance of a source is \[1\.0\]"),
        (lambda: LatLongLight(np.ones((4, 6, 3))), r"a lat-long map is \(4, 6, 3\); it must be \(h, 2h, 3\)"),
        (lambda: LatLongLight(-np.ones((4, 8, 3))), r"holds values from -1\.0 to -1\.0"),
        (lambda: LatLongLight(np.zeros((4, 8, 3))), "black all over"),
        (lambda: Illumination("night"), "lighting 'night' has no light"),
    ],
)
def test_nonsense_is_refused_by_name_and_value(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("height", [32, 250, 512])
def test_a_suns_power_is_whole_in_the_written_map_however_fine_the_map_it_comes_from(height: int) -> None:
    pixels = np.zeros((height, 2 * height, 3))
    row, column = height // 3, height // 2 + 1
    pixels[row, column] = 3 / latlong_solid_angles(height)[row, 0]
    written = latlong_map([LatLongLight(pixels)], 64)
    power = (written * latlong_solid_angles(64)[..., None]).sum(axis=(0, 1))
    # Bilinear between pixels whose solid angles differ by their rows': 1% at 32 rows, less at more.
    assert_allclose(power, 3, rtol=0.01)


@pytest.mark.parametrize("width", [0.001, 0.01, 0.03])
def test_narrow_area_lights_lose_nothing_in_the_written_map(width: float) -> None:
    light = AreaLight(np.array([0.3, -0.5, 0.8]), np.ones(3), width)
    power = (latlong_map([light], 64) * latlong_solid_angles(64)[..., None]).sum(axis=(0, 1))
    # 2 pi w^2, by 3x3 midpoints per pixel where the light is wider than one.
    assert_allclose(power, 2 * np.pi * width**2, rtol=0.05)

"""Direct light: white furnaces, closed forms, shadows, and other quadratures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from recon.mesh.trianglemesh import TriangleMesh, smooth_normals
from synthetic.lights.arealight import AreaLight
from synthetic.lights.disc import DiscLight
from synthetic.lights.illumination import Illumination
from synthetic.lights.latlong import LatLongLight
from synthetic.lights.light import ExtendedLight
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.materials.energy import directional_albedo
from synthetic.materials.facets import BeckmannSlopes, GGXSlopes
from synthetic.materials.fresnel import fresnel_dielectric
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.material import Material
from synthetic.materials.mirror import Mirror
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.materials.smith import SmithMaterial
from synthetic.render.gather import direct_light
from synthetic.render.lattice import dealt, lattice
from synthetic.render.lobes import irradiance as quadrature_irradiance
from synthetic.render.lobes import reflected_radiance
from synthetic.shapes.ball import Ball
from synthetic.shapes.meshsurface import MeshSurface
from synthetic.shapes.surface import Points, Surface
from synthetic.shapes.tangents import tangents

from .bodies import corner, facet_points

Floats = NDArray[np.float64]

BALL = Ball(np.zeros(3), 1.0)
GREY = Lambertian(np.array([0.1, 0.2, 0.3]))
COLOUR = np.array([1.0, 2.0, 3.0])
UNIFORM: tuple[ExtendedLight, ...] = (AreaLight(np.array([0.3, 0.5, 0.8]), COLOUR, 1e6),)


def unit(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def on_ball(normals: Floats) -> Points:
    return Points(normals, normals, normals, tangents(normals), np.zeros((len(normals), 2)))


def seen(rng: np.random.Generator, count: int, least: float = 0.02) -> tuple[Points, Floats]:
    """Points all over the ball, and viewers all over their sky, grazing ones too."""
    normals, ways = unit(rng.normal(size=(2, count, 3)))
    cosine = rng.uniform(least, 1, (count, 1))
    across = unit(np.cross(normals, ways))
    return on_ball(normals), cosine * normals + np.sqrt(1 - cosine**2) * across


def gathered(
    surface: Surface,
    material: Material,
    lights: Sequence[ExtendedLight | DirectionalSource | PointSource],
    points: Points,
    views: Floats,
    count: int = 1024,
    seed: int = 5,
) -> tuple[Floats, Floats]:
    sources = tuple(light for light in lights if isinstance(light, DirectionalSource | PointSource))
    extended = tuple(light for light in lights if not isinstance(light, DirectionalSource | PointSource))
    lattices = np.broadcast_to(lattice(count), (len(points), count, 2))
    rng = np.random.default_rng(seed)
    return direct_light(
        surface, material, Illumination("lab", extended, sources), points, views, lattices, rng
    )


@pytest.mark.parametrize(
    "lights", [UNIFORM, (LatLongLight(np.broadcast_to(COLOUR, (4, 8, 3))),)], ids=["area light", "map"]
)
def test_uniform_light_gives_pi(lights: Sequence[ExtendedLight], rng: np.random.Generator) -> None:
    points, views = seen(rng, 200)
    irradiance, lobe = gathered(BALL, GREY, lights, points, views)
    # The cosine has a kink at the horizon, which 1024 directions of all the sphere find to 1e-3 (worst of 200).
    assert_allclose(irradiance, np.tile(np.pi * COLOUR, (200, 1)), rtol=3e-3)
    assert_allclose(irradiance.mean(axis=0), np.pi * COLOUR, rtol=2e-4)  # no bias: four standard errors
    assert not lobe.any()


@pytest.mark.parametrize(
    "material",
    [
        SmithMaterial(np.zeros(3), np.ones(3), 1.5, BeckmannSlopes(0.2, 0.2)),
        SmithMaterial(np.zeros(3), np.ones(3), None, GGXSlopes(0.5, 0.5)),
        PhongMaterial(np.zeros(3), np.ones(3), 30),
        SmithMaterial(np.zeros(3), np.ones(3), 1.5, BeckmannSlopes(0.01, 0.01)),
    ],
    ids=["Beckmann", "GGX", "Phong", "glossy"],
)
def test_a_lobe_in_a_white_furnace_shows_its_directional_albedo(material: Material) -> None:
    cosines = np.array([0.02, 0.1, 0.3, 0.6, 0.9, 1.0])
    normals = np.tile([0, 0, 1.0], (6, 1))
    views = np.column_stack([np.sqrt(1 - cosines**2), np.zeros(6), cosines])
    _, lobe = gathered(BALL, material, UNIFORM, on_ball(normals), views, 8192)
    expected = directional_albedo(material, cosines) * COLOUR
    # Its own quadrature is good to 1e-3; 8192 directions to 2e-3 at the grazing horizon.
    assert_allclose(lobe, expected, rtol=4e-3)
    if isinstance(material, SmithMaterial) and material.mu is None:
        assert (lobe / COLOUR).max() < 1


def test_one_source_on_a_matte_ball_is_a_cosine(rng: np.random.Generator) -> None:
    points, views = seen(rng, 500)
    towards = unit(np.array([0.2, -0.7, 0.4]))
    irradiance, _ = gathered(BALL, GREY, [DirectionalSource(towards, COLOUR)], points, views)
    assert_allclose(
        irradiance, np.maximum(points.normals @ towards, 0)[:, None] * COLOUR, atol=1e-14
    )  # rounding
    lamp = PointSource(3 * towards, COLOUR)
    irradiance, _ = gathered(BALL, GREY, [lamp], points, views)
    offset = lamp.position - points.positions
    # I cos / d^2, of the lamp's own direction from each point.
    expected = np.maximum((points.normals * offset).sum(axis=1), 0) / np.linalg.norm(offset, axis=1) ** 3
    assert_allclose(irradiance, expected[:, None] * COLOUR, atol=1e-14)  # rounding


def test_from_behind_nothing_is_seen(rng: np.random.Generator) -> None:
    points, views = seen(rng, 50)
    lights = [*UNIFORM, DirectionalSource(np.array([0, 0, 1.0]), COLOUR)]
    smith = SmithMaterial(np.ones(3), np.ones(3), 1.5, BeckmannSlopes(0.2, 0.2))
    for material in (smith, Mirror(np.ones(3), np.ones(3))):
        lights = lights if material is smith else lights[:1]
        for part in gathered(BALL, material, lights, points, -views):
            assert not part.any()


@pytest.mark.parametrize("width", [0.1, 0.35, 1.0])
def test_irradiance_of_area_lights_is_that_of_another_quadrature(
    width: float, rng: np.random.Generator
) -> None:
    light = AreaLight(np.array([0.3, -0.5, 0.8]), COLOUR, width)
    points, views = seen(rng, 300)
    irradiance, _ = gathered(BALL, GREY, [light], points, views)
    expected = quadrature_irradiance(light, points.normals)[:, None] * COLOUR
    # Of the largest: 1024 directions, of which the horizon cuts some off.
    assert_allclose(irradiance, expected, atol=1e-3 * expected.max())


@pytest.mark.parametrize("name", ["teflon", "steel", "painted"])
def test_rh01s_lobe_is_that_of_another_quadrature(name: str, rng: np.random.Generator) -> None:
    material = radiometric(RH01_MATERIALS[name])
    lights = [AreaLight(np.array([0.3, -0.5, 0.8]), COLOUR, 0.35), AreaLight(-np.ones(3), np.ones(3), 0.5)]
    source = DirectionalSource(np.array([1.0, 0.2, 0.3]), COLOUR)
    points, views = seen(rng, 200, least=0.1)
    irradiance, lobe = gathered(BALL, material, [*lights, source], points, views, 4096)
    found = material.kd * irradiance + material.ks * lobe
    expected = reflected_radiance(material, lights, [source], points.normals, views, order=32)
    level = expected + expected.mean()
    assert np.sqrt((((found - expected) / level) ** 2).mean()) < 2e-4
    assert np.abs((found - expected) / level).max() < 2e-3  # grazing, where the horizon cuts the lobe


def test_the_error_falls_in_proportion_to_the_directions(rng: np.random.Generator) -> None:
    material = radiometric(RH01_MATERIALS["teflon"])
    light = AreaLight(np.array([0.3, -0.5, 0.8]), COLOUR, 0.35)
    points, views = seen(rng, 400, least=0.1)
    expected = reflected_radiance(material, [light], [], points.normals, views, order=32)
    errors = []
    for count in (64, 1024):
        irradiance, lobe = gathered(BALL, material, [light], points, views, count)
        errors.append(np.sqrt(((material.kd * irradiance + material.ks * lobe - expected) ** 2).mean()))
    assert errors[1] < errors[0] / 10  # 1 / N would be 1 / 16; by chance 1 / sqrt(N), a quarter


def test_sub_samples_share_the_directions_of_their_pixel(rng: np.random.Generator) -> None:
    # Sixteen hands of 64 directions with one shift are as good as 1024 directions.
    material = radiometric(RH01_MATERIALS["teflon"])
    light = AreaLight(np.array([0.3, -0.5, 0.8]), COLOUR, 0.35)
    points, views = seen(rng, 100, least=0.1)
    again = np.repeat(np.arange(100), 16)
    lab = Illumination("lab", (light,))
    hands = np.tile(dealt(1024, 16), (100, 1, 1))
    parts = direct_light(BALL, material, lab, points[again], views[again], hands, rng, again)
    together = [part.reshape(100, 16, 3).mean(axis=1) for part in parts]
    apart = direct_light(BALL, material, lab, points[again], views[again], hands, rng)
    expected = reflected_radiance(material, [light], [], points.normals, views, order=32)

    def error(irradiance: Floats, lobe: Floats) -> float:
        return float(np.sqrt(((material.kd * irradiance + material.ks * lobe - expected) ** 2).mean()))

    alone = gathered(BALL, material, [light], points, views, 1024)
    assert error(*together) < 1.5 * error(*alone)
    assert error(*together) < 0.6 * error(*(part.reshape(100, 16, 3).mean(axis=1) for part in apart))


def test_a_mirror_shows_the_map_where_it_reflects_to(rng: np.random.Generator) -> None:
    light = LatLongLight(rng.uniform(0, 1, (16, 32, 3)))
    points, views = seen(rng, 300)
    mirror = Mirror(np.zeros(3), np.ones(3), 1.5)
    _, lobe = gathered(BALL, mirror, [light], points, views, 64)
    cosine = (points.normals * views).sum(axis=1)
    reflected = 2 * cosine[:, None] * points.normals - views
    # F(cos) / F(1), ks being the reflectance at normal incidence; float32 directions, 1e-6 of 0.2 rad.
    fresnel = fresnel_dielectric(1.5, cosine) / 0.04
    assert_allclose(lobe, light.radiance_from(reflected) * fresnel[:, None], rtol=1e-4)


def test_two_lights_are_the_sum_of_each(rng: np.random.Generator) -> None:
    material = SmithMaterial(np.full(3, 0.1), np.full(3, 0.3), 1.5, GGXSlopes(0.2, 0.2))
    points, views = seen(rng, 100, least=0.1)
    lights = [DiscLight(np.array([0, 1.0, 1.0]), COLOUR, 0.05), AreaLight(np.ones(3), COLOUR, 0.3)]
    both = gathered(BALL, material, lights, points, views, 4096)
    each = [gathered(BALL, material, [light], points, views, 4096) for light in lights]
    for together, first, second in zip(both, *each, strict=True):
        # Each has noise of its own: a part in a thousand of the brightest.
        assert_allclose(together, first + second, atol=2e-3 * (first + second).max())


def test_a_wall_takes_its_part_of_a_uniform_sky() -> None:
    # View factor of a wall, 1 high and 4 long, from the floor before its middle at distance d [Howell, B-4]. An endless
    # one takes (1 - cos a) / 2 of the sky, tan a = 1 / d.
    surface = corner(1.0, 4.0)
    distance = np.array([0.02, 0.1, 0.3, 0.6, 0.95])
    points = facet_points(np.column_stack([distance, np.zeros(5), np.zeros(5)]), (0, 0, 1))
    views = np.tile(unit(np.array([1.0, 0.5, 2.0])), (5, 1))
    irradiance, _ = gathered(surface, GREY, UNIFORM, points, views, 1 << 16)
    top = np.hypot(1, distance)
    wall = (np.arctan(2 / distance) - distance / top * np.arctan(2 / top)) / np.pi
    # Rays begin 4e-4 above the floor; the wall's edge, N^(-3/4), adds 2e-4.
    assert_allclose(irradiance, np.pi * (1 - wall)[:, None] * COLOUR, rtol=1e-3)


def two_spheres() -> MeshSurface:
    """A unit sphere at the origin, and one of radius 0.5 at (0, 0, 3)."""
    small = trimesh.creation.icosphere(5, 0.5)
    small.apply_translation([0, 0, 3])
    both = trimesh.util.concatenate([trimesh.creation.icosphere(5, 1.0), small])
    vertices, faces = np.array(both.vertices), np.array(both.faces)
    return MeshSurface(TriangleMesh(vertices, faces, smooth_normals(vertices, faces)))


def distance_to_shade(positions: Floats, towards: Floats) -> Floats:
    """How far rays pass by the small sphere's centre, in its radii."""
    offset = np.array([0, 0, 3.0]) - positions
    along = (offset * towards).sum(axis=1, keepdims=True)
    return np.where(along[:, 0] > 0, np.linalg.norm(offset - along * towards, axis=1) / 0.5, np.inf)


@pytest.mark.parametrize(
    ("light", "shades"),
    [
        (DirectionalSource(np.array([0.1, 0.05, 1.0]), COLOUR), True),
        (PointSource(np.array([0.3, 0.1, 6.0]), COLOUR), True),
        (PointSource(np.array([0.1, 0.1, 2.0]), COLOUR), False),
        (PointSource(np.array([0, -4.0, 0.5]), COLOUR), False),
    ],
    ids=["distant", "lamp behind", "lamp between", "lamp aside"],
)
def test_a_sphere_shades_another(
    light: DirectionalSource | PointSource, shades: bool, rng: np.random.Generator
) -> None:
    surface = two_spheres()
    origins = 5 * unit(rng.normal(size=(4000, 3)))
    ways = unit(0.9 * unit(rng.normal(size=(4000, 3))) - origins)
    hit, points = surface.first_hits(origins, ways)
    views = -ways[hit]
    large = np.linalg.norm(points.positions, axis=1) < 1.01
    points, views = points[large], views[large]
    irradiance, _ = gathered(surface, GREY, [light], points, views)
    towards, _, strength = light.at(points.positions)
    passing = distance_to_shade(points.positions, towards)
    cosine = (points.normals * towards).sum(axis=1)
    # Not at the edges of shadows, which the mesh cuts into straight pieces, nor at the terminator.
    clear = (np.abs(passing - 1) > 0.01) & (np.abs(cosine) > 0.05)
    lit = (passing > 1) if shades else np.ones(len(points), bool)
    expected = np.where(lit, np.maximum(cosine, 0), 0)[:, None] * strength
    assert_allclose(irradiance[clear], expected[clear], rtol=1e-9, atol=1e-12)
    assert (irradiance[clear & (cosine > 0)] == 0).any() == shades


def test_a_sphere_overhead_takes_its_square_of_the_sky() -> None:
    # A sphere of radius r centred at distance d above a point takes (r / d)^2 of the cosine-weighted sky.
    points = facet_points(np.array([[0, 0, 1.0]]), (0, 0, 1))
    irradiance, _ = gathered(two_spheres(), GREY, UNIFORM, points, np.array([[0, 0.6, 0.8]]), 1 << 16)
    # From (0, 0, 1) the small sphere is at d = 2; its mesh is 1e-4 smaller.
    assert_allclose(irradiance[0], np.pi * (1 - 0.25**2) * COLOUR, rtol=5e-4)


def test_a_mirror_sees_itself_as_black(rng: np.random.Generator) -> None:
    surface = corner(1.0, 10.0)
    points = facet_points(np.array([[0.5, 0.0, 0.0], [0.5, 0, 0]]), (0, 0, 1))
    views = unit(np.array([[1.0, 0, 1.0], [-1.0, 0, 3.0]]))
    _, lobe = gathered(surface, Mirror(np.zeros(3), np.ones(3)), UNIFORM, points, views, 64)
    # The first looks into the wall, half its height away at 45 degrees; the second out of the corner.
    assert_allclose(lobe, [np.zeros(3), COLOUR], rtol=1e-6)


def test_nothing_to_gather_is_nothing(rng: np.random.Generator) -> None:
    points, views = seen(rng, 3)
    none = np.zeros(3, bool)
    for part in gathered(BALL, GREY, UNIFORM, points[none], views[none]):
        assert part.shape == (0, 3)

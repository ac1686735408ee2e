"""Unknown light on meshes: rows under shadows whose borders are known by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from invrender.brdf.lobes import BECKMANN
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.rows import rows_of, slopes_of
from invrender.estimate.unknown_light.start import NOTHING
from invrender.estimate.unknown_light.state import BlindState, turn
from invrender.transport.visibility import Shadows
from recon.harmonics.basis import evaluate_harmonics, sphere_directions
from recon.mesh.bodies import MeshBody, blended
from recon.mesh.transfer import transfer_vectors
from recon.mesh.transfercache import USUAL_DEGREE, USUAL_RAYS
from recon.mesh.trianglemesh import TriangleMesh
from recon.sampling.lightfield import LightField
from synthetic.lights.arealight import AreaLight

Floats = np.ndarray
UP = np.array([0.0, 0.0, 1.0])
CENTRE = 2 * UP
SIDE = 32
VIEW = np.array([0.6, 0.0, 0.8])
BRDF = BlindState(np.full(3, 0.3), 1.5, 0.2, np.zeros((0, 3)))


def field_on(mesh: TriangleMesh, faces: np.ndarray, weights: Floats) -> LightField:
    """Points of faces (n,), seen from `VIEW`, black, their mirror directions free."""
    corners, count = mesh.faces[faces], len(faces)
    normals = blended(mesh.normals, corners, weights)
    return LightField(
        rows=np.arange(count),
        columns=np.zeros(count, int),
        radiance=np.zeros((count, 3)),
        variance=np.ones((count, 3)),
        weight=np.ones(count),
        ray_sample=np.arange(count),
        positions=blended(mesh.vertices, corners, weights),
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        views=np.broadcast_to(VIEW, (count, 3)),
        reflected_visible=np.ones(count, bool),
        sources_visible=np.zeros((count, 0), bool),
        faces=faces,
        corner_weights=weights,
    )


def ball_over_plane() -> TriangleMesh:
    """A ball of radius 1 about (0, 0, 2) over a square of 8 by 8, whose faces come last."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    x, y = np.meshgrid(np.linspace(-4, 4, SIDE + 1), np.linspace(-4, 4, SIDE + 1))
    square = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    corner = len(ball.vertices) + (np.arange(SIDE) + (SIDE + 1) * np.arange(SIDE)[:, None]).ravel()
    right, up = corner + 1, corner + SIDE + 1
    return TriangleMesh(
        np.concatenate([ball.vertices + CENTRE, square]),
        np.concatenate(
            [ball.faces, np.column_stack([corner, right, up]), np.column_stack([right, up + 1, up])]
        ),
        np.concatenate([ball.vertices, np.tile(UP, (len(square), 1))]),
    )


@pytest.fixture(scope="module")
def plane() -> tuple[Shadows, LightField]:
    """Points all over the square, and the mesh's shadows."""
    mesh, rng = ball_over_plane(), np.random.default_rng(3)
    faces = len(mesh.faces) - 1 - rng.integers(0, 2 * SIDE**2, 600)
    weights = rng.dirichlet(np.ones(3), 600)
    body = MeshBody(mesh)
    field = field_on(mesh, faces, weights)
    free = body.visible(field.positions, field.normals, field.mirrored)
    return Shadows.of(body, transfer_vectors(mesh, 8, 256)), replace(field, reflected_visible=free)


def test_a_source_lights_what_no_ball_stands_before(plane: tuple[Shadows, LightField]) -> None:
    shadows, field = plane
    towards = np.array([0.48, 0.36, 0.8])
    state = BRDF.with_source(towards)
    design, clear = LightingDesign.of([field], 4, shadows=shadows), LightingDesign.of([field], 4)
    rows, unshadowed = (rows_of(own, state, 4) for own in (design, clear))
    # From the ball's centre, how far each point's ray to the source passes.
    away = np.linalg.norm(np.cross(field.positions - CENTRE, towards), axis=1)
    # Directions are told apart to half a degree, which is a twentieth of the radius from afar.
    dark, lit = away < 0.93, away > 1.07
    assert dark.sum() > 20
    for own, free in (
        (rows.of_channel(0.0), unshadowed.of_channel(0.0)),
        (rows.of_channel(1.0), unshadowed.of_channel(1.0)),
    ):
        assert not own[dark, -1].any()
        assert_array_equal(own[lit, -1], free[lit, -1])
    # A small turn of the source takes the shadow along, which slopes leave out: they are those of lit points, or none.
    light = np.vstack([np.zeros((25, 3)), np.ones((1, 3))])
    slopes, free_slopes = slopes_of(design, state, rows, light), slopes_of(clear, state, unshadowed, light)
    assert not slopes[dark].any()
    assert_array_equal(slopes[lit], free_slopes[lit])
    # Borders are where a turn by a fiftieth of a radian changes what is seen.
    border = np.zeros(len(away), bool)
    for angle in np.linspace(0, 2 * np.pi, 60):
        turned = turn(towards, *(0.02 * np.array([np.cos(angle), np.sin(angle)])))
        passing = np.linalg.norm(np.cross(field.positions - CENTRE, turned), axis=1)
        border |= (passing < 1) != (away < 1)
    off = design.off_borders(state.directions)
    assert off[~border].all()
    # Six directions around don't show what a circle of them does only just.
    assert (off & border).sum() < 0.2 * border.sum()


def test_the_lobe_sees_light_where_the_mirrored_ray_is_free(plane: tuple[Shadows, LightField]) -> None:
    shadows, field = plane
    free = field.reflected_visible
    for state in (BRDF, BRDF.with_form(BECKMANN)):
        own, clear = (
            rows_of(LightingDesign.of([field], 4, shadows=known), state, 4).of_channel(1.0)
            for known in (shadows, None)
        )
        assert_array_equal(own[free], clear[free])
        assert not own[~free].any()
    # Angle of the mirrored ray from the ball's edge.
    way = CENTRE - field.positions
    distance = np.linalg.norm(way, axis=1)
    off = np.abs(np.arccos((field.mirrored * way).sum(axis=1) / distance) - np.arcsin(1 / distance))
    clear_of_edges = LightingDesign.of([field], 0, shadows=shadows).off_edges(0.1)
    assert clear_of_edges[off > 0.26].all()
    assert not clear_of_edges[off < 0.07].any()
    assert (off < 0.07).sum() > 20


def test_a_ball_keeps_its_share_of_a_uniform_sky_off_the_plane(plane: tuple[Shadows, LightField]) -> None:
    shadows, field = plane
    uniform = (
        np.sqrt(4 * np.pi)
        * rows_of(LightingDesign.of([field], 8, shadows=shadows), NOTHING, 8).of_channel(0.0)[:, 0]
    )
    distance = np.linalg.norm(field.positions - CENTRE, axis=1)
    # Of a ball that is wholly above the horizon: its solid angle's projection on the plane.
    expected = np.pi * (1 - 2 / distance**3)
    # 256 rays a vertex leave 2% of pi.
    assert np.sqrt(np.mean((uniform - expected) ** 2)) < 0.03 * np.pi
    assert expected.min() < 0.8 * np.pi


def test_a_window_lights_the_plane_as_the_usual_table_of_shadows_has_it(
    plane: tuple[Shadows, LightField],
) -> None:
    body, field = plane[0].body, plane[1]
    window = AreaLight(np.array([0.3, 0.2, 0.93]), np.ones(3), width_rad=np.radians(12))
    sky = sphere_directions(40_000)
    sky = sky[sky[:, 2] > 0]
    sent = window.radiance_from(sky) * sky[:, 2:] * (2 * np.pi / len(sky))
    # Rays that meet the ball, by hand.
    way = CENTRE - field.positions
    along = way @ sky.T
    met = (along > 0) & (along**2 > (way**2).sum(axis=1, keepdims=True) - 1)
    expected = np.where(met, 0, 1) @ sent[:, :1]
    grid = sphere_directions(40_000)
    harmonics = evaluate_harmonics(grid, USUAL_DEGREE)
    light = 4 * np.pi / len(grid) * harmonics.T @ window.radiance_from(grid)[:, :1]
    shadows = Shadows.of(body, transfer_vectors(body.mesh, USUAL_DEGREE, USUAL_RAYS))
    rows = rows_of(LightingDesign.of([field], USUAL_DEGREE, shadows=shadows), NOTHING, USUAL_DEGREE)
    error = (rows.of_channel(0.0) @ light - expected) / expected.max()
    # 0.0061; with half as many rays 0.0109, and up to degree 8 alone 0.0074.
    assert np.sqrt(np.mean(error**2)) < 0.0067


def test_a_convex_mesh_is_seen_as_what_has_no_shadows() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4)
    mesh, rng = TriangleMesh(ball.vertices, ball.faces, ball.vertices), np.random.default_rng(4)
    faces = np.flatnonzero(ball.triangles_center @ VIEW > 0.3)
    field = field_on(mesh, faces, rng.dirichlet(np.ones(3), len(faces)))
    towards = np.array([0.0, 0.6, 0.8])
    shadows = Shadows.of(MeshBody(mesh), transfer_vectors(mesh, 6, 64))
    state = BRDF.with_source(towards)
    own, clear = (
        rows_of(LightingDesign.of([field], 6, shadows=known), state, 6) for known in (shadows, None)
    )
    # Flat faces set by up to 2 degrees before or after the smooth surface.
    off = np.abs(field.normals @ towards) > 0.04
    for one, other in (
        (own.of_channel(0.0), clear.of_channel(0.0)),
        (own.of_channel(1.0), clear.of_channel(1.0)),
    ):
        assert_allclose(one[off], other[off], atol=1e-6)

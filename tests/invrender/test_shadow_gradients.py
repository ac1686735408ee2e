"""Gradients of what occluders hide, against central differences of sums over directions [RMB07, sections 6 and 7]."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from trimesh.creation import icosphere

from invrender.gradients.shadows import BlockedAngles, hidden_transfer
from recon.harmonics.basis import evaluate_harmonics
from recon.mesh.rays import RayTracer

Floats = NDArray[np.float64]

TRIANGLE = np.array([[-0.4, 1.0], [0.7, 1.3], [0.1, 1.9]])
DISC = np.array([0.2, 1.5]), 0.6
POINTS = np.random.default_rng(3).uniform([-1, -0.5], [1, 0.3], (10, 2))
STEP = 1e-3


def density(angles: Floats) -> Floats:
    """Light over angles, times a cosine of all above the ground."""
    return (1.3 + np.sin(3 * angles) - 0.4 * np.cos(2 * angles + 1)) * np.maximum(np.sin(angles), 0)


def in_triangle(points: Floats, angles: Floats) -> NDArray[np.bool_]:
    """Whether a ray lies between two corners: whether some lie to its left and some to its right, before it."""
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    offsets = TRIANGLE - points[:, None]
    sides = np.einsum("a,nk->nka", ways[:, 0], offsets[..., 1]) - np.einsum(
        "a,nk->nka", ways[:, 1], offsets[..., 0]
    )
    before = np.einsum("ac,nkc->nka", ways, offsets) > 0
    return (sides.max(axis=1) > 0) & (sides.min(axis=1) < 0) & before.all(axis=1)


def in_disc(points: Floats, angles: Floats) -> NDArray[np.bool_]:
    """Whether a ray passes the centre at less than the radius."""
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    offsets = DISC[0] - points
    along = offsets @ ways.T
    return (along > 0) & ((offsets**2).sum(axis=1)[:, None] - along**2 < DISC[1] ** 2)


@pytest.mark.parametrize(
    ("edges", "blocks"),
    [
        (lambda points: BlockedAngles.by_polygon(TRIANGLE, points), in_triangle),
        (lambda points: BlockedAngles.by_disc(*DISC, points), in_disc),
    ],
    ids=["corners", "a curve"],
)
def test_light_hidden_in_a_plane_changes_as_sums_over_rays_do(
    edges: Callable[[Floats], BlockedAngles], blocks: Callable[[Floats, Floats], NDArray[np.bool_]]
) -> None:
    angles = np.pi * (np.arange(400_000) + 0.5) / 400_000

    def summed(points: Floats) -> Floats:
        return blocks(points, angles) @ density(angles) * (np.pi / len(angles))

    found = edges(POINTS)
    # A ray's share is 1e-5 of what is hidden.
    assert_allclose(found.hidden(density), summed(POINTS), atol=3e-5)
    steps = 20 * STEP * np.eye(2)
    differences = np.stack(
        [(summed(POINTS + step) - summed(POINTS - step)) / (40 * STEP) for step in steps], axis=1
    )
    gradient = found.hidden_by_place(density)
    # The differences' own error: a ray in a step's worth of them, and the step's square.
    assert np.linalg.norm(gradient - differences) < 2e-3 * np.linalg.norm(gradient)
    exact = np.stack(
        [
            (edges(POINTS + e).hidden(density) - edges(POINTS - e).hidden(density)) / (2 * STEP)
            for e in STEP * np.eye(2)
        ],
        axis=1,
    )
    assert np.linalg.norm(gradient - exact) < 1e-5 * np.linalg.norm(gradient)


L_MAX = 4
CENTRE, RADIUS = np.array([0.4, -0.2, 1.5]), 0.6
PLACES = np.array([[0.0, 0.0, 0.0], [0.5, 0.3, -0.2], [-0.6, 0.2, 0.1]])
NORMALS = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.5, 0.2, 0.0], [-0.3, 0.9, 0.1]]).apply([0.0, 0.0, 1.0])


def hidden_by_sphere(place: Floats, normal: Floats) -> Floats:
    """Irradiance of each harmonic over the cone of directions in which the sphere stands."""
    offset = CENTRE - place
    distance = float(np.linalg.norm(offset))
    least = np.sqrt(1 - (RADIUS / distance) ** 2)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    z, turns = least + (1 - least) * (nodes + 1) / 2, 2 * np.pi * np.arange(80) / 80
    around = np.sqrt(1 - z**2)[:, None] * np.stack([np.cos(turns), np.sin(turns)])[:, None]
    local = np.stack([*around, np.broadcast_to(z[:, None], around.shape[1:])], axis=-1)
    axis = np.linalg.svd(offset[None] / distance)[2]
    axis[0] = offset / distance
    directions = (local @ axis[[1, 2, 0]]).reshape(-1, 3)
    areas = np.repeat(weights * (1 - least) / 2, 80) * 2 * np.pi / 80
    return (areas * np.maximum(directions @ normal, 0)) @ evaluate_harmonics(directions, L_MAX)


def slopes(of: Callable[[Floats], Floats]) -> Floats:
    return np.stack([(of(step) - of(-step)) / (2 * STEP) for step in STEP * np.eye(3)])


def test_irradiance_hidden_by_a_sphere_has_its_closed_form() -> None:
    for place, normal in zip(PLACES, NORMALS, strict=True):
        offset = CENTRE - place
        known = np.pi * RADIUS**2 * (normal @ offset) / np.linalg.norm(offset) ** 3
        assert hidden_by_sphere(place, normal)[0] * np.sqrt(4 * np.pi) == pytest.approx(known, rel=1e-9)


def test_transfer_hidden_by_a_mesh_changes_as_integrals_over_the_sphere_do() -> None:
    ball = icosphere(subdivisions=5, radius=RADIUS)
    tracer = RayTracer(ball.vertices + CENTRE, ball.faces)
    value = np.stack([hidden_by_sphere(*one) for one in zip(PLACES, NORMALS, strict=True)])
    by_place, by_normal = (
        np.stack(
            [
                slopes(
                    lambda step, p=p, n=n, moves=moves: hidden_by_sphere(
                        p + moves * step, n + (1 - moves) * step
                    )
                )
                for p, n in zip(PLACES, NORMALS, strict=True)
            ]
        )
        for moves in (1, 0)
    )

    def off(rays: int) -> Floats:
        turns = Rotation.random(16, np.random.default_rng(0)).as_matrix()
        found = [hidden_transfer(tracer, PLACES, NORMALS, L_MAX, rays, turn) for turn in turns]
        return np.array(
            [
                np.sqrt(np.mean([(getattr(one, name) - truth) ** 2 for one in found]) / np.mean(truth**2))
                for name, truth in (("value", value), ("by_place", by_place), ("by_normal", by_normal))
            ]
        )

    few, many = off(128), off(2048)
    # Straight borders in triangles of neighbours err by the square of their size, so by one over the number of rays:
    # a sixteenth. Without the borders' own part values fall to an eighth, as rays^-0.75, from a fifth on.
    assert (many < few / 8).all()
    assert (many < [0.006, 0.004, 0.006]).all()

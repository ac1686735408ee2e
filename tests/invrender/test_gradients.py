"""Gradients of reflected light fields against central differences of sums over directions [RMB07]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from invrender.gradients import flatland, surface

Floats = NDArray[np.float64]

# Central differences err by about the square of their step.
STEP = 1e-4


def plane_field(seed: int) -> flatland.PlaneField:
    """Light that varies over places as Gaussians do, over angles as a trigonometric polynomial."""
    rng = np.random.default_rng(seed)
    amplitudes, phases, middles = rng.normal(size=6), rng.uniform(0, 2 * np.pi, 6), rng.normal(size=6)
    k = np.arange(6)

    def parts(x: Floats, theta: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        away = np.asarray(x)[..., None] - middles
        turned = k * np.asarray(theta)[..., None] + phases
        return amplitudes * np.exp(-(away**2)), away, np.cos(turned), np.sin(turned)

    def value(x: Floats, theta: Floats) -> Floats:
        height, _, cos, _ = parts(x, theta)
        return (height * cos).sum(axis=-1)

    def by_place(x: Floats, theta: Floats) -> Floats:
        height, away, cos, _ = parts(x, theta)
        return (-2 * away * height * cos).sum(axis=-1)

    def by_angle(x: Floats, theta: Floats) -> Floats:
        height, _, _, sin = parts(x, theta)
        return (-k * height * sin).sum(axis=-1)

    return flatland.PlaneField(value, by_place, by_angle)


def bumpy_normal(x: Floats) -> Floats:
    """Of a curve with a bump map on it, radians."""
    return 0.7 * x + 0.3 * np.sin(2 * x)


def bumpy_slope(x: Floats) -> Floats:
    return 0.7 + 0.6 * np.cos(2 * x)


def lobe(x: Floats, apart: Floats) -> Floats:
    """Wider to the right."""
    return np.exp((6 - 2 * np.tanh(x)) * (np.cos(apart) - 1))


def lobe_by_place(x: Floats, apart: Floats) -> Floats:
    return -2 / np.cosh(x) ** 2 * (np.cos(apart) - 1) * lobe(x, apart)


def summed_in_the_plane(field: flatland.PlaneField, x: Floats, theta: Floats) -> Floats:
    """The reflected light: over angles of incidence from the normal, each seen about its mirrored direction."""
    incidence = 2 * np.pi * (np.arange(700) + 0.3) / 700
    normal = bumpy_normal(x)[..., None]
    light = field.value(x[..., None], normal + incidence)
    return (light * lobe(x[..., None], -incidence - (theta[..., None] - normal))).mean(axis=-1) * 2 * np.pi


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_terms_in_the_plane_add_up_to_central_differences(seed: int) -> None:
    field = plane_field(seed)
    x, theta = np.random.default_rng(seed + 10).uniform(-1.5, 1.5, (2, 40))
    terms = flatland.gradient_terms(field, bumpy_normal, bumpy_slope, lobe, x, theta, lobe_by_place)
    found = np.stack([terms.by_place, terms.by_angle])
    differences = [
        summed_in_the_plane(field, x + STEP * along, theta + STEP * about)
        - summed_in_the_plane(field, x - STEP * along, theta - STEP * about)
        for along, about in ((1, 0), (0, 1))
    ]
    assert_allclose(found, np.array(differences) / (2 * STEP), rtol=0, atol=1e-6 * np.abs(found).max())
    # The four steps, one after the other, by their own rules.
    whole = flatland.shaded(field, bumpy_normal, bumpy_slope, lobe, lobe_by_place)
    assert_allclose(whole.value(x, theta), summed_in_the_plane(field, x, theta), atol=1e-12 * len(x))
    assert_allclose(np.stack([whole.by_place(x, theta), whole.by_angle(x, theta)]), found, atol=1e-10)


@dataclass(frozen=True)
class Bumps:
    """A surface z = h(x, y): its normal is up where it is flat."""

    seed: int
    height: float = 0.05

    def waves(self, xy: Floats) -> tuple[Floats, Floats]:
        rng = np.random.default_rng(self.seed)
        frequencies, phases = rng.normal(0, 3, (5, 2)), rng.uniform(0, 2 * np.pi, 5)
        return frequencies, xy @ frequencies.T + phases

    def positions(self, xy: Floats) -> Floats:
        return np.column_stack([xy, self.height * np.sin(self.waves(xy)[1]).sum(axis=1)])

    def normals(self, xy: Floats) -> Floats:
        frequencies, phases = self.waves(xy)
        slope = self.height * np.cos(phases) @ frequencies
        normals = np.column_stack([-slope, np.ones(len(xy))])
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def points(self, xy: Floats, camera: Floats) -> surface.CurvedSurface:
        frequencies, phases = self.waves(xy)
        hessian = -self.height * np.einsum("nk,ki,kj->nij", np.sin(phases), frequencies, frequencies)
        slope = self.height * np.cos(phases) @ frequencies
        normals, positions = self.normals(xy), self.positions(xy)
        first = np.column_stack([np.ones(len(xy)), np.zeros(len(xy)), slope[:, 0]])
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        tangents = np.stack([first, np.cross(normals, first)], axis=1)
        # Second fundamental form of a graph, in the tangents.
        length = np.sqrt(1 + (slope**2).sum(axis=1))
        shape = np.einsum("nia,nab,njb->nij", tangents[..., :2], hessian, tangents[..., :2])
        steps = surface.steps_of_shape(tangents, shape / length[:, None, None])
        towards = camera - positions
        distances = np.linalg.norm(towards, axis=1)
        return surface.CurvedSurface(
            positions,
            normals,
            tangents,
            steps,
            towards / distances[:, None],
            distances,
        )


LAMP, WIDTH = np.array([0.6, -0.4, 1.1]), 0.3


def directions_and_solid_angles(count: int) -> tuple[Floats, Floats]:
    z, weight = np.polynomial.legendre.leggauss(count)
    phi = np.pi * (np.arange(2 * count) + 0.5) / count
    sin = np.sqrt(1 - z**2)
    grid = np.stack(
        [np.outer(sin, np.cos(phi)), np.outer(sin, np.sin(phi)), np.repeat(z[:, None], 2 * count, axis=1)], -1
    )
    return grid.reshape(-1, 3), np.repeat(weight * np.pi / count, 2 * count)


def near_light(positions: Floats, directions: Floats, solid_angles: Floats) -> surface.IncidentLight:
    """A soft lamp at LAMP, dimmer with the square of its distance, before a distant sky."""
    towards = LAMP - positions
    distance = np.linalg.norm(towards, axis=1)[:, None]
    unit = towards / distance
    cosine = unit @ directions.T
    lamp = np.exp((cosine - 1) / WIDTH**2) / distance**2
    sky = 1 + directions @ np.array([0.2, -0.3, 0.5])
    # The unit vector turns by minus the step's part across it, over the distance.
    across = directions - cosine[..., None] * unit[:, None]
    by_place = lamp[..., None] * (
        -across / (WIDTH**2 * distance[..., None]) + 2 * unit[:, None] / distance[..., None]
    )
    gradient = lamp[..., None] / WIDTH**2 * unit[:, None] + np.array([0.2, -0.3, 0.5])
    along = (gradient * directions).sum(axis=-1, keepdims=True)
    return surface.IncidentLight(
        directions, solid_angles, lamp + sky, by_place, gradient - along * directions
    )


GLOSSY = surface.CentredShading(
    lambda cosine: np.exp(12 * (cosine - 1)), lambda c: 1 + (1 - c) ** 3, lambda c: -3 * (1 - c) ** 2, True
)
# A smooth lobe about the normal, so that sums over directions are exact.
MATTE = surface.CentredShading(lambda cosine: np.exp(2 * cosine), np.ones_like, np.zeros_like, False)
CAMERA = np.array([1.5, 1.0, 2.5])


def summed(body: Bumps, xy: Floats, shading: surface.CentredShading) -> Floats:
    """Radiance (n,) by the sum over directions, the lobe's centre from the definition of a mirror."""
    directions, solid_angles = directions_and_solid_angles(45)
    positions, normals = body.positions(xy), body.normals(xy)
    views = CAMERA - positions
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    light = near_light(positions, directions, solid_angles).radiance
    cosine = (views * normals).sum(axis=1)
    if shading.about_mirrored_view:
        # A ray from the camera is thrown back by the matrix 1 - 2 n n'.
        mirror = np.eye(3) - 2 * normals[:, :, None] * normals[:, None, :]
        centres = -np.einsum("nij,nj->ni", mirror, views)
    else:
        centres = normals
    lobe = shading.profile(centres @ directions.T)
    return shading.factor(cosine) * (lobe * light * solid_angles).sum(axis=1)


@pytest.mark.parametrize("shading", [GLOSSY, MATTE], ids=["glossy", "matte"])
@pytest.mark.parametrize("seed", [0, 1])
def test_terms_on_a_surface_add_up_to_central_differences(seed: int, shading: surface.CentredShading) -> None:
    body = Bumps(seed)
    xy = np.random.default_rng(seed).uniform(-0.4, 0.4, (20, 2))
    points = body.points(xy, CAMERA)
    light = near_light(points.positions, *directions_and_solid_angles(40))
    terms = surface.gradient_terms(points, light, shading)
    assert_allclose(terms.radiance, summed(body, xy, shading), rtol=1e-6)
    differences = np.stack(
        [
            (summed(body, xy + STEP * t, shading) - summed(body, xy - STEP * t, shading)) / (2 * STEP)
            for t in np.moveaxis(points.tangents[..., :2], 1, 0)
        ],
        axis=1,
    )
    # None of the terms is small, so that each is judged.
    for part in (terms.spatial, terms.curvature):
        assert np.abs(part).max() > 0.1 * np.abs(terms.whole).max()
    assert_allclose(terms.whole, differences, atol=1e-4 * np.abs(differences).max())


def test_special_cases_have_the_terms_of_figure_4() -> None:
    xy = np.random.default_rng(3).uniform(-0.4, 0.4, (10, 2))
    grid = directions_and_solid_angles(30)
    points = Bumps(0).points(xy, CAMERA)
    near = near_light(points.positions, *grid)
    distant = replace(near, by_place=np.zeros_like(near.by_place))
    overcast = replace(distant, by_direction=np.zeros_like(near.by_direction))
    flat = replace(points, normal_steps=np.zeros_like(points.normal_steps), distances=np.full(10, np.inf))
    assert not surface.gradient_terms(points, distant, MATTE).spatial.any()
    assert not surface.gradient_terms(points, overcast, MATTE).whole.any()
    assert not surface.gradient_terms(flat, distant, GLOSSY).whole.any()
    # A texture scales what is there, in its own direction [RMB07, eq. 20].
    steps = np.random.default_rng(4).normal(size=(10, 2))
    terms = surface.gradient_terms(flat, distant, GLOSSY, steps)
    assert_allclose(terms.whole, steps * terms.radiance[:, None])

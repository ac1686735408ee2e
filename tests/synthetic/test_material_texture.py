"""Weights that vary over texture coordinates."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from synthetic.materials.facets import GGXSlopes
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.mirror import Mirror
from synthetic.materials.smith import SmithMaterial
from synthetic.materials.texture import Textured

SHINY = SmithMaterial(np.ones(3), np.ones(3), None, GGXSlopes(0.2, 0.3))


def textured(kd_map: np.ndarray) -> Textured:
    return Textured(SHINY, kd_map, np.full((1, 1, 3), 0.5))


def test_texel_centres_have_their_texels_weights(rng: np.random.Generator) -> None:
    kd_map = rng.uniform(size=(4, 6, 3))
    row, column = np.mgrid[:4, :6]
    # The first row is at the top, v = 1.
    uv = np.column_stack([(column.ravel() + 0.5) / 6, 1 - (row.ravel() + 0.5) / 4])
    kd, ks = textured(kd_map).weights(uv)
    assert_allclose(kd, kd_map.reshape(-1, 3), rtol=1e-12)
    assert (ks == 0.5).all()


def test_between_centres_weights_are_linear(rng: np.random.Generator) -> None:
    # A plane in u and v, away from the edges.
    row, column = np.mgrid[:8, :10]
    u, v = (column + 0.5) / 10, 1 - (row + 0.5) / 8
    kd_map = np.stack([u, v, 0.2 + 0.3 * u + 0.1 * v], axis=-1)
    uv = rng.uniform(0.1, 0.9, size=(50, 2))
    kd, _ = textured(kd_map).weights(uv)
    assert_allclose(kd, np.column_stack([*uv.T, 0.2 + 0.3 * uv[:, 0] + 0.1 * uv[:, 1]]), rtol=1e-12)


def test_u_wraps_around_and_v_stops(rng: np.random.Generator) -> None:
    kd_map = rng.uniform(size=(3, 4, 3))
    material = textured(kd_map)
    uv = rng.uniform(size=(20, 2))
    assert_allclose(material.weights(uv + np.array([1, 0]))[0], material.weights(uv)[0], rtol=1e-9)
    # The seam lies half-way between the last column and the first; above the top row's centre nothing changes.
    seam = (kd_map[0, 0] + kd_map[0, -1]) / 2
    kd, _ = material.weights(np.array([[0.0, 1.0], [1.0, 1.0], [0.0, 0.9], [0.0, 1.2]]))
    assert_allclose(kd, np.broadcast_to(seam, (4, 3)), rtol=1e-12)
    kd, _ = material.weights(np.array([[0.125, 0.0]]))
    assert_allclose(kd[0], kd_map[-1, 0], rtol=1e-12)


def test_the_lobe_is_the_materials(rng: np.random.Generator) -> None:
    material = textured(np.full((2, 2, 3), [0.1, 0.2, 0.3]))
    w = np.array([[0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    u = rng.uniform(size=(2, 2))
    assert (material.lobe(w, w[::-1]) == SHINY.lobe(w, w[::-1])).all()
    assert (material.density(w, w[::-1]) == SHINY.density(w, w[::-1])).all()
    assert (material.sample(w, u) == SHINY.sample(w, u)).all()
    assert not material.is_isotropic
    assert Textured(Mirror(np.zeros(3), np.ones(3)), np.zeros((1, 1, 3)), np.ones((1, 1, 3))).is_mirror
    assert_allclose(material.kd, [0.1, 0.2, 0.3], rtol=1e-12)


@pytest.mark.parametrize(
    ("kd_map", "message"),
    [
        (np.zeros((4, 3)), r"kd_map has the shape \(4, 3\)"),
        (np.array([[[0.1, 0.1, 0.1], [0.1, -0.2, 0.1]]]), "kd_map is .*-0.2.* at row 0, column 1"),
        (np.full((2, 2, 3), np.nan), "kd_map is .*nan.* at row 0, column 0"),
    ],
)
def test_impossible_maps_are_refused(kd_map: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Textured(Lambertian(np.ones(3)), kd_map, np.zeros((1, 1, 3)))

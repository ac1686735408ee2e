"""Rows of the reflection operator against the reflection integral, summed up over directions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.theory.operator import irradiance_operator, reflection_operator, view_frames
from recon.harmonics.basis import sphere_directions
from synthetic.materials.facets import GGXSlopes
from synthetic.materials.smith import SmithMaterial

from .quadrature import hemisphere_grid, reflected, scipy_harmonics
from .test_brdfcoefficients import glossy, matte, rh01


def ggx(incident, exitant):
    return SmithMaterial(np.zeros(3), np.ones(3), 1.6, GGXSlopes(0.3, 0.3)).lobe(incident, exitant)[..., 0]


def seen_from(view: np.ndarray, lowest: float) -> np.ndarray:
    normals = sphere_directions(400)
    return np.concatenate([view[None], normals[normals @ view > lowest]])


@pytest.mark.parametrize(
    ("brdf", "tolerance", "rule"),
    # Doubling goes on until nothing changes, so that errors are below what is asked. GGX has a root at the horizon.
    [
        (matte, 1e-9, (12, 24)),
        (glossy, 1e-9, (30, 60)),
        (rh01(0.15), 1e-9, (100, 600)),
        (rh01(0.4), 1e-9, (60, 300)),
        (ggx, 1e-5, (100, 300)),
    ],
)
def test_rows_yield_the_reflection_integral(brdf, tolerance: float, rule: tuple[int, int], rng):
    view = np.array([0.48, 0.6, 0.64])
    normals = seen_from(view, 0.15)
    views = np.broadcast_to(view, normals.shape)
    lighting = rng.normal(size=49)
    found = reflection_operator(brdf, normals, views, 6, min(tolerance, 1e-6)) @ lighting
    frames = view_frames(normals, views)
    local = np.einsum("nkj,k->nj", frames, view)
    some = np.unique(np.concatenate([[0], rng.integers(len(normals), size=5), [np.argmin(normals @ view)]]))
    expected = reflected(
        brdf,
        lambda directions: scipy_harmonics(directions, 6) @ lighting,
        frames[some],
        local[some],
        hemisphere_grid(*rule),
    )
    assert_allclose(found[some], expected, atol=tolerance * np.abs(expected).max())


def test_the_sum_over_samples_of_one_operator_is_that_of_many_small_ones():
    # Tables are interpolated where there are many samples, and not where there are few.
    view = np.array([0.0, 0.6, 0.8])
    normals = seen_from(view, 0.2)
    views = np.broadcast_to(view, normals.shape)
    whole = reflection_operator(rh01(0.15), normals, views, 5)
    parts = [reflection_operator(rh01(0.15), normals[k : k + 4], views[k : k + 4], 5) for k in (0, 40, 80)]
    for part, k in zip(parts, (0, 40, 80), strict=True):
        assert_allclose(part, whole[k : k + 4], atol=1e-6 * np.abs(whole).max())


def test_a_brdf_that_jumps_with_the_exitant_angle_is_not_interpolated_across_the_jump():
    view = np.array([0.0, 0.0, 1.0])
    normals = seen_from(view, 0.2)
    views = np.broadcast_to(view, normals.shape)

    def jumping(incident, exitant):
        return np.where(exitant[..., 2] > 0.5, 0.3, 0.1) + 0 * incident[..., 2]

    rows = reflection_operator(jumping, normals, views, 3)
    level = np.where(normals @ view > 0.5, 0.3, 0.1)
    assert_allclose(rows, level[:, None] * irradiance_operator(normals, 3), atol=1e-9)
    with pytest.raises(ValueError, match="too abruptly with the exitant angle"):
        reflection_operator(jumping, np.repeat(normals, 4, axis=0), np.repeat(views, 4, axis=0), 3)


def test_a_matte_body_shows_the_irradiance():
    view = np.array([1.0, 0.0, 0.0])
    normals = seen_from(view, 0.1)
    rows = reflection_operator(matte, normals, np.broadcast_to(view, normals.shape), 6)
    assert_allclose(rows, 0.25 * irradiance_operator(normals, 6), atol=1e-10)


def test_frames_are_rotations_with_the_view_in_their_xz_plane():
    view = np.array([0.0, 0.0, 1.0])
    normals = np.concatenate([seen_from(view, 0.1), view[None]])
    frames = view_frames(normals, np.broadcast_to(view, normals.shape))
    assert_allclose(np.swapaxes(frames, 1, 2) @ frames, np.broadcast_to(np.eye(3), frames.shape), atol=1e-14)
    assert_allclose(np.linalg.det(frames), 1, rtol=1e-13)
    assert_allclose(frames[:, :, 2], normals, atol=1e-15)
    local = np.einsum("nkj,k->nj", frames, view)
    assert (local[:, 0] > -1e-15).all()
    assert_allclose(local[:, 1], 0, atol=1e-14)


@pytest.mark.parametrize(
    ("normals", "views", "message"),
    [
        ([[0, 0, 1.0]], [[0, 0, -1.0]], r"views\[0\] is \[0.0, 0.0, -1.0\], from below a surface of normal"),
        ([[0, 0, 1.1]], [[0, 0, 1.0]], r"normals\[0\].*of length 1"),
        ([[0, 0, 1.0]], [[0, np.nan, 1.0]], r"views\[0\].*finite"),
    ],
)
def test_bad_directions_get_a_sentence(normals, views, message: str):
    with pytest.raises(ValueError, match=message):
        reflection_operator(matte, normals, views, 2)

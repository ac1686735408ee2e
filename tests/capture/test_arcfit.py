from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from capture.arc.arcfit import ArcView, fit_arc
from capture.arc.gantry import Arc
from capture.camera import Camera

CAMERA = Camera("RADIAL", [1500.0, 640, 480, -0.1, 0.02], 1280, 960, np.eye(4))
CORNERS = np.stack(np.meshgrid(np.arange(4) * 0.055, np.arange(4) * -0.04, [0.0]), -1).reshape(-1, 3)
# A camera that looks down on the board from an arm, a little askew.
TILT = Rotation.from_euler("xyz", [38, 3, 2], degrees=True).as_matrix()
ARC = Arc([0.09, -0.06, 0.45], [0.02, -0.03, 1], 0.6, [0.3, -1, 0], TILT)


def views_of(
    arc: Arc, angles: np.ndarray, rng: np.random.Generator, noise: float, bias: float = 0
) -> list[ArcView]:
    """Corners as an arc's cameras see them, with noise per corner and a shift common to each photo, in pixels."""
    views = []
    for number, angle in enumerate(angles):
        pose = arc.pose(angle)
        pixels = CAMERA.posed(pose).project(CORNERS)
        assert ((pixels > 0) & (pixels < [1280, 960])).all()
        pixels = pixels + rng.normal(0, noise, pixels.shape) + rng.normal(0, bias, 2)
        # Each photograph's own pose is known roughly, as from its corners alone.
        rough = pose.copy()
        rough[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.003, 3)).as_matrix() @ pose[:3, :3]
        rough[:3, 3] += rng.normal(0, 0.002, 3)
        views.append(ArcView(f"{number}.png", CORNERS, pixels, rough))
    return views


def test_an_arc_without_noise_is_recovered():
    angles = np.radians([0, 10, 20, 30, 40])
    fit = fit_arc(views_of(ARC, angles, np.random.default_rng(0), 0), CAMERA)
    # Convergence of least squares on data without noise.
    assert_allclose(fit.arc.centre, ARC.centre, atol=1e-7, equal_nan=False)
    assert_allclose(fit.arc.axis, ARC.axis, atol=1e-7, equal_nan=False)
    assert_allclose(fit.arc.mount, ARC.mount, atol=1e-7, equal_nan=False)
    assert_allclose(fit.angles, angles, atol=1e-7, equal_nan=False)
    for angle in np.radians([-15, 5, 70]):
        assert_allclose(fit.arc.pose(angle), ARC.pose(angle), atol=1e-6, equal_nan=False)


def test_angles_of_the_gantry_set_the_zero_and_the_sense():
    angles = np.radians([20, 10, 0, -10])
    rng = np.random.default_rng(1)
    fit = fit_arc(views_of(ARC, angles, rng, 0), CAMERA, angles)
    assert_allclose(fit.arc.pose(0.2), ARC.pose(0.2), atol=1e-6, equal_nan=False)
    # A gantry that counts the other way round: the same places, the axis upside down.
    mirrored = fit_arc(views_of(ARC, angles, rng, 0), CAMERA, -angles)
    assert_allclose(mirrored.arc.axis, -ARC.axis, atol=1e-7, equal_nan=False)
    assert_allclose(mirrored.arc.pose(0.2), ARC.pose(-0.2), atol=1e-6, equal_nan=False)


def test_angles_may_pass_half_a_turn_and_come_in_any_order_where_the_gantry_tells_them():
    angles = np.radians([0, 80, 160, 240, 320])
    steep = Arc(ARC.centre, ARC.axis, 0.2, ARC.start, Rotation.from_euler("x", 66, degrees=True).as_matrix())
    rng = np.random.default_rng(3)
    assert_allclose(fit_arc(views_of(steep, angles, rng, 0), CAMERA).angles, angles, atol=1e-7)
    shuffled = angles[[3, 0, 4, 1, 2]]
    fit = fit_arc(views_of(steep, shuffled, rng, 0), CAMERA, shuffled)
    assert_allclose(fit.arc.pose(0.2), steep.pose(0.2), atol=1e-6, equal_nan=False)


def test_a_camera_on_a_turntables_axis_side_is_the_same_as_a_gantry():
    # The board turns by -t before a camera that stands still: seen from the board, the camera travels by t.
    still = ARC.pose(0.0)
    angles = np.radians([0, 15, 30])
    views = []
    for angle in angles:
        turn = Rotation.from_rotvec(-angle * ARC.axis).as_matrix()
        moved = (CORNERS - ARC.centre) @ turn.T + ARC.centre
        pose = still.copy()
        pose[:3, :3] = still[:3, :3] @ turn
        pose[:3, 3] = still[:3, :3] @ (ARC.centre - turn @ ARC.centre) + still[:3, 3]
        views.append(ArcView(f"{angle}", CORNERS, CAMERA.posed(still).project(moved), pose))
    fit = fit_arc(views, CAMERA)
    assert_allclose(fit.arc.pose(0.3), ARC.pose(0.3), atol=1e-6, equal_nan=False)


def test_equal_steps_are_found_and_unequal_ones_are_not_invented():
    rng = np.random.default_rng(2)
    fit = fit_arc(views_of(ARC, np.radians(np.arange(8) * 7.5), rng, 0.1), CAMERA)
    assert fit.arc.step is not None
    assert abs(fit.arc.step - np.radians(7.5)) < 4 * fit.step_std < np.radians(0.1)
    uneven = fit_arc(views_of(ARC, np.radians([0, 7.5, 15, 24, 30]), rng, 0.1), CAMERA)
    assert uneven.arc.step is None


@pytest.mark.parametrize(("noise", "bias"), [(0.2, 0.0), (0.05, 0.2)])
def test_intervals_cover(noise, bias):
    """95% intervals of radius, centre, angles and step, pooled over draws; errors may be common to a photo."""
    angles = np.radians(np.arange(7) * 9)
    z = []
    for seed in range(10):
        fit = fit_arc(views_of(ARC, angles, np.random.default_rng(seed), noise, bias), CAMERA)
        z += [(fit.arc.radius - ARC.radius) / fit.radius_std, *(fit.arc.centre - ARC.centre) / fit.centre_std]
        z += [*((fit.angles - angles) / fit.angle_std.clip(1e-12))[1:]]
        if fit.arc.step is not None:
            z.append((fit.arc.step - angles[1]) / fit.step_std)
    covered = np.mean(np.abs(z) < 1.96)
    # On the safe side by design: what shifts a photo along the arc is inferred from what shifts it across. Some 110
    # numbers, or fewer where they go together, know a share of 95% to 2%.
    assert covered > 0.90
    assert np.std(z) > 0.5


def test_photos_that_determine_no_arc_are_refused():
    rng = np.random.default_rng(4)
    with pytest.raises(ValueError, match="seen in 2 photos; an arc needs 3"):
        fit_arc(views_of(ARC, np.radians([0, 20]), rng, 0.1), CAMERA)
    with pytest.raises(ValueError, match="axis is undetermined"):
        fit_arc(views_of(ARC, np.radians([0, 0.3, 0.6, 0.9]), rng, 0.1), CAMERA)
    with pytest.raises(ValueError, match="3 angles for 4 photos"):
        fit_arc(views_of(ARC, np.radians([0, 10, 20, 30]), rng, 0.1), CAMERA, [0, 1, 2])

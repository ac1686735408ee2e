from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.arc.gantry import Arc, look_at
from capture.camera import ORTHOGRAPHIC, Camera
from capture.decode import decode, read_mask
from recon.locate import View, disk_mask, locate_sphere

PARAMS = [300.0, 300, 80, 60]
CENTRE = (0.01, 0.0, 0.02)
RADIUS = 0.1
FLIP = np.diag([1.0, -1, -1, 1])  # between OpenCV's and OpenGL's camera axes

# What a user wrote instead of world_to_camera, and the words that name it.
MISTAKES = {
    "camera_to_world (OpenCV axes): invert it": np.linalg.inv,
    "world_to_camera with OpenGL axes": lambda pose: FLIP @ pose,
    "camera_to_world with OpenGL or Blender axes": lambda pose: np.linalg.inv(pose) @ FLIP,
}


def arc(count: int, degrees: float) -> list[Camera]:
    angles = np.radians(np.linspace(0, degrees, count))
    poses = [Arc([0.02, 0.01, 0], [0, 0.2, 1], 1.0, [1, 0, 0]).pose(angle) for angle in angles]
    return [Camera("PINHOLE", PARAMS, 160, 120, pose) for pose in poses]


@pytest.fixture
def views(draw, ball):
    sphere = ball(CENTRE, RADIUS)
    return [View(f"{i}.png", camera, draw(sphere, camera, 3)) for i, camera in enumerate(arc(4, 120))]


def repose(views, convert) -> list[View]:
    return [View(v.label, v.camera.posed(convert(v.camera.world_to_camera)), v.coverage) for v in views]


def test_the_sphere_is_found_or_taken_as_given(views):
    found = locate_sphere(views)
    assert_allclose(found.centre, CENTRE, atol=0.03 / 300, equal_nan=False)  # 0.03 px
    assert found.radius == pytest.approx(RADIUS, rel=5e-4)
    given = locate_sphere(views, CENTRE, RADIUS)
    assert (tuple(given.centre), given.radius, given.covariance.any()) == (CENTRE, RADIUS, False)
    # One of the two: the other is fitted.
    assert locate_sphere(views, CENTRE).radius == pytest.approx(RADIUS, rel=5e-4)
    assert_allclose(locate_sphere(views, None, RADIUS).centre, CENTRE, atol=0.03 / 300, equal_nan=False)
    # Photos without a mask don't matter as long as one has a mask, nor where the sphere is given.
    bare = [View(v.label, v.camera, None) for v in views]
    assert_allclose(locate_sphere([*views[:3], bare[3]]).centre, CENTRE, atol=0.03 / 300, equal_nan=False)
    assert locate_sphere(bare, CENTRE, RADIUS).radius == RADIUS


@pytest.mark.parametrize("given", [{}, {"radius": RADIUS}, {"centre": CENTRE, "radius": RADIUS}])
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistaken_convention_is_named(views, mistake, given):
    with pytest.raises(ValueError, match=r"^\d\.png: .*looks? like") as error:
        locate_sphere(repose(views, MISTAKES[mistake]), **given)
    assert mistake in str(error.value)


def test_opengl_axes_are_named_along_a_short_arc_too(draw, ball):
    # Ten degrees of arc: camera_to_world fits nearly as well.
    sphere = ball(CENTRE, RADIUS)
    views = [View(f"{i}.png", camera, draw(sphere, camera, 3)) for i, camera in enumerate(arc(3, 10))]
    with pytest.raises(ValueError, match=r"the poses look like world_to_camera with OpenGL axes"):
        locate_sphere(repose(views, lambda pose: FLIP @ pose))


def test_a_convention_is_named_without_any_mask(views):
    bare = [View(v.label, v.camera, None) for v in repose(views, lambda pose: FLIP @ pose)]
    with pytest.raises(
        ValueError, match=r"^0\.png: .*lies behind the camera.* looks like world_to_camera with"
    ):
        locate_sphere(bare, CENTRE, RADIUS)


def test_one_wrong_photo_is_named_and_no_convention_is_blamed(views):
    other = views[2]
    shifted = np.roll(other.coverage, 25, axis=1)
    mixed = [*views[:2], View(other.label, other.camera, shifted), views[3]]
    with pytest.raises(ValueError, match=r"^2\.png: its mask's outline is .* px .*; check this photo's mask"):
        locate_sphere(mixed)
    with pytest.raises(ValueError, match=r"^2\.png: .* overlap by only \d\d%; check world_to_camera"):
        locate_sphere(mixed, CENTRE, RADIUS)


def test_a_given_sphere_of_the_wrong_size_or_place_is_named(views):
    with pytest.raises(
        ValueError, match=r"^0\.png: the sphere of \[object\] and the mask overlap by only 25%"
    ):
        locate_sphere(views, CENTRE, RADIUS / 2)
    with pytest.raises(
        ValueError, match=r"^0\.png: the sphere of \[object\] projects outside this photograph"
    ):
        locate_sphere(views, (0.0, 0.9, 0.0), RADIUS)
    around = tuple(views[0].camera.centre + 0.01)
    with pytest.raises(ValueError, match=r"^0\.png: .* lies behind the camera \(or around it\)"):
        locate_sphere(views, around, RADIUS)
    # Millimetres where metres are meant: the sphere holds every camera.
    with pytest.raises(ValueError, match=r"^0\.png: .*centre and radius \(metres\)"):
        locate_sphere(views, CENTRE, 1000 * RADIUS)


def test_missing_inverted_and_empty_masks_are_named(views):
    first = views[0]
    with pytest.raises(ValueError, match=r"^0\.png: no mask is given; write mask = '...'.*centre and radius"):
        locate_sphere([View(v.label, v.camera, None) for v in views])
    inverted = [*views[1:], View(first.label, first.camera, 1 - first.coverage)]
    with pytest.raises(ValueError, match=r"^0\.png: its mask covers the image's border; is it inverted\?"):
        locate_sphere(inverted)
    dot = np.zeros_like(first.coverage)
    dot[50:55, 50:55] = 1
    with pytest.raises(ValueError, match=r"^0\.png: its mask marks fewer than 50 pixels"):
        locate_sphere([*views[1:], View(first.label, first.camera, dot)])


def test_a_mask_that_is_no_spheres_is_named():
    camera = Camera(ORTHOGRAPHIC, [], 160, 120, np.eye(4))
    box = np.zeros((120, 160), np.float32)
    box[30:90, 30:130] = 1
    with pytest.raises(ValueError, match=r"^box\.png: its mask's outline is .* px \(RMS\) from the sphere"):
        locate_sphere([View("box.png", camera, box)])


# Photographs without a mask.


def lit_ball(ambient: float) -> np.ndarray:
    """A grey ball at (80, 55), radius 40 px, under one light from the upper left, on a dark background."""
    y, x = (np.mgrid[:120, :160] + 0.5 - np.array([55, 80])[:, None, None]) / 40
    depth = np.sqrt(np.clip(1 - x**2 - y**2, 0, None))
    light = np.array([-0.5, -0.5, 0.7])
    shading = ambient + np.clip(x * light[0] + y * light[1] + depth * light[2], 0, None)
    image = np.where(x**2 + y**2 < 1, shading, 0.01)
    noisy = image + np.random.default_rng(4).normal(0, 0.003, image.shape)
    return np.repeat(noisy[..., None], 3, axis=2).astype(np.float32)


FLAT = Camera(ORTHOGRAPHIC, [], 160, 120, np.eye(4))


def test_a_ball_lit_all_over_is_found_in_its_photograph():
    mask = disk_mask("a.png", FLAT, lit_ball(ambient=0.4))
    y, x = np.mgrid[:120, :160] + 0.5
    disc = (x - 80) ** 2 + (y - 55) ** 2 < 40**2
    # The noise and the threshold may cost the outline's pixels, 250 of 5000, a few of them.
    assert (mask.astype(bool) != disc).sum() < 25
    sphere = locate_sphere([View("a.png", FLAT, mask)])
    assert_allclose(FLAT.project(sphere.centre), [[80, 55]], atol=0.1, equal_nan=False)


@pytest.mark.parametrize(
    "photograph",
    [
        lit_ball(ambient=0.0),  # its dark side is as dark as the background: a crescent
        np.zeros((120, 160, 3), np.float32),
        np.random.default_rng(5).random((120, 160, 3), np.float32),
        np.ones((120, 160, 3), np.float32),
        np.repeat(np.pad(np.ones((50, 90)), ((35, 35), (35, 35)))[..., None], 3, axis=2).astype(np.float32),
    ],
    ids=["half-lit", "black", "noise", "white", "box"],
)
def test_a_photograph_that_shows_no_disk_is_named(photograph):
    with pytest.raises(
        ValueError, match=r"^a\.png: no mask is given and no sphere was found in the photograph"
    ):
        disk_mask("a.png", FLAT, photograph)


def test_the_psm_masks_are_spheres(data_dir):
    camera = Camera(ORTHOGRAPHIC, [], 512, 340, look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]))
    for name in ("gray", "chrome"):
        mask = read_mask(data_dir / "psm" / name / f"{name}.mask.png", (340, 512))
        sphere = locate_sphere([View(name, camera, mask)])
        # The mask is binary: half a pixel at most, 0.29 in the mean, and what drew it wasn't perfect.
        assert sphere.residual_px[0] < 0.6
        # What the photographs show bright is where the sphere is.
        bright = decode(data_dir / "psm" / name / f"{name}.0.png").radiance.mean(axis=2) > 0.5
        assert (mask[bright] > 0).mean() > 0.95

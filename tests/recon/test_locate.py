from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.arc.gantry import Arc, look_at
from capture.camera import ORTHOGRAPHIC, Camera
from capture.decode import read_mask
from recon.placement.conventions import other_conventions
from recon.placement.locate import LocatedPhoto, locate_sphere
from recon.sphere.outline import Silhouette, mask_silhouette

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


def view(label: str, camera: Camera, mask: np.ndarray) -> LocatedPhoto:
    return LocatedPhoto(label, camera, mask_silhouette(mask.astype(np.float32)))


@pytest.fixture
def masks(draw, ball):
    return [draw(ball(CENTRE, RADIUS), camera, 3) for camera in arc(4, 120)]


@pytest.fixture
def views(masks):
    return [
        view(f"{i}.png", camera, mask)
        for i, (camera, mask) in enumerate(zip(arc(4, 120), masks, strict=True))
    ]


def repose(views, convert) -> list[LocatedPhoto]:
    return [
        LocatedPhoto(v.label, v.camera.posed(convert(v.camera.world_to_camera)), v.silhouette) for v in views
    ]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_other_conventions_are_undone_by_name(mistake):
    pose = arc(2, 50)[1].world_to_camera
    named = [undo for name, undo in other_conventions().items() if name.startswith(mistake)]
    assert len(named) == 1
    assert_allclose(named[0](MISTAKES[mistake](pose)), pose, atol=1e-12)


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
    bare = [LocatedPhoto(v.label, v.camera, None) for v in views]
    assert_allclose(locate_sphere([*views[:3], bare[3]]).centre, CENTRE, atol=0.03 / 300, equal_nan=False)
    assert locate_sphere(bare, CENTRE, RADIUS).radius == RADIUS


@pytest.mark.parametrize(
    "given",
    [{}, pytest.param({"radius": RADIUS}, marks=pytest.mark.slow), {"centre": CENTRE, "radius": RADIUS}],
)
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistaken_convention_is_named(views, mistake, given):
    with pytest.raises(ValueError, match=r"^\d\.png: .*looks? like") as error:
        locate_sphere(repose(views, MISTAKES[mistake]), **given)
    assert mistake in str(error.value)


def test_opengl_axes_are_named_along_a_short_arc_too(draw, ball):
    # Ten degrees of arc: camera_to_world fits nearly as well.
    sphere = ball(CENTRE, RADIUS)
    views = [view(f"{i}.png", camera, draw(sphere, camera, 3)) for i, camera in enumerate(arc(3, 10))]
    with pytest.raises(ValueError, match=r"the poses look like world_to_camera with OpenGL axes"):
        locate_sphere(repose(views, lambda pose: FLIP @ pose))


def test_a_convention_is_named_without_any_mask(views):
    bare = [LocatedPhoto(v.label, v.camera, None) for v in repose(views, lambda pose: FLIP @ pose)]
    with pytest.raises(
        ValueError, match=r"^0\.png: .*lies behind the camera.* looks like world_to_camera with"
    ):
        locate_sphere(bare, CENTRE, RADIUS)


def test_one_wrong_photo_is_named_and_no_convention_is_blamed(views, masks):
    other = views[2]
    shifted = np.roll(masks[2], 25, axis=1)
    mixed = [*views[:2], view(other.label, other.camera, shifted), views[3]]
    with pytest.raises(ValueError, match=r"^2\.png: its mask's outline is .* px .*; check this photo's mask"):
        locate_sphere(mixed)
    with pytest.raises(ValueError, match=r"^2\.png: .* overlap by only \d\d%; check world_to_camera"):
        locate_sphere(mixed, CENTRE, RADIUS)
    # An outline that a photograph shows is no mask.
    outline = mask_silhouette(shifted)
    seen = Silhouette(outline.points, 0.1, None, outline.shape)
    with pytest.raises(ValueError, match=r"^2\.png: the object's outline is .* px"):
        locate_sphere([*views[:2], LocatedPhoto(other.label, other.camera, seen), views[3]])


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
    # Too small for the masks by less than contradicts them: outlines tell, here to a third of a pixel's parts.
    assert max(locate_sphere(views, CENTRE, RADIUS).residual_px) < 0.11
    assert min(locate_sphere(views, CENTRE, 0.95 * RADIUS).residual_px) > 1
    inverted = [
        replace(view, silhouette=replace(view.silhouette, packed=~view.silhouette.packed)) for view in views
    ]
    with pytest.raises(ValueError, match=r"^0\.png: .* the mask is inverted"):
        locate_sphere(inverted, CENTRE, RADIUS)
    # Millimetres where metres are meant: the sphere holds every camera.
    with pytest.raises(ValueError, match=r"^0\.png: .*centre and radius \(metres\)"):
        locate_sphere(views, CENTRE, 1000 * RADIUS)


def test_missing_inverted_and_empty_masks_are_named(views, masks):
    first = views[0]
    with pytest.raises(
        ValueError, match=r"^0\.png: no mask .* no sphere was found .*; write mask = '...'.*centre and radius"
    ):
        locate_sphere([LocatedPhoto(v.label, v.camera, None) for v in views])
    inverted = [*views[1:], view(first.label, first.camera, 1 - masks[0])]
    with pytest.raises(ValueError, match=r"^0\.png: its mask covers the image's border; is it inverted\?"):
        locate_sphere(inverted)
    dot = np.zeros_like(masks[0])
    dot[50:55, 50:55] = 1
    with pytest.raises(ValueError, match=r"^0\.png: its mask marks fewer than 50 pixels"):
        locate_sphere([*views[1:], view(first.label, first.camera, dot)])
    full = np.zeros_like(dot)
    full[2:-2, 2:-2] = 1
    with pytest.raises(ValueError, match=r"^0\.png: its mask's outline has fewer than 12 points"):
        locate_sphere([*views[1:], view(first.label, first.camera, full)])


def test_a_mask_that_is_no_spheres_is_named():
    camera = Camera(ORTHOGRAPHIC, [], 160, 120, np.eye(4))
    box = np.zeros((120, 160), np.float32)
    box[30:90, 30:130] = 1
    with pytest.raises(ValueError, match=r"^box\.png: its mask's outline is .* px \(RMS\) from the sphere"):
        locate_sphere([view("box.png", camera, box)])


def test_the_psm_masks_are_spheres(data_dir):
    camera = Camera(ORTHOGRAPHIC, [], 512, 340, look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]))
    for name in ("gray", "chrome"):
        mask = read_mask(data_dir / "psm" / name / f"{name}.mask.png", (340, 512))
        sphere = locate_sphere([view(name, camera, mask)])
        # The mask is binary: half a pixel at most, 0.29 in the mean, and what drew it wasn't perfect.
        assert sphere.residual_px[0] < 0.6

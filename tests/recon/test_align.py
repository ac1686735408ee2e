"""The cat's mesh in its masks: from picks, from a wrong start, from nothing; and when it must not be placed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from capture.arc.gantry import look_at
from capture.camera import ORTHOGRAPHIC, Camera
from recon.mesh.rays import RayTracer
from recon.poses.align.alignmentfile import placement
from recon.poses.align.cloud import CloudMatcher
from recon.poses.align.outlines import outline_of
from recon.poses.align.pixelrays import joined, pixel_rays
from recon.poses.align.placing import place_mesh
from recon.poses.align.task import PickedPoints, Task
from recon.poses.align.uncertainty import in_mesh_metres
from recon.poses.align.verdicts import misfit_px, wrong_size
from recon.poses.similarity import Similarity

WIDTH, HEIGHT, FOCAL = 320, 240, 1050
TRUTH = Similarity(1.0, Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix(), [0.004, -0.003, 0.006])


def camera_at(azimuth_deg: float, elevation_deg: float, model: str = "PINHOLE") -> Camera:
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    across = np.cos(elevation)
    eye = 0.6 * np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])
    params = [FOCAL, FOCAL, 160, 120] if model == "PINHOLE" else [FOCAL / 0.6, 160, 120]
    return Camera(model, params, WIDTH, HEIGHT, look_at(eye, np.zeros(3), np.array([0.0, 0, 1])))


SIX_CAMERAS = [camera_at(60 * i, 15 if i % 2 else 5) for i in range(6)]
# Most need no more.
CAMERAS = SIX_CAMERAS[:4]


def drawn(tracer: RayTracer, place: Similarity, camera: Camera, n: int = 4) -> np.ndarray:
    """Coverage (h, w) of each pixel by a mesh, from n x n rays within it; none where the mesh isn't."""
    body = RayTracer(place.apply(tracer.vertices), tracer.faces)
    seen = camera.project(body.vertices)
    left, top = np.floor(np.clip(seen.min(axis=0), 0, [WIDTH, HEIGHT])).astype(int)
    right, bottom = np.ceil(np.clip(seen.max(axis=0), 0, [WIDTH, HEIGHT])).astype(int)
    steps = (np.arange(n) + 0.5) / n
    x, y = ((np.arange(*ends)[:, None] + steps).ravel() for ends in ((left, right), (top, bottom)))
    origins, directions = camera.rays(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    starts = origins - directions if camera.is_orthographic else origins
    hit = body.met(starts, directions).reshape(bottom - top, n, right - left, n)
    coverage = np.zeros((HEIGHT, WIDTH), np.float32)
    coverage[top:bottom, left:right] = hit.mean(axis=(1, 3), dtype=np.float32)
    return coverage


@pytest.fixture(scope="module")
def cat(cat_mesh) -> RayTracer:
    return RayTracer(cat_mesh.vertices, cat_mesh.faces)


@pytest.fixture(scope="module")
def masks(cat) -> list[np.ndarray]:
    return [drawn(cat, TRUTH, camera) for camera in SIX_CAMERAS]


@pytest.fixture(scope="module")
def task(cat, masks) -> Task:
    return task_of(cat, CAMERAS, masks[:4])


def task_of(tracer: RayTracer, cameras: list[Camera], masks: list[np.ndarray], metric: bool = True) -> Task:
    outlines = [outline_of(camera, mask) for camera, mask in zip(cameras, masks, strict=True)]
    return Task(tracer, "m", outlines, [f"{i}.png" for i in range(len(cameras))], metric, free_scale=False)


def start_off(tracer: RayTracer, degrees: float, growth: float, seed: int) -> Similarity:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    turn = np.radians(degrees) * axis / np.linalg.norm(axis)
    step = np.concatenate([turn, 0.002 * rng.normal(size=3), [growth * rng.choice([-1, 1])]])
    return TRUTH.moved(step, TRUTH.apply(tracer.centre[None])[0])


def picks_of(tracer: RayTracer, count: int, noise: float, seed: int, cameras: list[Camera]) -> PickedPoints:
    rng = np.random.default_rng(seed)
    points = tracer.vertices[rng.integers(len(tracer.vertices), size=count)]
    rays = []
    for index, point in enumerate(TRUTH.apply(points)):
        camera = cameras[index % len(cameras)]
        rays.append(pixel_rays(camera, camera.project(point[None]) + noise * rng.normal(size=(1, 2))))
    return PickedPoints(joined(rays), points, FOCAL, [f"pick {i}" for i in range(count)])


def moved_worlds(cameras: list[Camera], scale: float) -> list[Camera]:
    """The same pictures from a world `scale` times as large."""
    scaled = []
    for camera in cameras:
        pose = camera.world_to_camera.copy()
        pose[:3, 3] *= scale
        scaled.append(camera.posed(pose))
    return scaled


def test_from_six_picks_with_a_pixel_of_noise_silhouettes_agree_to_half_a_pixel(task, cat):
    found = place_mesh(replace(task, picks=picks_of(cat, 6, 1.0, 0, CAMERAS)))
    assert misfit_px(found.refined) < 0.06  # 4 x 4 rays in a pixel; half a pixel is asked
    assert np.degrees(found.place.angle_to(TRUTH)) < 0.05
    assert found.place.scale == 1
    assert np.linalg.det(found.place.rotation) == pytest.approx(1)


def test_picks_in_one_photo_place_it_in_a_world_whose_size_the_other_photos_tell(cat, masks):
    cameras = moved_worlds(CAMERAS, 250.0)
    relative = task_of(cat, cameras, masks[:4], metric=False)
    world = Similarity(250.0, TRUTH.rotation, 250 * TRUTH.translation)
    points = cat.vertices[np.random.default_rng(3).integers(len(cat.vertices), size=6)]
    rays = pixel_rays(cameras[1], cameras[1].project(world.apply(points)))
    found = place_mesh(replace(relative, picks=PickedPoints(rays, points, FOCAL, ["pick"] * 6)))
    assert np.degrees(found.place.angle_to(TRUTH)) < 0.02
    assert found.place.scale == pytest.approx(250, rel=2e-4)


def test_from_ten_degrees_and_five_percent_it_converges(task, cat):
    found = place_mesh(replace(task, start=start_off(cat, 10, 0.05, 0), free_scale=True))
    assert np.degrees(found.place.angle_to(TRUTH)) < 0.02
    assert found.place.scale == pytest.approx(1, abs=2e-4)
    assert misfit_px(found.refined) < 0.06


@pytest.mark.slow
def test_from_far_it_converges_or_says_that_it_did_not(task, cat):
    outcomes = []
    for seed in (0, 2):
        try:
            found = place_mesh(replace(task, start=start_off(cat, 20 + 60 * seed, 0.05, seed)))
        except ValueError as error:
            assert "did not find its place" in str(error)  # noqa: PT017
            outcomes.append(False)
        else:
            assert np.degrees(found.place.angle_to(TRUTH)) < 0.02
            outcomes.append(True)
    assert outcomes[0]
    assert not all(outcomes)


def test_from_nothing_in_a_world_of_any_size(cat, masks):
    world = 250.0
    found = place_mesh(task_of(cat, moved_worlds(CAMERAS, world), masks[:4], metric=False))
    mesh_to_world, world_scale = placement(found.place)
    assert world_scale == pytest.approx(1 / world, rel=2e-4)
    expected = np.eye(4)
    expected[:3, :3], expected[:3, 3] = TRUTH.rotation, TRUTH.translation
    # 0.02 degrees of 0.06 m, and of a turn.
    assert_allclose(mesh_to_world, expected, atol=4e-4)


def test_orthographic_views_place_it_but_for_the_depth(cat):
    through_it = camera_at(20, 10, ORTHOGRAPHIC).world_to_camera.copy()
    through_it[2, 3] = 0  # parallel rays have no beginning: the camera's plane may cut the object
    cameras = [camera_at(20, 10, ORTHOGRAPHIC).posed(through_it)]
    masks = [drawn(cat, TRUTH, camera) for camera in cameras]
    found = place_mesh(task_of(cat, cameras, masks))
    assert np.degrees(found.place.angle_to(TRUTH)) < 0.05
    shift = found.place.apply(cat.centre[None])[0] - TRUTH.apply(cat.centre[None])[0]
    across = shift - (shift @ cameras[0].world_to_camera[2, :3]) * cameras[0].world_to_camera[2, :3]
    assert_allclose(across, 0, atol=2e-5)
    assert any("depth can't be determined" in warning for warning in found.warnings)


def test_one_perspective_view_leaves_the_world_s_size_open(cat, masks):
    found = place_mesh(task_of(cat, CAMERAS[:1], masks[:1], metric=False))
    assert not found.scale_known
    assert found.place.scale == 1
    assert any("all cameras see from one place" in warning for warning in found.warnings)


def test_another_unit_is_named(cat, task):
    large = RayTracer(cat.vertices * 1000, cat.faces)
    with pytest.raises(ValueError, match=r"fits its masks if it is 0\.001 times as large.*'mm'"):
        place_mesh(replace(task, tracer=large))
    assert "'cm'" in wrong_size(0.01, "m")
    assert "inches" in wrong_size(0.0254, "m")


def test_a_mesh_two_percent_too_large_is_placed_and_named(cat, task):
    large = RayTracer(cat.vertices * 1.02, cat.faces)
    found = place_mesh(replace(task, tracer=large, start=TRUTH))
    assert any("0.9804 times as large" in warning for warning in found.warnings)
    free = place_mesh(replace(task, tracer=large, start=TRUTH, free_scale=True))
    assert free.place.scale == pytest.approx(1 / 1.02, rel=2e-4)


def test_a_photo_that_contradicts_the_others_is_left_out_and_named(cat, masks):
    wrong = [*masks[:2], np.roll(masks[2], 25, axis=1), *masks[3:5]]
    found = place_mesh(task_of(cat, SIX_CAMERAS[:5], wrong))
    assert found.left_out == ("2.png",)
    assert np.degrees(found.place.angle_to(TRUTH)) < 0.03
    assert any(warning.startswith("2.png is left out") for warning in found.warnings)


def test_opengl_axes_are_named(cat, masks):
    flip = np.diag([1.0, -1, -1, 1])
    flipped = [camera.posed(flip @ camera.world_to_camera) for camera in CAMERAS[:3]]
    with pytest.raises(ValueError, match=r"poses look like .*OpenGL axes"):
        place_mesh(task_of(cat, flipped, masks[:3]))


def test_symmetric_bodies_are_not_placed_by_silhouettes_alone_but_by_picks():
    profile = [[0, -0.05], [0.02, -0.05], [0.03, 0], [0.012, 0.02], [0.02, 0.05], [0, 0.05]]
    # Of few sections it would be a prism, whose edges tell.
    turned = trimesh.creation.revolve(profile, sections=128)
    vase = RayTracer(np.asarray(turned.vertices), np.asarray(turned.faces))
    masks = [drawn(vase, TRUTH, camera, 3) for camera in CAMERAS[:2]]
    task = task_of(vase, CAMERAS[:2], masks)
    with pytest.raises(ValueError, match=r"turned about its axis \(-?0.00, -?0.00, -?1.00\), as on a vase"):
        place_mesh(task)
    found = place_mesh(replace(task, picks=picks_of(vase, 8, 1.0, 1, CAMERAS[:2])))
    # A pixel at 0.02 m is 1.6 degrees, and eight picks share it.
    assert np.degrees(found.place.angle_to(TRUTH)) < 2
    body = trimesh.creation.box((0.05, 0.04, 0.06))
    brick = RayTracer(np.asarray(body.vertices), np.asarray(body.faces))
    masks = [drawn(brick, TRUTH, camera, 3) for camera in CAMERAS[:2]]
    with pytest.raises(ValueError, match="two orientations of the mesh that are 180 degrees apart"):
        place_mesh(task_of(brick, CAMERAS[:2], masks))


@pytest.mark.slow
def test_a_cloud_alone_places_it_roughly_in_a_world_of_any_size(cat):
    rng = np.random.default_rng(2)
    surface = trimesh.Trimesh(cat.vertices, cat.faces, process=False)
    seen = np.asarray(trimesh.sample.sample_surface(surface, 600, seed=3)[0])
    seen = seen[seen @ [1, 0.2, 0.3] > -0.02] + 0.0003 * rng.normal(size=(1, 3))
    world = Similarity(40.0, TRUTH.rotation, 40 * TRUTH.translation)
    background = world.apply(rng.uniform(-0.15, 0.15, (100, 3)))
    cloud = CloudMatcher(cat.vertices, cat.faces, np.concatenate([world.apply(seen), background]))
    found = place_mesh(Task(cat, "m", [], [], metric=False, free_scale=False, cloud=cloud))
    assert np.degrees(found.place.angle_to(TRUTH)) < 0.5
    assert found.place.scale == pytest.approx(40, rel=0.01)
    strewn = CloudMatcher(cat.vertices, cat.faces, rng.uniform(-1, 1, (250, 3)))
    with pytest.raises(ValueError, match="the cloud of points doesn't fit the mesh"):
        place_mesh(Task(cat, "m", [], [], metric=False, free_scale=False, cloud=strewn))
    with pytest.raises(ValueError, match="there is nothing to align the mesh by"):
        place_mesh(Task(cat, "m", [], [], metric=True, free_scale=False))


def assert_errors_are_as_stated(scores: list[np.ndarray]) -> None:
    """Errors over standard deviations, of 8 draws, have an RMS of 1, together and each parameter's."""
    square = np.mean(np.square(scores), axis=0)
    # 8 draws of seven numbers, some of which go together, know the RMS of all to about 15%, one's to 25%.
    assert np.sqrt(square.mean()) == pytest.approx(1, abs=0.4)
    assert (np.abs(np.log(square) / 2) < np.log(2.2)).all(), np.sqrt(square)


def test_error_bars_cover_when_masks_are_drawn_by_a_shaky_hand(cat, masks):
    """Errors over standard deviations where outlines waver by 0.3 px over some 20 px, 8 draws."""
    scores = []
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        wavered = []
        for mask in masks[:3]:
            field = gaussian_filter(rng.normal(size=(2, *mask.shape)), (0, 8, 8))
            field *= 0.3 / field.std()
            wavered.append(map_coordinates(mask, [y + field[0], x + field[1]], order=1).astype(np.float32))
        noisy = task_of(cat, CAMERAS[:3], wavered, metric=False)
        found = place_mesh(replace(noisy, start=TRUTH))
        error = np.concatenate(
            [
                Rotation.from_matrix(found.place.rotation @ TRUTH.rotation.T).as_rotvec(),
                found.pivot - TRUTH.apply(cat.centre[None])[0],
                [np.log(found.place.scale)],
            ]
        )
        scores.append(error / np.sqrt(np.diag(found.uncertain.covariance)))
    assert_errors_are_as_stated(scores)


@pytest.mark.sweep
def test_error_bars_cover_when_poses_shift_whole_photographs(cat, masks):
    """Errors over standard deviations where every photograph is shifted by 0.7 px, 8 draws."""
    scores = []
    task = task_of(cat, SIX_CAMERAS, masks)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        shifted = [replace(o, points=o.points + 0.7 * rng.normal(size=2)) for o in task.outlines]
        found = place_mesh(replace(task, outlines=shifted, start=TRUTH))
        turn = Rotation.from_matrix(found.place.rotation @ TRUTH.rotation.T).as_rotvec()
        error = np.concatenate([turn, found.pivot - TRUTH.apply(task.tracer.centre[None])[0]])
        scores.append(error / np.sqrt(np.diag(found.uncertain.covariance)[:6]))
    # Each draw's error bars rest on what six photos leave: 12 coordinates less 7 parameters.
    assert_errors_are_as_stated(scores)


def test_the_covariance_moves_to_the_scaled_world_as_the_places_do():
    rng = np.random.default_rng(4)
    place, pivot = Similarity(3.0, TRUTH.rotation, [0.4, -0.2, 0.7]), np.array([0.5, -0.1, 0.6])
    step = 1e-6
    columns = []
    base, base_scale = placement(place)
    for index in range(7):
        moved, scale = placement(place.moved(step * np.eye(7)[index], pivot))
        change = moved @ np.linalg.inv(base)
        turn = Rotation.from_matrix(change[:3, :3]).as_rotvec()
        columns.append(np.concatenate([turn, change[:3, 3], [np.log(scale / base_scale)]]) / step)
    mixing = rng.normal(size=(7, 7))
    covariance = mixing @ mixing.T
    expected = np.array(columns).T @ covariance @ np.array(columns)
    assert_allclose(in_mesh_metres(covariance, place, pivot), expected, rtol=1e-3, atol=1e-4)

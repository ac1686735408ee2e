"""Poses read off pixels: a painted ball seen by rays of its own, and a set whose poses are wrong, end to end."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from capture.arc.gantry import Arc
from capture.camera import Camera
from capture.photoset import load_photoset
from capture.radiance import RadianceImage
from invrender.estimate.noise import NoiseModel
from invrender.estimate.textured.layout import SurfacePoints
from invrender.refine.alternate import _in_patches
from invrender.refine.photometric import PoseTarget, RefinedPose, refine_pose
from invrender.refine.posechange import changed, pose_covariance, position_std
from invrender.refine.rim import outline_in
from invrender.refine.shared import refine_together
from invrender.refine.surface_tracking import Lobe, followed_in
from recon.mesh.bodies import MeshBody
from recon.mesh.trianglemesh import TriangleMesh, smooth_normals, write_mesh
from recon.sampling.draw import NO_SOURCES, sample_body
from recon.sampling.lightfield import LightField
from recon.sphere.sphere import Sphere
from synthetic.scenes.build import read_staging
from synthetic.writer import write_photoset

Floats = NDArray[np.float64]
Command = Callable[..., tuple[int, str, str]]

CENTRE, RADIUS = np.array([0.01, -0.02, 0.005]), 0.03
UNITS = np.repeat([np.radians(1.0), 0.6e-3], 3)
NOISE = NoiseModel(1e-3, 0.01)
SUB = 4


def directions(positions: Floats) -> Floats:
    """From the ball's centre, (n, 3): a mesh's facets lie a little within the ball."""
    across = positions - CENTRE
    return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True).clip(1e-12))


def stripes(positions: Floats) -> Floats:
    """Paint (n, 3) that changes in all directions, in about ten pixels."""
    x, y, z = directions(positions).T
    return 1 + 0.5 * np.sin(np.column_stack([9 * x + 4 * y, 9 * y - 5 * z, 9 * z]))


def rings(positions: Floats) -> Floats:
    """Paint (n, 3) that doesn't change about the vertical axis."""
    return 1 + 0.5 * np.sin(directions(positions)[:, 2:] * [9, 7, 11] + [0, 1, 2])


def grey(positions: Floats) -> Floats:
    """Paint (n, 3) that doesn't change at all."""
    return np.ones_like(positions)


def ball_picture(camera: Camera, paint: Callable[[Floats], Floats]) -> Floats:
    """A painted ball as a camera shows it, (100, 120, 3): rays, 16 a pixel, meet the sphere itself, not a mesh."""
    rows, columns = np.mgrid[: 100 * SUB, : 120 * SUB]
    pixels = (np.column_stack([columns.ravel(), rows.ravel()]) + 0.5) / SUB
    hit, normals = Sphere(CENTRE, RADIUS, np.zeros((4, 4))).hits(*camera.rays(pixels))
    picture = np.where(hit[:, None], paint(CENTRE + RADIUS * normals), 0)
    return np.asarray(picture.reshape(100, SUB, 120, SUB, 3).mean(axis=(1, 3)))


def ball_photo(camera: Camera, paint: Callable[[Floats], Floats], rng: np.random.Generator) -> RadianceImage:
    """The same with noise."""
    picture = ball_picture(camera, paint)
    picture += np.sqrt(NOISE.variance(picture)) * rng.standard_normal(picture.shape)
    radiance = picture.astype(np.float32)
    return RadianceImage(radiance, np.zeros_like(radiance), np.zeros((100, 120), bool))


@cache
def ball_body() -> MeshBody:
    ball = trimesh.creation.icosphere(subdivisions=5)
    # Facets lie within the sphere of their corners: these are put as far outside as their mean lies inside.
    radius = RADIUS / np.linalg.norm(ball.vertices[ball.faces].mean(axis=1), axis=1).mean() ** 0.75
    return MeshBody(TriangleMesh(CENTRE + radius * ball.vertices, ball.faces, ball.vertices))


def camera_at(azimuth: float) -> Camera:
    pose = Arc(CENTRE, [0, 0, 1], 0.6, [1, 0, 0]).pose(azimuth)
    return Camera("PINHOLE", np.array([900.0, 900.0, 60.0, 50.0]), 120, 100, pose)


def refined(
    paint: Callable[[Floats], Floats], change: Floats, rng: np.random.Generator, masked: bool = False
) -> RefinedPose:
    """What is found where a painted ball was photographed after a change (6,) in units of the pose."""
    camera = camera_at(0.4)
    seen_from = changed(camera, CENTRE, change * UNITS)
    image, body = ball_photo(seen_from, paint, rng), ball_body()
    field = sample_body(body, camera, image, None, NO_SOURCES, None, rng)

    def seen(field: LightField) -> Floats:
        return np.asarray(field.mean_over_rays(paint(field.positions)))

    coverage = ball_picture(seen_from, grey)[..., 0].astype(np.float32)
    outline = outline_in(camera, coverage if masked else None)
    sight = PoseTarget(
        camera, CENTRE, UNITS, body, field.rows, field.columns, field.radiance, seen, NOISE, outline
    )
    return refine_pose(sight, np.zeros(6))


def test_a_pose_comes_back_to_within_its_error_bars() -> None:
    rng = np.random.default_rng(5)
    deviations = []
    for _ in range(3):
        truth = rng.standard_normal(6)
        found = refined(stripes, truth, rng)
        std = np.sqrt(np.diag(found.covariance))
        assert found.error_after < found.error_before / 2
        # Degrees and shifts of 0.6 mm (0.9 px); the distance, last, is told by the size of the pattern alone.
        assert (std < [0.1, 0.1, 0.1, 0.1, 0.1, 0.8]).all(), std
        deviations.append((found.change - truth) / std)
    # 18 numbers: their mean square is 1 but for 0.3.
    assert 0.3 < np.mean(np.square(deviations)) < 2.2


def test_what_the_paint_does_not_tell_stays_as_it_was() -> None:
    truth = np.array([0.5, 0.0, -0.5, 0.4, -0.4, 0.0])
    # About the vertical axis, which in the camera's frame is -y.
    truth[1] = 1.0
    found = refined(rings, truth, np.random.default_rng(3))
    std = np.sqrt(np.diag(found.covariance))
    assert abs(found.change[1]) < 0.3
    assert std[1] == pytest.approx(1, abs=0.1)
    others = [0, 2, 4]
    assert (np.abs(found.change - truth)[others] < 4 * std[others] + 0.02).all()


def test_an_outline_tells_the_shift_of_what_has_no_paint() -> None:
    truth = np.array([0.3, -0.4, 0.2, 1.2, -0.8, 0.0])
    found = refined(grey, truth, np.random.default_rng(4), masked=True)
    std = np.sqrt(np.diag(found.covariance))
    # Its size is told but for how large the mask is drawn; a ball's turns by nothing.
    assert (std[3:5] < 0.1).all(), std
    assert (np.abs(found.change - truth)[3:5] < 4 * std[3:5]).all(), (found.change, std)
    # Facets seem to say a little of turns.
    assert std[[0, 1, 2, 5]] == pytest.approx(1, abs=0.2)
    assert (np.abs(found.change[:3]) < 0.1).all()


def test_photographs_that_share_their_paint_come_back_together(rng: np.random.Generator) -> None:
    given = [camera_at(azimuth) for azimuth in np.radians([-45, -15, 15, 45])]
    truth = rng.standard_normal((4, 6)) * [1.5, 1.5, 1.5, 0.7, 0.7, 0.1]
    body, photos = ball_body(), []
    at = body.mesh.vertices[::3]
    points = SurfacePoints(at, directions(at), directions(at))
    for camera, change in zip(given, truth, strict=True):
        image = ball_photo(changed(camera, CENTRE, change * UNITS), stripes, rng)
        field = sample_body(body, camera, image, None, NO_SOURCES, None, rng)

        def predicted(field: LightField) -> Floats:
            return np.asarray(field.mean_over_rays(stripes(field.positions)))

        def matte(field: LightField) -> tuple[Floats, Floats]:
            return np.ones((len(field), 3)), np.zeros((len(field), 3))

        pixels = field.rows, field.columns, field.radiance
        sight = PoseTarget(camera, CENTRE, UNITS, body, *pixels, predicted, NOISE)
        photos.append(followed_in(sight, image, camera, field, points, matte, Lobe(np.zeros(3), False)))
    found = refine_together(photos, np.zeros((4, 6)))

    def turns(changes: Floats) -> Floats:
        """Of the ball against all photographs' mean, degrees, (4, 3): a turn that they share moves the paint along."""
        own = [camera.world_to_camera[:3, :3] for camera in given]
        world = np.array([turn.T @ change[:3] for turn, change in zip(own, changes, strict=True)])
        return np.asarray(world - world.mean(axis=0))

    off = turns(np.array([pose.change for pose in found]) - truth)
    assert np.sqrt((turns(truth) ** 2).sum(axis=1).mean()) > 1
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.1
    for pose in found:
        # What they share is known as it was given: by four photographs, to one degree each.
        assert np.sqrt(np.diag(pose.covariance))[:3] == pytest.approx(0.5, abs=0.05)
        # The noise is 1%; beforehand it is 6%.
        assert pose.error_after < 0.01


def test_covariances_are_of_the_pose_as_it_is_written(rng: np.random.Generator) -> None:
    camera = camera_at(1.0)
    half = 1e-4 * rng.standard_normal((6, 6))
    written, places = [], []
    for change in (half @ rng.standard_normal((6, 4000))).T:
        moved = changed(camera, CENTRE, change)
        turn = Rotation.from_matrix(
            moved.world_to_camera[:3, :3] @ camera.world_to_camera[:3, :3].T
        ).as_rotvec()
        written.append(np.concatenate([turn, (moved.world_to_camera - camera.world_to_camera)[:3, 3]]))
        places.append(moved.centre - camera.centre)
    covariance = pose_covariance(camera, CENTRE, half @ half.T)
    drawn = np.cov(np.array(written).T)
    scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    # 4000 draws tell a covariance to 2%.
    assert np.abs((drawn - covariance) / scale).max() < 0.1
    assert position_std(camera, covariance) == pytest.approx(
        np.sqrt(np.square(places).sum(axis=1).mean()), rel=0.05
    )


def test_poses_of_large_photographs_take_little_memory() -> None:
    camera = Camera(
        "PINHOLE", np.array([30_000.0, 30_000.0, 2000.0, 1500.0]), 4000, 3000, camera_at(0).world_to_camera
    )
    rows, columns = (part.ravel() for part in np.mgrid[1400:1430, 1900:1930])
    observed = np.ones((len(rows), 3))

    def seen(field: LightField) -> Floats:
        return np.asarray(field.mean_over_rays(stripes(field.positions)))

    sight = PoseTarget(camera, CENTRE, UNITS, ball_body(), rows, columns, observed, seen, NOISE)
    tracemalloc.start()
    shown, slopes = sight.slopes(np.zeros(6))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.isfinite(shown).all()
    assert np.isfinite(slopes).all()
    # A picture of the photograph's size, in single precision, takes 144.
    assert peak < 10e6


def test_of_a_large_photograph_patches_on_the_body_are_looked_at(rng: np.random.Generator) -> None:
    pose = camera_at(0).world_to_camera
    body, params = ball_body(), np.array([30_000.0, 30_000.0, 2000.0, 1500.0])
    small, large = camera_at(0), Camera("PINHOLE", params, 4000, 3000, pose)
    black = RadianceImage.black(100, 120)
    assert _in_patches(black, body, small, rng) is black
    seen = ~_in_patches(RadianceImage.black(3000, 4000), body, large, rng).saturated
    rows, columns = np.nonzero(seen)
    # Eight times what is compared, where the ball is: 1500 pixels in radius, less than a patch beyond.
    assert len(rows) == pytest.approx(8 * 8000, rel=0.01)
    assert (
        np.hypot(*(large.project(CENTRE[None])[0] - np.column_stack([columns, rows])).T).max()
        < 1500 + 24 * 2**0.5
    )
    # All over it.
    assert np.ptp(rows) > 2000
    assert np.ptp(columns) > 2000


EGG = """
format = 1
name = "egg"
object = { shape = "mesh", mesh = "egg.ply" }
material = { model = "lambertian", kd = [0.2, 0.15, 0.1] }
camera = { width = 48, height = 44, focal_px = 312 }
render = { directions = 64, per_side = 2 }
faults = { pose_deg = 1.5 }

[[lighting]]
directional = [
    { azimuth_deg = -50, elevation_deg = 30, irradiance = [1.2, 0.3, 0.1] },
    { azimuth_deg = 40, elevation_deg = 50, irradiance = [0.1, 0.75, 0.2] },
    { azimuth_deg = 10, elevation_deg = -30, irradiance = [0.1, 0.2, 0.8] },
]

[[view]]
azimuth_deg = -35
elevation_deg = 15
[[view]]
azimuth_deg = 30
elevation_deg = 25
[[view]]
azimuth_deg = 0
elevation_deg = 0
"""


def write_egg_set(folder: Path) -> Path:
    """A photo set of the egg in a folder, whose poses are off; where it is."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices = ball.vertices * [0.02, 0.03, 0.025]
    write_mesh(folder / "egg.ply", TriangleMesh(vertices, ball.faces, smooth_normals(vertices, ball.faces)))
    (folder / "egg.toml").write_text(EGG)
    write_photoset(read_staging(folder / "egg.toml"), folder / "set")
    return folder / "set"


def test_command_refines_a_set_and_writes_poses_that_it_can_use(
    lightfactor: Command, tmp_path: Path, few_forms: None, no_causes: None
) -> None:
    folder = write_egg_set(tmp_path)
    code, out, err = lightfactor("refine", folder, "--samples", 1000, "--turn-deg", 1.5)
    assert (code, err) == (0, "")
    assert 'poses = "refined-poses.json"' in out
    manifest = folder / "photoset.toml"
    given = load_photoset(folder)
    manifest.write_text('poses = "refined-poses.json"\n' + manifest.read_text())
    truths = json.loads((folder / "truth.json").read_text())["photos"]
    off = [
        [
            np.degrees(
                np.linalg.norm(
                    Rotation.from_matrix(
                        photo.camera.world_to_camera[:3, :3] @ np.array(truth["world_to_camera"])[:3, :3].T
                    ).as_rotvec()
                )
            )
            for photo, truth in zip(photoset.photos, truths, strict=True)
        ]
        for photoset in (given, load_photoset(folder))
    ]
    assert np.mean(off[1]) < np.mean(off[0]) / 4
    code, _, err = lightfactor("refine", folder)
    assert code == 1
    assert "is what refining made" in err


def test_spheres_are_refused(lightfactor: Command, lamp_set: Path) -> None:
    code, _, err = lightfactor("refine", lamp_set)
    assert code == 1
    assert "[object] shape is 'sphere'" in err

"""Places from picks alone: exact ones, wrong ones, and files that people write."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from capture.arc.gantry import look_at
from capture.camera import ORTHOGRAPHIC, Camera
from recon.mesh.rays import RayTracer
from recon.poses.align.absolute import fit_picks
from recon.poses.align.picks import check_on_surface, read_picks
from recon.poses.align.pixelrays import joined, pixel_rays
from recon.poses.align.refine import PickedRays, refine
from recon.poses.align.uncertainty import uncertainty
from recon.poses.similarity import Similarity

FOCAL = 1000.0


def cameras(count: int, world: float = 1.0, model: str = "PINHOLE") -> list[Camera]:
    """Around the origin, 0.6 away in a world of size 1."""
    params = [FOCAL, FOCAL, 160, 120] if model == "PINHOLE" else [1600 / world, 160, 120]
    poses = []
    for turn in 2 * np.pi * np.arange(count) / count:
        eye = 0.6 * world * np.array([np.cos(turn), np.sin(turn), 0.3])
        poses.append(look_at(eye, np.zeros(3), np.array([0.0, 0, 1])))
    return [Camera(model, params, 320, 240, pose) for pose in poses]


def truth(seed: int, world: float = 1.0) -> Similarity:
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=rng).as_matrix()
    return Similarity(world, rotation, world * rng.uniform(-0.01, 0.01, 3))


def picked(
    views: list[Camera], points: np.ndarray, place: Similarity, noise: float, rng: np.random.Generator
):
    """Rays through where points are seen, one camera after the other."""
    world = place.apply(points)
    rays = []
    for index, point in enumerate(world):
        camera = views[index % len(views)]
        rays.append(pixel_rays(camera, camera.project(point[None]) + noise * rng.normal(size=(1, 2))))
    return joined(rays)


def points_of(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-0.05, 0.05, (count, 3))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    ("views", "count", "free", "world"),
    [
        (cameras(4), 4, True, 1.0),
        (cameras(4, 70.0), 5, True, 70.0),
        (cameras(4, 0.003), 5, True, 0.003),
        (cameras(1), 6, False, 1.0),
        (cameras(3, model=ORTHOGRAPHIC), 5, True, 1.0),
    ],
    ids=["four picks", "large world", "small world", "one photo", "orthographic"],
)
def test_exact_picks_give_the_place_from_any_orientation_and_no_guess(views, count, free, world, seed):
    rng, place = np.random.default_rng(seed), truth(seed, world)
    points = points_of(count, rng)
    fit = fit_picks(picked(views, points, place, 0, rng), points, free, FOCAL)
    assert fit.kept.all()
    # Four picks allow a second place now and then: the truth is among those that are handed on.
    best = min(fit.places, key=place.angle_to)
    assert place.angle_to(best) < 1e-5
    # The lens model's rays are good to 1e-5 px of 1000.
    assert_allclose(best.apply(points), place.apply(points), atol=1e-6 * world)
    assert np.linalg.det(best.rotation) == pytest.approx(1)


def test_flat_picks_do_and_picks_on_a_line_do_not():
    rng, place = np.random.default_rng(3), truth(3)
    flat = points_of(6, rng) * [1, 1, 0]
    fit = fit_picks(picked(cameras(3), flat, place, 0, rng), flat, True, FOCAL)
    assert place.angle_to(fit.places[0]) < 1e-5
    line = np.linspace(-1, 1, 6)[:, None] * [0.03, 0.01, 0.04]
    with pytest.raises(ValueError, match="all picks lie on a line"):
        fit_picks(picked(cameras(3), line, place, 0, rng), line, True, FOCAL)
    with pytest.raises(ValueError, match="3 different points are picked; at least 4"):
        fit_picks(picked(cameras(3), flat[[0, 1, 2, 2]], place, 0, rng), flat[[0, 1, 2, 2]], True, FOCAL)


@pytest.mark.parametrize("views", [cameras(4), cameras(1)], ids=["several photos", "one photo"])
def test_one_wrong_pick_of_eight_is_found_and_named(views):
    rng, place = np.random.default_rng(5), truth(5)
    points = points_of(8, rng)
    rays = picked(views, points, place, 1.0, rng)
    wrong = points.copy()
    wrong[5] = points[5] + [0.02, -0.015, 0.01]  # 30 px and more
    fit = fit_picks(rays, wrong, len(views) > 1, FOCAL)
    assert np.flatnonzero(~fit.kept).tolist() == [5]
    assert fit.residuals[5] > 15
    assert np.degrees(place.angle_to(fit.places[0])) < 4


def test_a_mirrored_mesh_is_never_fitted_but_named():
    for seed in range(3):
        rng, place = np.random.default_rng(seed), truth(seed)
        points = points_of(8, rng)
        rays = picked(cameras(4), points, place, 1.0, rng)
        for mirrored in (points[:, [1, 0, 2]], points * [1, -1, 1]):
            with pytest.raises(ValueError, match="the picks look mirrored"):
                fit_picks(rays, mirrored, True, FOCAL)


def test_picks_that_contradict_each_other_are_refused():
    rng, place = np.random.default_rng(8), truth(8)
    points = points_of(8, rng)
    with pytest.raises(
        ValueError, match=r"the picks don't agree: the best place leaves one of them .* px off"
    ):
        fit_picks(picked(cameras(4), points, place, 1, rng), points_of(8, rng), True, FOCAL)


def test_error_bars_of_picks_cover():
    """Errors over standard deviations, 60 draws of noise: each of the seven is one on average."""
    body = trimesh.creation.icosphere(2, 0.05)
    tracer = RayTracer(np.asarray(body.vertices), np.asarray(body.faces))
    scores = []
    for seed in range(60):
        rng, place = np.random.default_rng(seed), truth(seed)
        points = points_of(10, rng)
        rays = picked(cameras(4), points, place, 1.0, rng)
        fit = fit_picks(rays, points, True, FOCAL)
        refined = refine(tracer, [], fit.places[0], True, PickedRays(rays, points, fit.sigma))
        covariance = uncertainty(refined, 0.05, False).covariance
        turn = Rotation.from_matrix(refined.place.rotation @ place.rotation.T).as_rotvec()
        error = np.concatenate([turn, refined.pivot - place.translation, [np.log(refined.place.scale)]])
        scores.append(error / np.sqrt(np.diag(covariance)))
    # Thirteen degrees of freedom each give Student's t, of RMS 1.09; 60 draws know it to 9%, and seven are looked at.
    assert_allclose(np.sqrt(np.mean(np.square(scores), axis=0)), 1.09, atol=0.35)


@dataclass(frozen=True)
class Shot:
    """As much of a photo as picks need."""

    label: str
    name: str
    camera: Camera


PHOTOS = [Shot(f"{i}.png", f"front/{i}.png", camera) for i, camera in enumerate(cameras(3))]


def test_files_are_read_with_or_without_a_header_by_label_or_name(tmp_path):
    path = tmp_path / "picks.csv"
    path.write_text("photo,u,v,x,y,z\n0.png,1.5,2.5,30,40,50\n\n# a remark\nfront/2.png, 3, 4, -1, 2, 3\n")
    picks = read_picks(path, PHOTOS, 0.001)
    assert picks.photos.tolist() == [0, 2]
    assert picks.lines.tolist() == [2, 5]
    assert_allclose(picks.points, [[0.03, 0.04, 0.05], [-0.001, 0.002, 0.003]])
    path.write_text("\ufeff0.png,1.5,2.5,30,40,50\n")  # as Excel saves it
    assert_allclose(read_picks(path, PHOTOS, 1.0).pixels, [[1.5, 2.5]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no picks"),
        ("photo,u,v,x,y,z\n", "holds no picks"),
        ("photo,x,y,u,v,z\n0.png,1,2,3,4,5", "line 1: columns are photo,x,y,u,v,z, not"),
        ("0.png,1,2,3,4", "line 1 has 5 fields, not the 6"),
        ("0.png;1;2;3;4;5", "separate them by commas"),
        (
            "0.png,1,2,3,4,5\nfrnt/1.png,1,2,3,4,5",
            "line 2: 'frnt/1.png' is no photo of the set; did you mean",
        ),
        ("0.png,1,two,3,4,5", "line 1: v is 'two', not a number"),
        ("0.png,1,2,3,nan,5", "line 1: y is nan; it must be finite"),
        (
            "0.png,1,2,3,4,5\n1.png,100,300,1,1,1",
            r"line 2: \(100, 300\) is outside the photo, which has 320x240",
        ),
        ("0.png,100,300,3,4,5", "u and v look swapped"),
    ],
)
def test_mistakes_in_files_are_named_with_their_line(tmp_path, text, message):
    path = tmp_path / "picks.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_picks(path, PHOTOS, 1.0)


def test_picks_off_the_mesh_are_named_and_other_units_refused(tmp_path):
    body = trimesh.creation.icosphere(2, 0.05)
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    path = tmp_path / "picks.csv"
    rows = [f"0.png,{10 + i},20,{x},{y},{z}" for i, (x, y, z) in enumerate(vertices[:5])]
    path.write_text("\n".join([*rows, "0.png,9,9,0.0,0.03,0.0"]))
    picks = read_picks(path, PHOTOS, 1.0)
    (warning,) = check_on_surface(path, picks, vertices, faces)
    # 0.02 of 0.1 inside the ball, but for its facets.
    assert warning.startswith("line 6 of picks.csv is ")
    assert warning.endswith("% of the mesh's size off its surface")
    with pytest.raises(ValueError, match=r"6 of 6 picks lie off the mesh.*own coordinates and unit"):
        check_on_surface(path, read_picks(path, PHOTOS, 0.001), vertices, faces)

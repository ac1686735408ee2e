"""Visual hulls against bodies whose silhouettes are known by hand, and the command that makes them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.arc.gantry import look_at
from capture.camera import ORTHOGRAPHIC, Camera
from capture.decode import decode
from lightfactor.cli import main
from recon.hull.consistency import contradiction_warning, contradictions
from recon.hull.silhouette import bright_region
from recon.hull.visualhull import visual_hull
from recon.mesh.bodies import MeshBody, SphereBody, body_coverage
from recon.mesh.trianglemesh import is_watertight, read_mesh, volume

CENTRE, RADIUS = np.array([0.1, -0.05, 0.2]), 0.3


def eyes(count: int) -> np.ndarray:
    """Directions all over the sphere, on a spiral."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    around = np.sqrt(1 - z**2)
    return np.stack([around * np.cos(azimuth), around * np.sin(azimuth), z], axis=-1)


def cameras(count: int = 24, size: int = 240) -> list[Camera]:
    params = [1.4 * size, 1.4 * size, size / 2, size / 2]
    return [
        Camera("PINHOLE", params, size, size, look_at(CENTRE + 1.5 * eye, CENTRE, [0.1, 0.2, 1]))
        for eye in eyes(count)
    ]


def masks(ball, views: list[Camera]) -> list[np.ndarray]:
    body = SphereBody(ball(CENTRE, RADIUS))
    return [body_coverage(body, camera).astype(np.float32) for camera in views]


def test_the_hull_of_a_sphere_holds_it_and_little_more(ball):
    views = cameras()
    drawn = masks(ball, views)
    mesh = visual_hull(views, drawn, 48)
    assert is_watertight(mesh)
    distance = np.linalg.norm(mesh.vertices - CENTRE, axis=1) / RADIUS
    # A pixel is 1/75 of the radius; binary masks are off by half of one at most.
    assert distance.min() > 1 - 1 / 75
    # It touches the sphere in a ring for each view, and stands off between: 24 views' rings lie 0.3 rad apart at most.
    assert distance.max() < 1.06
    # Of many views the smallest mask counts at each place: a third of a pixel of 75, three times for a volume.
    assert 0.985 < volume(mesh) / (4 / 3 * np.pi * RADIUS**3) < 1.03
    # Finer cells or coarser ones find the same body.
    coarse = visual_hull(views, drawn, 40)
    assert volume(coarse) == pytest.approx(volume(mesh), rel=0.01)


def test_a_box_seen_along_its_sides_is_itself():
    # Three orthographic views along the axes: the silhouettes are 40x60, 60x80 and 40x80 pixels.
    sides = {(1.0, 0, 0): (60, 80), (0, 1.0, 0): (40, 80), (0, 0, 1.0): (40, 60)}
    views, coverages = [], []
    for eye, (width, height) in sides.items():
        up = [0, 0, 1] if eye[2] == 0 else [0, 1, 0]
        views.append(Camera(ORTHOGRAPHIC, [100.0, 60, 60], 120, 120, look_at(eye, [0, 0, 0], up)))
        mask = np.zeros((120, 120), np.float32)
        mask[60 - height // 2 : 60 + height // 2, 60 - width // 2 : 60 + width // 2] = 1
        coverages.append(mask)
    mesh = visual_hull(views, coverages, 80)
    # A cell is 0.01 m: its surface lies within it, its corners are cut by as much.
    assert_allclose(mesh.vertices.max(axis=0), [0.2, 0.3, 0.4], atol=0.002)
    assert_allclose(mesh.vertices.min(axis=0), [-0.2, -0.3, -0.4], atol=0.002)
    assert volume(mesh) == pytest.approx(0.4 * 0.6 * 0.8, rel=0.01)


def test_a_mask_that_the_images_edge_cuts_off_carves_nothing_there(ball):
    views = cameras(12)
    body = SphereBody(ball(CENTRE, RADIUS))
    # One camera comes so close that it sees the middle only.
    near = views[0].posed(look_at(CENTRE + 0.45 * eyes(12)[0], CENTRE, [0.1, 0.2, 1]))
    mask = body_coverage(body, near)
    assert mask[0].any()
    drawn = masks(ball, views)
    whole = volume(visual_hull(views, drawn, 32))
    cut = volume(visual_hull([*views, near], [*drawn, mask.astype(np.float32)], 32))
    assert cut == pytest.approx(whole, rel=0.01)


def test_masks_that_contradict_each_other_are_refused(ball):
    views = cameras(6)
    good = masks(ball, views)
    turned = [camera.posed(np.linalg.inv(camera.world_to_camera)) for camera in views]
    with pytest.raises(ValueError, match="no body in common"):
        visual_hull(turned, good, 32)
    with pytest.raises(ValueError, match="2 masks are too few"):
        visual_hull(views[:2], good[:2])
    with pytest.raises(ValueError, match="taken from one direction"):
        visual_hull([views[0]] * 3, [good[0]] * 3)
    with pytest.raises(ValueError, match="mask is empty"):
        visual_hull(views, [*good[:5], np.zeros_like(good[0])])


def test_dark_parts_that_some_photographs_lose_are_located(ball):
    views = cameras()
    whole = masks(ball, views)
    assert contradictions(visual_hull(views, whole, 48), views, whole, 48) == []
    # The pole of the ball is as dark as the background where two cameras see it; other cameras see it bright.
    seen = [k for k in range(len(views)) if eyes(24)[k, 2] > -0.3]
    dark = seen[2], seen[7]
    pole = CENTRE + np.array([0, 0, RADIUS])
    cut = list(whole)
    for k in dark:
        x, y = views[k].project(pole[None])[0]
        rows, columns = np.mgrid[:240, :240] + 0.5
        cut[k] = whole[k] * (np.hypot(columns - x, rows - y) > 35)
    mesh = visual_hull(views, cut, 48)
    assert mesh.vertices[:, 2].max() < CENTRE[2] + RADIUS - 0.02
    found = contradictions(mesh, views, cut, 48)
    assert len(found) > 5
    for each in found:
        assert set(each.cut_by) <= set(dark)
        assert each.photo not in dark or each.cut_by
        # The place is within the ball, but not within the hull.
        place = int(each.row), int(each.column)
        assert whole[each.photo][place] > 0.5
        assert not body_coverage(MeshBody(mesh), views[each.photo])[place]
    assert {k for each in found for k in each.cut_by} == set(dark)


def test_too_large_a_silhouette_is_told_from_dark_parts(ball):
    views = cameras()
    large = masks(ball, views)
    large[5][20:60, 20:60] = 1
    found = contradictions(visual_hull(views, large, 48), views, large, 48)
    assert [(each.photo, each.cut_by) for each in found] == [(5, ())]
    assert_allclose((found[0].column, found[0].row), 40, atol=2)


@pytest.mark.slow
def test_the_temple_lost_to_a_high_threshold_names_the_photograph(data_dir):
    lines = [line.split() for line in (data_dir / "temple" / "templeSR_par.txt").read_text().splitlines()]
    views, names, radiances = [], [], []
    for line in (line for line in lines if len(line) == 22):
        numbers = np.array(line[1:], float)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = numbers[9:18].reshape(3, 3), numbers[18:]
        # Published with centres of pixels at integers.
        params = [numbers[0], numbers[4], numbers[2] + 0.5, numbers[5] + 0.5]
        views.append(Camera("PINHOLE", params, 640, 480, pose))
        names.append(line[0])
        radiances.append(decode(data_dir / "temple" / line[0], "srgb").radiance)

    def told(share: float) -> tuple[float, str | None]:
        silhouettes = [bright_region(radiance, share) for radiance in radiances]
        mesh = visual_hull(views, silhouettes, 48)
        found = contradictions(mesh, views, silhouettes, 48)
        return np.ptp(mesh.vertices[:, 1]), contradiction_warning(found, names, [False] * len(names), share)

    height, said = told(0.08)
    # One photograph loses the roof: 0.034 of 0.169 m.
    assert height < told(0.04)[0] - 0.02
    assert said is not None
    assert re.search(r" more\. For templeSR0012\.png.* background", said)
    assert "--background (now 0.08)" in said


def test_what_is_bright_before_black_is_the_object():
    radiance = np.full((50, 60, 3), 0.001, np.float32)
    radiance[10:40, 15:50] = np.linspace(0.1, 1, 35)[None, :, None]
    radiance[20:25, 20:30] = 0  # a deep shadow within it
    radiance[3:5, 3:5] = 1  # a reflection beside it
    expected = np.zeros((50, 60))
    expected[10:40, 15:50] = 1
    np.testing.assert_array_equal(bright_region(radiance, 0.04), expected)


def hull_set(folder: Path, ball, masked: bool) -> Path:
    views = cameras(12, 120)
    lines = ['format = 1\nname = "ball"\n[object]\nshape = "mesh"\nmesh = "hull.ply"\nalign = "auto"\n']
    for k, (camera, mask) in enumerate(zip(views, masks(ball, views), strict=True)):
        cv2.imwrite(str(folder / f"{k}.png"), (mask * 200).astype(np.uint8))
        pose = camera.world_to_camera.tolist()
        lines.append(f'[[photo]]\nfile = "{k}.png"\nworld_to_camera = {json.dumps(pose)}\n')
        if masked:
            cv2.imwrite(str(folder / f"mask-{k}.png"), (mask * 255).astype(np.uint8))
            lines.append(f'mask = "mask-{k}.png"\n')
        params = camera.params.tolist()
        lines.append(f'camera = {{ model = "PINHOLE", params = {params}, width = 120, height = 120 }}\n')
    (folder / "photoset.toml").write_text("".join(lines))
    return folder


@pytest.mark.parametrize("masked", [True, False])
def test_the_command_writes_a_closed_mesh(tmp_path, ball, monkeypatch, capsys, masked):
    folder = hull_set(tmp_path, ball, masked)
    out = folder / "hull.ply"
    monkeypatch.setattr("sys.argv", ["lightfactor", "hull", str(folder), "--cells", "48", "-o", str(out)])
    with pytest.raises(SystemExit, match="0"):
        main()
    mesh = read_mesh(out)
    assert is_watertight(mesh)
    assert_allclose(mesh.vertices.mean(axis=0), CENTRE, atol=0.01)
    said = capsys.readouterr().out
    assert re.search(r"\d+ faces, 0\.6\d+ x 0\.6\d+ x 0\.6\d+, volume", said)
    assert "contradict" not in said


def test_the_command_warns_of_a_dark_part_and_names_the_photographs(tmp_path, ball, monkeypatch, capsys):
    folder = hull_set(tmp_path, ball, masked=False)
    picture = cv2.imread(str(folder / "4.png"))
    picture[:55] = 0
    cv2.imwrite(str(folder / "4.png"), picture)
    out = folder / "hull.ply"
    monkeypatch.setattr("sys.argv", ["lightfactor", "hull", str(folder), "--cells", "48", "-o", str(out)])
    with pytest.raises(SystemExit, match="0"):
        main()
    assert re.search(
        r"Warning: silhouettes contradict .* For 4\.png they are background", capsys.readouterr().out
    )

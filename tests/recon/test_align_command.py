"""`lightfactor align` as it is used: a folder in, alignment.json and a figure out, read back by everything else."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from capture.arc.gantry import look_at
from capture.camera import Camera
from capture.photoset import load_photoset
from recon.mesh.rays import RayTracer
from recon.poses.align.evidence import gather, registered_poses
from recon.poses.align.run import run_align
from recon.poses.similarity import Similarity
from synthetic.sensing.masks import write_mask

TRUTH = Similarity(1.0, Rotation.from_rotvec([0.4, -0.3, 1.9]).as_matrix(), [0.004, -0.003, 0.006])
SIZE = (120, 160)


def camera_at(turn: float) -> Camera:
    eye = 0.6 * np.array([np.cos(turn), np.sin(turn), 0.3])
    return Camera("PINHOLE", [600, 600, 80, 60], 160, 120, look_at(eye, np.zeros(3), np.array([0.0, 0, 1])))


CAMERAS = [camera_at(turn) for turn in (0.0, 1.1, 2.3, 3.6, 5.0)]


@pytest.fixture(scope="module")
def lump() -> tuple[trimesh.Trimesh, list[np.ndarray]]:
    """A lump without any symmetry, millimetres, and its masks."""
    body = trimesh.creation.icosphere(3, 1.0)
    x, y, z = np.asarray(body.vertices).T
    radii = 35 * (1 + 0.3 * x * y + 0.25 * z**3 - 0.2 * x**2 * z + 0.15 * y)
    body.vertices = np.asarray(body.vertices) * radii[:, None] * [1.2, 0.8, 1.0]
    world = RayTracer(TRUTH.apply(np.asarray(body.vertices) / 1000), np.asarray(body.faces))
    steps = (np.arange(4) + 0.5) / 4
    x, y = ((np.arange(size)[:, None] + steps).ravel() for size in (160, 120))
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    hits = [world.first_hits(*camera.rays(pixels)).faces >= 0 for camera in CAMERAS]
    return body, [hit.reshape(120, 4, 160, 4).mean(axis=(1, 3)) for hit in hits]


def start_near() -> str:
    """The manifest's key that has a mesh start some degrees beside its place."""
    off = TRUTH.moved(np.array([0.1, -0.1, 0.08, 0.002, 0.001, -0.002, 0]), np.zeros(3))
    rows = np.eye(4)
    rows[:3, :3], rows[:3, 3] = off.rotation, off.translation
    return f"mesh_to_world = {rows.tolist()}"


def write_set(
    folder: Path,
    lump,
    *,
    keys: str = 'align = "auto"',
    unit: str = "mm",
    masked: bool = True,
    posed: bool = True,
) -> Path:
    body, masks = lump
    folder.mkdir(exist_ok=True)
    body.export(folder / "lump.ply")
    lines = [
        "format = 1",
        'name = "lump"',
        "[camera]",
        'model = "PINHOLE"',
        "params = [600.0, 600.0, 80.0, 60.0]",
    ]
    lines += [
        "width = 160",
        "height = 120",
        "[object]",
        'shape = "mesh"',
        'mesh = "lump.ply"',
        f'unit = "{unit}"',
        keys,
    ]
    for index, (camera, mask) in enumerate(zip(CAMERAS, masks, strict=True)):
        write_mask(folder / f"{index}_mask.png", mask)
        cv2.imwrite(
            str(folder / f"{index}.png"), np.repeat((200 * mask + 3).astype(np.uint8)[:, :, None], 3, axis=2)
        )
        lines += ["[[photo]]", f'file = "{index}.png"']
        lines += [f'mask = "{index}_mask.png"'] if masked else []
        lines += [f"world_to_camera = {camera.world_to_camera.tolist()}"] if posed else []
        lines += ["held_out = true"] if index == 4 else []
    (folder / "photoset.toml").write_text("\n".join(lines))
    return folder


def write_poses(folder: Path, lump, scale: float) -> None:
    """What registration would leave: a world of another size, with a cloud of the object and its backdrop."""
    photos = []
    for index, camera in enumerate(CAMERAS):
        pose = camera.world_to_camera.copy()
        pose[:3, 3] *= scale
        photos.append({"file": f"{index}.png", "world_to_camera": pose.tolist()})
    rng = np.random.default_rng(0)
    on_mesh = TRUTH.apply(np.asarray(trimesh.sample.sample_surface(lump[0], 400, seed=1)[0]) / 1000)
    cloud = np.concatenate([on_mesh, rng.uniform(-0.4, 0.4, (400, 3))]) * scale
    trimesh.PointCloud(cloud).export(folder / "poses-points.ply")
    document = {
        "photos": photos,
        "unregistered": [],
        "scale": {"metric": False},
        "points": "poses-points.ply",
    }
    (folder / "poses.json").write_text(json.dumps(document))


def picks_text(lump, rows: int = 8) -> str:
    rng = np.random.default_rng(2)
    points = np.asarray(lump[0].vertices)[rng.integers(len(lump[0].vertices), size=rows)]
    lines = []
    for index, point in enumerate(points):
        u, v = CAMERAS[index % 4].project(TRUTH.apply(point[None] / 1000))[0] + rng.normal(size=2)
        lines.append(f"{index % 4}.png,{u:.2f},{v:.2f},{point[0]:.4f},{point[1]:.4f},{point[2]:.4f}")
    return "\n".join(lines)


def check_placed(folder: Path, atol: float = 1e-3) -> dict:
    """The set as others read it has the mesh where it stands, and cameras in its metres."""
    photoset = load_photoset(folder)
    placed = np.eye(4)
    placed[:3, :3], placed[:3, 3] = TRUTH.rotation, TRUTH.translation
    assert_allclose(photoset.mesh_to_world, placed, atol=atol)  # 1e-3: 0.06 degrees
    for photo, camera in zip(photoset.photos, CAMERAS, strict=True):
        assert_allclose(photo.camera.centre, camera.centre, rtol=2e-3, atol=1e-3)
    document = json.loads((folder / "alignment.json").read_text())
    assert (folder / "alignment.png").stat().st_size > 10_000
    return document


def test_a_set_is_aligned_by_its_masks_and_what_is_held_out_agrees(tmp_path, lump, capsys):
    folder = write_set(tmp_path / "set", lump)
    with pytest.raises(ValueError, match="has not been aligned yet: run `lightfactor align"):
        load_photoset(folder)
    run_align(folder, None, False, False)
    document = check_placed(folder)
    assert document["world_scale"] == 1
    assert document["std"]["world_scale"] == 0
    assert document["std"]["rotation_deg"] < 0.1
    assert np.shape(document["covariance"]) == (7, 7)
    assert [photo["held_out"] for photo in document["photos"]] == [False] * 4 + [True]
    assert all(photo["rms_px"] < 0.1 and photo["overlap"] > 0.99 for photo in document["photos"])
    assert "held out" in capsys.readouterr().out
    # The same again gives the same bytes.
    before = (folder / "alignment.json").read_bytes()
    run_align(folder, None, True, False)
    assert (folder / "alignment.json").read_bytes() == before
    # Another mesh is another matter.
    (folder / "lump.ply").write_bytes((folder / "lump.ply").read_bytes() + b"\n")
    with pytest.raises(ValueError, match=r"was made with another lump.ply; run `lightfactor align` again"):
        load_photoset(folder)


def test_relative_poses_get_the_mesh_s_metres(tmp_path, lump):
    folder = write_set(tmp_path / "set", lump, posed=False)
    write_poses(folder, lump, 37.0)
    photoset = load_photoset(folder, find_alignment=True)
    evidence = gather(photoset, registered_poses(photoset), True, lambda photos, _: iter(photos))
    # 400 points are the object's; of 400 around it few lie before it in all photos.
    assert evidence.cloud is not None
    assert 360 < len(evidence.cloud) < 430
    assert not evidence.metric
    run_align(folder, None, False, False)
    document = check_placed(folder)
    assert document["world_scale"] == pytest.approx(1 / 37, rel=1e-3)
    assert 0 < document["std"]["world_scale"] * 37 < 2e-3
    assert set(document["made_from"]) == {"mesh", "poses"}


def test_without_masks_a_cloud_or_a_dark_background_serves(tmp_path, lump):
    folder = write_set(tmp_path / "dark", lump, masked=False)
    run_align(folder, None, False, False)
    # A threshold's outline is known to half a pixel, of 160.
    document = check_placed(folder, atol=6e-3)
    assert any("no photo has a mask" in warning for warning in document["warnings"])
    folder = write_set(tmp_path / "bright", lump, masked=False)
    for index in range(5):
        rng = np.random.default_rng(index)
        cv2.imwrite(str(folder / f"{index}.png"), rng.integers(0, 255, (*SIZE, 3)).astype(np.uint8))
    with pytest.raises(ValueError, match="there is nothing to align the mesh by: give masks"):
        run_align(folder, None, False, False)


def test_picks_of_the_manifest_and_of_the_command_line(tmp_path, lump):
    folder = write_set(tmp_path / "set", lump, keys='align = "picks.csv"')
    with pytest.raises(ValueError, match=r"align = 'picks.csv': there is no such file"):
        run_align(folder, None, False, False)
    (folder / "picks.csv").write_text(picks_text(lump))
    run_align(folder, None, False, False)
    document = check_placed(folder)
    assert document["method"] == "picks"
    # A pixel of noise in u and v.
    assert 0.5 < document["photos"][0]["picks_rms_px"] < 3
    lines = picks_text(lump, 9).splitlines()
    fields = [line.split(",") for line in lines]
    fields[2][3:], fields[6][3:] = fields[6][3:], fields[2][3:]
    (tmp_path / "swapped.csv").write_text("\n".join(",".join(row) for row in fields))
    run_align(folder, tmp_path / "swapped.csv", False, False)
    warnings = check_placed(folder)["warnings"]
    assert [w.split(" is ")[0] for w in warnings[:2]] == [
        "the pick of line 3 of swapped.csv (2.png)",
        "the pick of line 7 of swapped.csv (2.png)",
    ]
    assert "are the rows swapped?" in warnings[2]
    turned = [
        [row[0], row[2], str(min(float(row[1]), 119)), *row[3:]] for row in map(str.split, lines[:7], "," * 7)
    ]
    (tmp_path / "turned.csv").write_text("\n".join(",".join(row) for row in turned))
    with pytest.raises(ValueError, match=r"turned.csv: (u and v look swapped|.*agree)"):
        run_align(folder, tmp_path / "turned.csv", False, False)


def test_without_masks_picks_place_it_as_well_as_they_can(tmp_path, lump):
    folder = write_set(tmp_path / "set", lump, masked=False)
    (folder / "p.csv").write_text(picks_text(lump))
    for index in range(5):
        cv2.imwrite(str(folder / f"{index}.png"), np.full((*SIZE, 3), 99, np.uint8))
    run_align(folder, folder / "p.csv", False, False)
    document = json.loads((folder / "alignment.json").read_text())
    error = Rotation.from_matrix(np.array(document["mesh_to_world"])[:3, :3] @ TRUTH.rotation.T).magnitude()
    assert np.degrees(error) < 4 * document["std"]["rotation_deg"]
    assert document["std"]["rotation_deg"] < 5


def test_mesh_to_world_of_the_manifest_is_where_it_starts(tmp_path, lump):
    folder = write_set(tmp_path / "set", lump, keys=start_near())
    run_align(folder, None, False, False)
    document = json.loads((folder / "alignment.json").read_text())
    assert_allclose(np.array(document["mesh_to_world"])[:3, :3], TRUTH.rotation, atol=1e-3)
    assert any("remove it there to use what was found" in warning for warning in document["warnings"])


def test_what_keeps_a_mesh_from_being_placed_is_said_and_nothing_is_written(tmp_path, lump):
    folder = write_set(tmp_path / "unit", lump, unit="m")
    with pytest.raises(ValueError, match=r"photoset.toml: the mesh fits its masks if .* set unit = 'mm'"):
        run_align(folder, None, False, False)
    assert not list(folder.glob("alignment*"))
    folder = write_set(tmp_path / "sphere", lump)
    text = (folder / "photoset.toml").read_text()
    (folder / "photoset.toml").write_text(
        text.replace('shape = "mesh"', "").replace("mesh = ", "# ").replace("align", "#")
    )
    with pytest.raises(ValueError, match=r"\[object\] has no mesh"):
        run_align(folder, None, False, False)
    folder = write_set(tmp_path / "empty", lump)
    write_mask(folder / "2_mask.png", np.zeros(SIZE))
    with pytest.raises(ValueError, match=r"2_mask.png: the mask is empty"):
        run_align(folder, None, False, False)
    folder = write_set(tmp_path / "unposed", lump, posed=False)
    with pytest.raises(ValueError, match="has no pose"):
        run_align(folder, None, False, False)

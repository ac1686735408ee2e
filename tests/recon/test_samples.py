"""Samples of a photographed mesh, end to end: what they know of the light explains the photographs' radiance."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import read_latlong
from capture.photoset import load_photoset
from lightfactor.cli import main
from recon.harmonics.basis import clamped_cosine_transfer, evaluate_harmonics
from recon.harmonics.latlong import project_latlong
from recon.mesh.transfer import transfer_vectors
from recon.sampling.find import find_body
from recon.sampling.run import known_sources
from recon.sampling.stream import light_fields
from synthetic.scenes.build import read_staging
from synthetic.writer import write_photoset

# A matte cat: what it sends back is kd times the irradiance, and nothing else.
KD = 0.2
SCENE = f"""
format = 1
name = "matte cat"

[object]
shape = "cat"
edge = 0.0017
atlas = false

[material]
model = "lambertian"
kd = {KD}

[[lighting]]
name = "sun"
directional = [{{ azimuth_deg = 60, elevation_deg = 25, irradiance = 1.0 }}]

[[lighting]]
name = "sky"
area = [{{ azimuth_deg = 60, elevation_deg = 35, radiance = 1.0, width_deg = 30 }}]

[camera]
width = 160
height = 120
focal_px = 500

[sensor]
noise = 0.0
floor = 0.0

[[view]]
azimuth_deg = -35
elevation_deg = 15
lighting = "sun"

[[view]]
azimuth_deg = 30
elevation_deg = 25
lighting = "sun"

[[view]]
azimuth_deg = -35
elevation_deg = 15
lighting = "sky"
"""


@pytest.fixture(scope="module")
def cat_set(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("cat")
    (folder / "scene.toml").write_text(SCENE)
    write_photoset(read_staging(folder / "scene.toml"), folder)
    return folder


@pytest.fixture(scope="module")
def cat_fields(cat_set):
    photoset = load_photoset(cat_set)
    found = find_body(photoset)
    return photoset, found, list(light_fields(photoset, found.body, known_sources(photoset, found.body)))


def test_the_mesh_fits_its_masks(cat_fields):
    _, found, fields = cat_fields
    assert min(found.overlaps) > 0.99
    assert not found.warnings
    assert all(len(field) > 1000 for field in fields)


def test_sources_seen_and_hidden_explain_the_radiance_of_a_matte_cat(cat_fields):
    photoset, _, fields = cat_fields
    (sun,) = photoset.lightings[0].directional
    shadowed = 0
    for field in fields[:2]:
        cos = np.maximum(field.normals @ np.array(sun.direction), 0)
        seen = field.sources_visible[:, 0]
        predicted = KD * field.mean_over_rays(cos * seen)
        share = field.mean_over_rays(seen.astype(float))
        wholly = (share == 0) | (share == 1)
        # Lit and dark pixels, self-shadowed ones among them: brute force and samples agree but at shadows' borders.
        dark = (share == 0) & (field.mean_over_rays(cos) > 0.1)
        shadowed += int(dark.sum())
        off = np.abs(field.radiance[:, 0] - predicted)[wholly]
        # A pixel's mean over 4x4 points against one ray or a few.
        assert np.median(off) < 2e-4 * KD
        assert np.quantile(off, 0.98) < 2e-3 * KD
        assert wholly.mean() > 0.95
    assert shadowed > 50


def test_transfer_under_visibility_explains_the_radiance_under_a_wide_light(cat_set, cat_fields):
    photoset, found, fields = cat_fields
    field = fields[2]
    light_map = read_latlong(photoset.resolve(photoset.lightings[1].map))
    light = project_latlong(light_map, 10)[:, 0]
    vectors = transfer_vectors(found.mesh, 10, 1024).rotated(photoset.mesh_to_world[:3, :3])
    irradiance = vectors.coefficients @ light
    corners = found.body.mesh.faces[field.faces]
    at_rays = (irradiance[corners] * field.corner_weights).sum(axis=1)
    predicted = KD * field.mean_over_rays(at_rays)
    error = predicted - field.radiance[:, 0]
    # Against brute force at every pixel. Vertices stand for what lies between them, which shadows' borders cross.
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(field.radiance[:, 0] ** 2))
    assert abs(np.mean(error)) < 0.004 * np.mean(field.radiance[:, 0])
    # Without visibility the same light explains it tens of times worse.
    transfer = np.repeat(clamped_cosine_transfer(10), 2 * np.arange(11) + 1)
    open_sky = KD * (evaluate_harmonics(field.normals, 10) * transfer) @ light
    without = field.mean_over_rays(open_sky) - field.radiance[:, 0]
    assert np.sqrt(np.mean(without**2)) > 10 * np.sqrt(np.mean(error**2))


def test_a_budget_is_shared_by_the_photographs(cat_set):
    photoset = load_photoset(cat_set)
    found = find_body(photoset)
    fields = list(light_fields(photoset, found.body, known_sources(photoset, found.body), 300))
    assert [len(field) for field in fields] == [100, 100, 100]
    again = list(light_fields(photoset, found.body, known_sources(photoset, found.body), 300))
    assert_allclose(fields[1].positions, again[1].positions)


def run(monkeypatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["lightfactor", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    return int(stop.value.code or 0)


def test_the_command_writes_samples_a_summary_and_a_figure(cat_set, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    assert run(monkeypatch, "samples", str(cat_set), "-o", str(out), "--samples", "600", "--l-max", "2") == 0
    summary = json.loads((out / "samples.json").read_text())
    assert [photo["samples"] for photo in summary["photos"]] == [200, 200, 200]
    assert all(photo["mask_overlap"] > 0.99 for photo in summary["photos"])
    assert 0 < summary["photos"][0]["sources_seen"][0] < 1
    with np.load(out / "samples" / "000.npz") as arrays:
        assert arrays["positions"].shape == arrays["normals"].shape
        assert len(arrays["radiance"]) == 200
    with np.load(out / "transfer.npz") as arrays:
        assert arrays["coefficients"].shape == (len(arrays["vertices"]), 9)
    assert (out / "samples.png").stat().st_size > 10_000
    assert "600 samples" in capsys.readouterr().out


def test_the_command_says_in_a_sentence_what_is_wrong(cat_set, tmp_path, monkeypatch, capsys):
    text = (cat_set / "photoset.toml").read_text()
    folder = tmp_path / "wrong"
    folder.mkdir()
    for path in cat_set.iterdir():
        if path.is_file() and path.name != "photoset.toml":
            (folder / path.name).symlink_to(path)
    for name, change, said in [
        (
            "unit",
            text.replace("[object]", '[object]\nunit = "mm"'),
            "1000 times as large: metres taken for mill",
        ),
        ("mesh", text.replace('"object.obj"', '"objekt.obj"'), "objekt.obj: there is no such file"),
    ]:
        (folder / "photoset.toml").write_text(change)
        assert run(monkeypatch, "samples", str(folder), "-o", str(tmp_path / name)) == 1
        assert said in capsys.readouterr().err
        assert not (tmp_path / name).exists()


def test_lights_given_in_a_frame_that_the_poses_do_not_share_are_warned_of(cat_set, tmp_path):
    lines = (cat_set / "photoset.toml").read_text().splitlines()
    poses = [json.loads(line.split("=", 1)[1]) for line in lines if line.startswith("world_to_camera")]
    kept = [line for line in lines if not line.startswith("world_to_camera")]
    (tmp_path / "photoset.toml").write_text("\n".join(kept))
    for path in cat_set.iterdir():
        if path.is_file() and path.name != "photoset.toml":
            (tmp_path / path.name).symlink_to(path)
    photos = [{"file": f"00{k}.exr", "world_to_camera": pose} for k, pose in enumerate(poses)]
    for metric in (False, True):
        document = {"photos": photos, "unregistered": [], "scale": {"metric": metric}}
        (tmp_path / "poses.json").write_text(json.dumps(document))
        warnings = find_body(load_photoset(tmp_path)).warnings
        said = "frame of their own: lighting 'sun', lighting 'sky', mesh_to_world must be given in that frame"
        assert any(said in warning for warning in warnings) != metric


def test_a_sphere_from_one_place_is_told_to_be_of_unknown_size(tmp_path):
    disk = np.zeros((100, 120), np.uint8)
    cv2.circle(disk, (60, 50), 30, 255, -1)
    cv2.imwrite(str(tmp_path / "a.png"), disk)
    pose = "world_to_camera = [[1.0,0,0,0],[0,1,0,0],[0,0,1,0.5],[0,0,0,1]]"
    manifest = (
        'format = 1\nname = "disk"\n[object]\n{}[camera]\nmodel = "PINHOLE"\nparams = [200.0, 200, 60, 50]\n'
        f'width = 120\nheight = 100\n[[photo]]\nfile = "a.png"\nmask = "a.png"\n{pose}\n'
    )
    for given, warned in (("", True), ("radius = 0.07\n", False)):
        (tmp_path / "photoset.toml").write_text(manifest.format(given))
        warnings = find_body(load_photoset(tmp_path)).warnings
        assert any("size and distance are free together" in warning for warning in warnings) == warned

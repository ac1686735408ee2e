"""Light that bounces between the parts of a painted mesh: taken off before paint is read off it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capture.files.imagefile import read_exr_layers, read_pixels
from invrender.estimate.evidence import relative_rms
from invrender.estimate.interreflection.textured import no_brighter
from recon.mesh.trianglemesh import TriangleMesh, smooth_normals, write_mesh
from synthetic.materials.texture import Textured
from synthetic.scenes.build import read_staging
from synthetic.writer import write_photoset

Command = Callable[..., tuple[int, str, str]]
SCENE = """
format = 1
name = "painted cup"
object = { shape = "mesh", mesh = "cup.obj" }
material = { model = "lambertian", kd = 0.2 }
camera = { width = 80, height = 70, focal_px = 300 }
render = { directions = 256, bounces = 6 }

[[lighting]]
name = "lab"
directional = [
    { azimuth_deg = -50, elevation_deg = 30, irradiance = [1.2, 1.1, 1.0] },
    { azimuth_deg = 40, elevation_deg = 50, irradiance = [0.7, 0.75, 0.8] },
]
"""
VIEWS = ((-40, 10), (-10, 30), (0, 5), (25, 25), (40, 10), (12, 15))


def cup_mesh(rings: int = 40, around: int = 60, dent: float = 0.75) -> TriangleMesh:
    """A ball with a deep dent towards +x; u runs around that axis, v is 1 in the middle of the dent."""
    off, turn = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, around + 1), indexing="ij"
    )
    radius = 0.03 * (1 - dent * np.exp(-((off / 0.7) ** 4)))
    ring = radius * np.sin(off)
    vertices = np.stack([radius * np.cos(off), ring * np.cos(turn), ring * np.sin(turn)], -1).reshape(-1, 3)
    number = np.arange(len(vertices)).reshape(off.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate(
        [np.stack([a, b, c], -1)[:-1].reshape(-1, 3), np.stack([a, c, d], -1)[1:].reshape(-1, 3)]
    )
    # Along the seam, and at both ends, vertices lie on each other: normals are of the one surface.
    places, first, same = np.unique(np.round(1e9 * vertices), axis=0, return_index=True, return_inverse=True)
    assert len(places) == len(first)
    normals = smooth_normals(vertices[first], same.ravel()[faces])[same.ravel()]
    uv = np.stack([turn / (2 * np.pi), 1 - off / np.pi], -1).reshape(-1, 2)
    return TriangleMesh(vertices, faces, normals, uv)


def paint(height: int = 256) -> np.ndarray:
    """Kd of albedo 0.16 to 0.82 that changes over many pixels."""
    down, across = np.mgrid[:height, :height] / height
    turn, rise = 2 * np.pi * across, np.pi * down
    red = 0.2 + 0.06 * np.sin(3 * turn) * np.sin(8 * rise)
    green = 0.17 + 0.06 * np.cos(2 * turn) * np.cos(6 * rise)
    return np.stack([red, green, 0.1 + 0.05 * np.sin(4 * turn + 8 * rise)], -1)


@pytest.fixture(scope="module")
def cup(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cup")
    write_mesh(folder / "cup.obj", cup_mesh())
    views = [f"[[view]]\nazimuth_deg = {turn}\nelevation_deg = {up}\n" for turn, up in VIEWS]
    (folder / "cup.toml").write_text(SCENE + "".join(views) + "held_out = true\n")
    staging = read_staging(folder / "cup.toml")
    painted = Textured(staging.scene.material, paint(), np.zeros((1, 1, 3)))
    write_photoset(replace(staging, scene=replace(staging.scene, material=painted)), folder / "set")
    return folder / "set"


@pytest.mark.slow
def test_paint_in_folds_is_not_taken_for_brighter_than_it_is(
    lightfactor: Command, cup: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_pictures: None
) -> None:
    # Whether highlights of another form explain more, tests of textures say; here each form costs seconds.
    monkeypatch.setattr("invrender.estimate.textured.fit.OTHER_FORMS", ())
    out = tmp_path / "out"
    code, said, err = lightfactor("process", cup, "-o", out, "--samples", 4000)
    assert (code, err) == (0, "")
    assert "It was taken off: Kd -" in said
    found = json.loads((out / "result.json").read_text())["interreflection"]
    assert found["taken_off"]
    kd, std = (read_pixels(out / name).astype(float) for name in ("texture_kd.exr", "texture_kd_std.exr"))
    known = read_exr_layers(out / "texture_kd.exr")["A"] > 0
    side = len(kd)
    u, v = (np.arange(side) + 0.5) / side, 1 - (np.arange(side) + 0.5) / side
    # Its middle is in full view and mutual light; the paint is wide there, so that its nearest texel is its own.
    dent = known & (v[:, None] > 0.75)
    assert dent.sum() > 200
    map_ = paint()
    truth = map_[((1 - v)[:, None] * len(map_)).astype(int), (u * len(map_)).astype(int)]
    off = (kd / truth - 1)[dent]
    # Left in, it is 11% too bright there, 3.4 of its standard deviations.
    assert abs(off.mean()) < 0.015
    assert np.abs(off).mean() < 0.03
    z = (kd - truth)[dent] / std[dent]
    assert 0.3 < np.sqrt((z**2).mean()) < 1.3
    # What is predicted of a new side holds the light, too.
    seen = tmp_path / "seen.exr"
    assert lightfactor("render", out, "--set", cup, "--photo", "005.exr", "-o", seen)[0] == 0
    shown, whole = read_pixels(seen).astype(float), read_exr_layers(seen)["A"] > 0.999
    photo = read_pixels(cup / "truth" / "005.exr").astype(float)
    assert relative_rms((shown - photo)[whole], photo[whole]) < 0.015


def test_points_that_photographs_do_not_tell_bounce_no_more_than_others(rng: np.random.Generator) -> None:
    paint = rng.uniform(0.1, 0.3, (2, 50, 3))
    known = np.arange(50) < 40
    # Where hardly any light is reflected any Ks will do.
    paint[1, ~known] = 1e25
    for values in paint:
        taken = no_brighter(values, known)
        np.testing.assert_array_equal(taken[known], values[known])
        assert taken[~known].max() < 0.3

"""Textures: tiny problems against scipy's, layouts against geometry, and a painted doll against its paint."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.optimize import nnls

from capture.files.imagefile import read_exr_layers, read_pixels
from invrender.texture.layout import TexelLayout, VertexLayout, find_layout
from invrender.texture.sums import Sums, common_ks, solve_both, solve_kd
from recon import atlas
from recon.bodies import MeshBody
from recon.trianglemesh import TriangleMesh, smooth_normals
from synthetic.scenes.build import read_staging
from synthetic.shapes.doll import doll_mesh
from synthetic.writer import write_photoset

Command = Callable[..., tuple[int, str, str]]
DOLL = """
format = 1
name = "painted doll"
object = { shape = "doll", edge = 0.0025 }
camera = { width = 76, height = 116, focal_px = 480 }
render = { directions = 128, per_side = 2 }

[[lighting]]
name = "lab"
area = [{ azimuth_deg = 60, elevation_deg = 35, radiance = [1.5, 1.6, 1.8], width_deg = 20 }]
directional = [{ azimuth_deg = -30, elevation_deg = 30, irradiance = [1.2, 1.1, 1.0] }]

[gantry]
start_deg = -75
step_deg = 30
photos = 6
lighting = "lab"
"""


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def test_each_points_kd_and_ks_are_its_own_least_squares(rng: np.random.Generator) -> None:
    photos, points = 5, 40
    d, s, weight = (rng.uniform(0.2, 1, (photos, points, 3)) for _ in range(3))
    # Of a third of the points the best Kd or Ks would be negative.
    truth = rng.uniform(-0.5, 1, (2, points, 3))
    y = truth[0] * d + truth[1] * s + 0.01 * rng.standard_normal(d.shape)
    sums = Sums.zeros(points)
    for k in range(photos):
        sums.add(np.arange(points), d[k], s[k], y[k], weight[k])
    found = solve_both(sums)
    for point in range(points):
        for c in range(3):
            root = np.sqrt(weight[:, point, c])
            matrix = np.stack([d[:, point, c], s[:, point, c]], axis=1) * root[:, None]
            best, norm = nnls(matrix, y[:, point, c] * root)
            assert_allclose([found.kd[point, c], found.ks[point, c]], best, atol=1e-9)
            assert_allclose(found.cost[point, c], norm**2, atol=1e-9)
            std = np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
            assert_allclose([found.kd_std[point, c], found.ks_std[point, c]], std, rtol=1e-9)


def test_one_ks_for_all_points_is_that_of_the_whole_least_squares_problem(rng: np.random.Generator) -> None:
    photos, points = 4, 6
    d, s = (rng.uniform(0.2, 1, (photos, points, 3)) for _ in range(2))
    kd = rng.uniform(0.2, 1, (points, 3))
    y = kd * d + 0.3 * s + 0.01 * rng.standard_normal(d.shape)
    sums = Sums.zeros(points)
    for k in range(photos):
        sums.add(np.arange(points), d[k], s[k], y[k], np.ones_like(y[k]))
    ks, std = common_ks(sums)
    matrix = np.zeros((photos, points, points + 1))
    matrix[:, np.arange(points), np.arange(points)] = d[:, :, 0]
    matrix[:, :, -1] = s[:, :, 0]
    flat = matrix.reshape(-1, points + 1)
    best = np.linalg.lstsq(flat, y[:, :, 0].ravel(), rcond=None)[0]
    assert_allclose(ks[0], best[-1], rtol=1e-9)
    assert_allclose(std[0], np.sqrt(np.linalg.inv(flat.T @ flat)[-1, -1]), rtol=1e-9)
    assert_allclose(solve_kd(sums, ks).kd[:, 0], best[:-1], rtol=1e-9)


def test_one_photograph_does_not_tell_kd_from_ks() -> None:
    sums = Sums.zeros(2)
    one = np.ones((2, 3))
    sums.add(np.arange(2), one, 0.3 * one, one, one)
    found = solve_both(sums)
    assert np.isinf(found.kd_std).all()
    assert np.isinf(found.ks_std).all()


def test_texels_lie_on_the_surface_where_their_coordinates_say() -> None:
    mesh = doll_mesh(0.003)
    layout, warnings = find_layout(MeshBody(mesh), 0.001)
    assert isinstance(layout, TexelLayout)
    assert warnings == []
    # u is the azimuth [synthetic.shapes.doll]; the mesh's chords are off by up to a tenth of a facet's angle, 0.13.
    at = layout.points.positions
    azimuth = 2 * np.pi * (layout.columns + 0.5) / layout.side - np.pi
    off_axis = np.hypot(at[:, 0], at[:, 1]) > 0.005
    off = np.angle(np.exp(1j * (np.arctan2(at[:, 1], at[:, 0]) - azimuth)))
    assert np.abs(off[off_axis]).max() < 0.02
    # Nearly every texel of the map, the doll's coordinates filling it, and of about the size asked for.
    assert len(layout.rows) > 0.98 * layout.side**2
    area = np.linalg.norm(
        np.cross(*(mesh.vertices[mesh.faces[:, k]] - mesh.vertices[mesh.faces[:, 0]] for k in (1, 2))), axis=1
    )
    assert np.sqrt(area.sum() / 2 / len(layout.rows)) == pytest.approx(0.001, rel=0.02)


def mirrored_uv(mesh: TriangleMesh) -> TriangleMesh:
    """One half of the texture for both halves of the doll, as artists do."""
    assert mesh.uv is not None
    return replace(mesh, uv=np.column_stack([np.abs(mesh.uv[:, 0] - 0.5), mesh.uv[:, 1]]))


def test_overlapping_coordinates_are_replaced_and_without_xatlas_vertices_serve(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    body = MeshBody(mirrored_uv(doll_mesh(0.0062)))
    layout, (sentence,) = find_layout(body, 0.002)
    assert isinstance(layout, TexelLayout)
    assert layout.made is not None
    assert "lie in more than one triangle" in sentence
    assert_allclose(layout.made.vertices[layout.made.faces], body.mesh.vertices[body.mesh.faces], atol=1e-12)
    ball = trimesh.creation.icosphere(subdivisions=2)
    bare = MeshBody(TriangleMesh(ball.vertices, ball.faces, smooth_normals(ball.vertices, ball.faces)))
    monkeypatch.setattr(
        "invrender.texture.layout.atlas_within", lambda mesh, _: atlas.atlas_within(mesh, 0.01)
    )
    layout, (sentence,) = find_layout(bare, 0.1)
    assert isinstance(layout, VertexLayout)
    assert len(layout.points) == len(ball.vertices)
    assert (
        "at the mesh's vertices: no texture coordinates were found for its 320 faces within 0.01 s"
        in sentence
    )


@pytest.fixture(scope="module")
def doll(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """RH01's doll (section 6.4), smaller: six photographs at 1% noise, a pixel 1.25 mm wide."""
    folder = tmp_path_factory.mktemp("doll")
    (folder / "doll.toml").write_text(DOLL)
    write_photoset(read_staging(folder / "doll.toml"), folder / "set")
    path = folder / "set" / "photoset.toml"
    text = path.read_text()
    if "texture = true" not in text:
        path.write_text(text.replace('shape = "mesh"', 'shape = "mesh"\ntexture = true'))
    return folder / "set"


def test_the_dolls_paint_is_recovered_as_the_pixels_show_it(
    lightfactor: Command, doll: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    code, _, err = lightfactor("process", doll, "-o", out, "--samples", 6000)
    assert (code, err) == (0, "")
    result = json.loads((out / "result.json").read_text())
    truth = json.loads((doll / "truth.json").read_text())["brdf"]
    assert next(m["name"] for m in result["models"] if m["chosen"]) == "microfacet, Kd and Ks vary"
    assert result["brdf"]["sigma"]["value"] == pytest.approx(truth["sigma"], rel=0.05)
    found, std = (read_pixels(out / result["texture"][name]).astype(float) for name in ("kd", "kd_std"))
    known = read_exr_layers(out / "texture_kd.exr")["A"] > 0
    side = result["texture"]["side"]
    assert known.mean() == pytest.approx(result["texture"]["known"], abs=0.02)
    assert 0.2 < known.mean() < 0.7  # the side that the light reaches
    # The paint as a pixel and interpolation between pixels blur it: half a pixel, standard deviation.
    paint = read_pixels(doll / truth["kd_map"]).astype(np.float32)
    scale = paint.shape[0] / side
    blurred = cv2.GaussianBlur(paint, (0, 0), 0.5 * scale, borderType=cv2.BORDER_REPLICATE)
    centres = ((np.arange(side) + 0.5) * scale - 0.5).astype(np.float32)
    expected = cv2.remap(blurred, *np.meshgrid(centres, centres), cv2.INTER_LINEAR)
    off = (found - expected)[known]
    assert 20 * np.log10(expected.max() / np.sqrt((off**2).mean())) > 33
    # Standard deviations are honest where paint doesn't change within a pixel, which is most of the surface.
    assert np.median(np.abs(off / std[known])) / 0.6745 == pytest.approx(1, abs=0.3)


@pytest.mark.parametrize(
    ("pattern", "replacement", "words"),
    [
        (r'shape = "mesh"', 'shape = "sphere"', ["texture = true", "meshes"]),
        (r"(?m)^map = .*$", 'recover = ["ambient"]', ["ambient", "can't be told apart"]),
        (r"(?m)^map = .*\n(.*\n)?directional = .*$", "unknown = true", ["can't be told apart", "unknown"]),
        (r"(?m)^(map|directional) = .*\n", "", ["says nothing of the light"]),
    ],
    ids=["sphere", "recovered light", "unknown light", "no light"],
)
def test_bad_input_of_textures_is_one_clear_sentence(
    lightfactor: Command, doll: Path, tmp_path: Path, pattern: str, replacement: str, words: list[str]
) -> None:
    folder = Path(shutil.copytree(doll, tmp_path / "set"))
    path = folder / "photoset.toml"
    text = re.sub(pattern, replacement, path.read_text())
    if "sphere" in replacement:
        text = re.sub(r"(?m)^(mesh|mesh_to_world|unit) = .*\n", "", text)
    path.write_text(text)
    code, _, err = lightfactor("process", folder, "-o", tmp_path / "out")
    assert code == 1
    for word in words:
        assert word in err

"""Textures: tiny problems against scipy's, layouts against geometry, and a painted doll against its paint."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.sparse import csr_array

from capture.blocks import block_means, blocks
from capture.files.imagefile import read_exr_layers, read_pixels
from capture.photoset import load_photoset
from invrender.brdf.lobes import GGX_FORM, RH01_FORM
from invrender.estimate.textured.fit import fit_textured
from invrender.estimate.textured.joint import in_shadow, solve_joint
from invrender.estimate.textured.layout import TexelLayout, VertexLayout, find_layout
from invrender.estimate.textured.texel_observations import TexelRows
from invrender.estimate.textured.texel_pixels import PixelsOfPoints
from invrender.estimate.textured.textures import FittedTextures
from invrender.output.report.run import run_process
from invrender.process import texture_passes
from invrender.process.pipeline import process
from invrender.result import run as solved
from invrender.result.run import Run, TexturedRun
from invrender.transport.column_basis import whole_range
from recon.mesh import atlas
from recon.mesh.bodies import MeshBody
from recon.mesh.tessellated import tessellated
from recon.mesh.trianglemesh import TriangleMesh, smooth_normals
from synthetic.scenes.build import read_staging
from synthetic.shapes.doll import doll_mesh
from synthetic.writer import write_photoset

Command = Callable[..., tuple[int, str, str]]
DOLL = """
format = 1
name = "painted doll"
object = { shape = "doll", edge = 0.0025 }
camera = { width = 76, height = 116, focal_px = 480 }
render = { directions = 64, per_side = 2 }

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


def test_points_that_one_photograph_sees_are_refused_in_plain_words() -> None:
    columns = np.ones((1, 5, 1 + len(whole_range().weights(1.5, 0.1, RH01_FORM))), np.float32)
    light = np.full((5, 3), 0.3)
    photos = [
        TexelRows(np.arange(5) + first, columns, light, light, np.ones(5), np.zeros(5, int))
        for first in (0, 5)
    ]
    with pytest.raises(ValueError, match=r"seen by enough photographs .* 1 at most.*views overlap"):
        fit_textured(photos, 10, lambda forms, some: {})


def test_a_photograph_of_shadow_alone_is_told() -> None:
    one = np.ones((5, 3), np.float32)
    cover = csr_array(np.eye(5, dtype=np.float32))
    lit, grazed, dark = (
        PixelsOfPoints(cover, k * one, k * one, k * one[:, 0], one, one, one) for k in (1, 0.02, 0.001)
    )
    assert in_shadow([view.brightest for view in (lit, dark, grazed)]) == [False, True, False]


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


def test_means_are_over_the_surface_however_its_map_is_stretched() -> None:
    body = MeshBody(tessellated(np.zeros(3), 1.0, 48))
    layout, _ = find_layout(body, 0.03)
    edge = np.cos(np.radians(15.5 * 180 / 48))  # half-way between rings of vertices
    for each in (layout, VertexLayout(body)):
        z = each.points.positions[:, 2:].repeat(3, axis=1)
        known = z[:, 0] > edge
        textures = FittedTextures(each, z, z, 0 * z + 0.1, z, known, ks_varies=False)
        # Archimedes: zones of a sphere are as large as they are high. A row of texels more or less is 0.011 of it; a
        # third of the rows are above.
        assert textures.share_known == pytest.approx((1 - edge) / 2, abs=0.012)
        assert_allclose(textures.mean(z), (1 + edge) / 2, atol=0.01)
        # Of even weights 0.1 / sqrt(n); they are sines here, from 0 to 0.85: a little more.
        assert 1 < textures.mean_std(textures.kd_std)[0] / (0.1 / np.sqrt(known.sum())) < 1.2


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
        "invrender.estimate.textured.layout.atlas_within", lambda mesh, _: atlas.atlas_within(mesh, 0.01)
    )
    layout, (sentence,) = find_layout(bare, 0.1)
    assert isinstance(layout, VertexLayout)
    assert len(layout.points) == len(ball.vertices)
    assert (
        "at the mesh's vertices: no texture coordinates were found for its 320 faces within 0.01 s"
        in sentence
    )


def write_doll_set(folder: Path, scene: str) -> Path:
    (folder / "doll.toml").write_text(scene)
    write_photoset(read_staging(folder / "doll.toml"), folder / "set")
    path = folder / "set" / "photoset.toml"
    text = path.read_text()
    if "texture = true" not in text:
        path.write_text(text.replace('shape = "mesh"', 'shape = "mesh"\ntexture = true'))
    return folder / "set"


# Under lamps alone no lobe of any form meets a map of the light, which takes most of the time.
LAMP_LIT = (
    re.sub(r"(?m)^area = .*\n", "", DOLL).replace(
        "directional = [",
        "directional = [{ azimuth_deg = 60, elevation_deg = 35, irradiance = [0.9, 1, 1.1] }, ",
    )
    + '\n[material]\nmodel = "ggx"\nmu = 2.2\nalpha = 0.12\n'
)


@pytest.fixture(scope="module")
def lamp_lit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """RH01's doll (section 6.4), smaller: six photographs at 1% noise, a pixel 1.25 mm wide."""
    return write_doll_set(tmp_path_factory.mktemp("doll"), LAMP_LIT)


@pytest.fixture(scope="module", params=["lamps", pytest.param("room", marks=pytest.mark.sweep)])
def doll(request: pytest.FixtureRequest, lamp_lit: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same under lamps, or of another material in a room."""
    return lamp_lit if request.param == "lamps" else write_doll_set(tmp_path_factory.mktemp("room"), DOLL)


@pytest.fixture(scope="module")
def painted(doll: Path, lamp_lit: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    """What `process` finds of the doll, and where it wrote it."""
    out = tmp_path_factory.mktemp("painted") / "out"
    with pytest.MonkeyPatch.context() as patch:
        if doll == lamp_lit:
            # Each form takes seconds; the doll in a room tries them all.
            patch.setattr("invrender.estimate.textured.fit.OTHER_FORMS", (GGX_FORM,))
        return run_process(doll, out, samples=3000), out


def test_the_dolls_paint_is_recovered_as_the_pixels_show_it(painted: tuple[Run, Path], doll: Path) -> None:
    out = painted[1]
    result = json.loads((out / "result.json").read_text())
    truth = json.loads((doll / "truth.json").read_text())["brdf"]
    form = "GGX" if "alpha" in truth else "microfacet"
    assert result["brdf"]["model"] == form
    names = [model["name"] for model in result["models"]]
    assert next(m["name"] for m in result["models"] if m["chosen"]) == f"{form}, Kd and Ks vary"
    assert {
        f"{name}, {vary}" for name in ("microfacet", "GGX") for vary in ("Kd varies", "Kd and Ks vary")
    } <= set(names)
    sigma = result["brdf"]["sigma"]
    # A lobe of another form in its place is off by 20% or so.
    assert sigma["value"] == pytest.approx(truth.get("alpha", truth.get("sigma")), rel=0.05)
    found, std = (read_pixels(out / result["texture"][name]).astype(float) for name in ("kd", "kd_std"))
    known = read_exr_layers(out / "texture_kd.exr")["A"] > 0
    side = result["texture"]["side"]
    assert 0.2 < known.mean() < 0.7  # the side that the light reaches
    assert 0.2 < result["texture"]["known"] < 0.7
    # Browsers show no EXR: the page has pictures of the maps.
    assert 'alt="Textures"' in (out / "report.html").read_text()
    # A texel is the mean of the paint within it.
    paint = read_pixels(doll / truth["kd_map"]).astype(np.float32)
    expected = cv2.resize(paint, (side, side), interpolation=cv2.INTER_AREA)
    off = (found - expected)[known]
    # 36 dB with pixels of 0.6 mm, in docs/meshes.md; much of the paint is finer than these. Lamps alone leave places
    # that hardly one of them reaches.
    assert 20 * np.log10(expected.max() / np.sqrt((off**2).mean())) > (22 if form == "GGX" else 30.5)
    if form == "GGX":
        # Under lamps alone some texels hang on a single photograph, and their error bars are too small.
        assert np.median(np.abs(off / std[known])) < 1
        return
    # Standard deviations are honest at edges of paint, too.
    reach = int(5 * paint.shape[0] / side) | 1
    around = np.ones((reach, reach), np.uint8)
    change = cv2.resize(cv2.dilate(paint, around) - cv2.erode(paint, around), (side, side)).max(axis=2)[known]
    for place in (change < 0.01, change > 0.04):
        z = (off / std[known])[place]
        # At edges of paint much finer than these pixels 1.3; where pixels are of 0.6 mm, 1.06.
        assert 0.8 < np.sqrt((z**2).mean()) < 1.35
        # 90 to 99%; of some hundred texels, alike in all channels, the share is known to 2%.
        assert 0.86 < (np.abs(z) < 1.96).mean() < 0.995


@pytest.mark.sweep
def test_a_surface_in_tiles_is_solved_as_in_one_piece(
    painted: tuple[Run, Path], doll: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, pixels = painted[0].textures, []

    def counted(views: Sequence[PixelsOfPoints], *given: object) -> object:
        pixels.append(sum(len(view) for view in views))
        return solve_joint(views, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(texture_passes, "_OF_A_TILE", 2000)
    monkeypatch.setattr(texture_passes, "solve_joint", counted)
    monkeypatch.setattr("invrender.estimate.textured.fit.OTHER_FORMS", (GGX_FORM,))
    cut = process(load_photoset(doll), samples=3000)
    tiled = cut.textures
    assert whole is not None
    assert tiled is not None
    # All pixels are some tile's, and those at its border more than one's.
    assert len(pixels) >= 5
    assert max(pixels) < sum(pixels) / 3
    known = whole.known & tiled.known
    # Of those that are barely known, the noise that was drawn for a tile decides.
    assert known.sum() > 0.98 * max(whole.known.sum(), tiled.known.sum())
    for one, other, std in ((whole.kd, tiled.kd, whole.kd_std), (whole.ks, tiled.ks, whole.ks_std)):
        # Conjugate gradients end where steps are a thirtieth of the noise, in tiles elsewhere than in the whole.
        assert np.sqrt((((one - other)[known] / std[known]) ** 2).mean()) < 0.25


def test_paint_in_larger_pixels_is_the_mean_of_what_smaller_ones_show(
    painted: tuple[Run, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = painted[0]
    fine = next(run.predictions())
    monkeypatch.setattr(solved, "_PREDICTED", 1000)
    larger = replace(run)
    assert (run.binning, larger.binning) == (1, 2)

    coarse = next(larger.predictions())
    both = coarse.inside & blocks(fine.inside, 2).all(axis=(1, 3))
    assert both.sum() > 0.8 * coarse.inside.sum()
    expected = block_means(fine.predicted, 2)[both]
    off = np.sqrt(((coarse.predicted[both] - expected) ** 2).mean() / (expected**2).mean())
    # Much of the paint is finer than these pixels of 1.2 mm: few places tell its mean to 1.5%,
    # and one mean a pixel to 2.5%.
    assert off < 0.02
    # Light looked up in prepared maps is that of the integrals; 0.5% of the lobe, says `invrender.transport.reflected`.
    photo, field = fine.photo, run.fields[fine.photo.label]
    assert isinstance(run, TexturedRun)
    kd, ks = (np.full((len(field.normals), 3), value) for value in (0.1, 0.1))
    diffuse, specular = run.transfers(photo, field)
    lobe_off = run.shaded(photo, field, kd, ks) - 0.1 * diffuse - 0.1 * specular
    assert np.sqrt((lobe_off**2).mean()) < 0.005 * np.sqrt(((0.1 * specular) ** 2).mean())


@pytest.mark.parametrize(
    ("pattern", "replacement", "words"),
    [
        (r'shape = "mesh"', 'shape = "sphere"', ["texture = true", "meshes"]),
        (r"texture = true", "texture = true\ntexture_pixels = 3", ["texture_pixels is 3", "1000 or more"]),
        (r"texture = true", "texture_pixels = 5000", ["texture_pixels is for texture = true"]),
        (r"(?m)^directional = ", 'recover = ["ambient"]\ndirectional = ', ["ambient", "can't be separated"]),
        (r"(?m)^(map|directional) = .*\n", "", ["says nothing of the light"]),
    ],
    ids=["sphere", "few pixels", "no texture", "recovered light", "no light"],
)
def test_bad_input_of_textures_is_one_clear_sentence(
    lightfactor: Command, lamp_lit: Path, tmp_path: Path, pattern: str, replacement: str, words: list[str]
) -> None:
    folder = Path(shutil.copytree(lamp_lit, tmp_path / "set"))
    path = folder / "photoset.toml"
    text = re.sub(pattern, replacement, path.read_text())
    if "sphere" in replacement:
        text = re.sub(r"(?m)^(mesh|mesh_to_world|unit) = .*\n", "", text)
    path.write_text(text)
    code, _, err = lightfactor("process", folder, "-o", tmp_path / "out")
    assert code == 1
    for word in words:
        assert word in err

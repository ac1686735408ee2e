"""Live pictures: their tables against the integrals that they stand for, and what a browser draws against `render`."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.files.imagefile import write_exr
from capture.lighting import Lighting
from invrender.brdf.lobes import GGX_FORM, PLASTICS, RH01_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.output.live.drawn import live_error
from invrender.output.live.few_faces import few_faces, with_few_faces
from invrender.output.live.live_light import live_light
from invrender.output.live.live_material import live_reflectances
from invrender.output.live.lobe_maps import lobe_maps
from invrender.output.live.lobe_volume import lobe_volume
from invrender.output.live.packed import packed_light, packed_subject
from invrender.output.live.scene import live_scene
from invrender.output.render.light import turned
from invrender.result.reflectance import Reflectance
from invrender.result.saved_textures import SavedTextures
from invrender.transport.diffuse_base import base_irradiance
from invrender.transport.form_transfer import OneIndex, form_transfer
from invrender.transport.transfer import light_elements
from recon.mesh.bodies import MeshBody
from recon.mesh.simplified import simplified
from recon.mesh.tessellated import tessellated
from recon.mesh.trianglemesh import TriangleMesh

from .livescenes import gloss, room, studio_of
from .renders import write_result

Command = Callable[..., tuple[int, str, str]]
NOTHING = np.zeros((0, 3))


def directions(count: int, seed: int) -> np.ndarray:
    drawn = np.random.default_rng(seed).normal(size=(count, 3))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("form", "mu", "sigma"),
    [(RH01_FORM, 1.4, 0.1), (GGX_FORM, 1.5, 0.3), (RH01_FORM, None, 0.05)],
    ids=["rh01", "ggx", "narrow"],
)
def test_maps_reflect_what_the_integral_over_the_light_does(form, mu, sigma) -> None:
    brdf = Microfacet(np.zeros(3), np.ones(3), mu, sigma, form)
    (element,) = light_elements(Lighting("room", room(), NOTHING, NOTHING))
    element = element.without_sources
    normals, views = directions(600, 1), directions(600, 2)
    # As a ball is seen: the middle of it more often than its rim.
    cos = (normals * views).sum(axis=1)
    normals, views = normals[cos > 0.05], views[cos > 0.05]
    truth = form_transfer(form, replace(element, finer=True), normals, views, np.array([sigma]), OneIndex(mu))
    found = lobe_maps(brdf, element, 1.0).towards(normals, views)
    apart = found - truth.reshape(len(normals), -1)[:, :3]
    # Terms hold all but 1% of what is reflected, a narrow lobe's as many as fit; grazing views have half of the error.
    assert np.sqrt((apart**2).mean() / (truth**2).mean()) < 0.04


@pytest.mark.parametrize(
    "form", [RH01_FORM, GGX_FORM, next(iter(PLASTICS.values()))], ids=lambda form: form.name
)
def test_the_table_of_a_lobe_holds_the_lobe(form) -> None:
    sigma = 0.2
    brdf = Microfacet(np.zeros(3), np.ones(3), 1.5, sigma, form)
    normal, half = (
        np.array([0.0, 0.0, 1.0]),
        np.random.default_rng(3).normal(size=(4000, 3)) * [sigma, sigma, 0],
    )
    half = (half + normal) / np.linalg.norm(half + normal, axis=1, keepdims=True)
    views = directions(4000, 4)
    views[:, 2] = np.abs(views[:, 2])
    lights = 2 * (half * views).sum(axis=1, keepdims=True) * half - views
    up = (lights[:, 2] > 0.05) & (views[:, 2] > 0.05)
    half, views, lights = half[up], views[up], lights[up]
    theta_h, theta_d = np.arccos(half[:, 2].clip(-1, 1)), np.arccos((half * views).sum(axis=1).clip(-1, 1))
    sines = np.maximum(np.sin(theta_h) * np.sin(theta_d), 1e-9)
    phi = np.arccos(((np.cos(theta_h) * np.cos(theta_d) - lights[:, 2]) / sines).clip(-1, 1))
    truth = form.lobe_of(1.5, sigma)(normal, lights, views)
    found = lobe_volume(brdf).at(theta_h, theta_d, phi) / views[:, 2]
    # Linear between 96 x 48 x 24 entries.
    assert np.sqrt(((found - truth) ** 2).mean() / (truth**2).mean()) < 0.01


def test_vertices_receive_what_a_turned_light_sends_them(tmp_path: Path) -> None:
    studio, lighting = studio_of(gloss(tmp_path / "result"))
    mesh = tessellated(np.zeros(3), 0.02, 16)
    light = live_light(studio, lighting, mesh)
    (element,) = light_elements(lighting)
    for degrees in (0.0, 37.0, 200.0):
        rest = turned(element, np.zeros(3), degrees).without_sources
        truth = base_irradiance(RH01_FORM, None, rest, mesh.normals, None)
        found = light.irradiance(np.radians(degrees)) * light.unit
        # The series ends where it misses 0.2% of all of it, and what a map turned between columns is off by.
        assert_allclose(found, truth, atol=0.01 * truth.max())
        places = light.lamps_turned(np.radians(degrees))[:, :3]
        assert_allclose(places, turned(element, np.zeros(3), degrees).directions, atol=1e-6)


def smaller_comparison(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two pictures, of 80 pixels: smooth spheres show no more in larger ones."""
    monkeypatch.setattr("invrender.output.live.drawn._SIDE", 80)
    monkeypatch.setattr("invrender.output.live.drawn._COMPARED", ((75.0, 50.0, 40.0), (190.0, -10.0, 125.0)))


@pytest.mark.parametrize("shape", ["sphere", pytest.param("cat", marks=pytest.mark.sweep)])
def test_a_browser_draws_what_render_renders(
    shape: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if shape == "sphere":
        smaller_comparison(monkeypatch)
    # Of the cat, pixels through which the border of a shadow runs: four rays against thirty-six.
    mesh, most = (None, 0.01) if shape == "sphere" else (request.getfixturevalue("cat_mesh"), 0.03)
    studio, lighting = studio_of(gloss(tmp_path / "result"), mesh)
    scene = live_scene(studio, [lighting])
    assert scene.has_shadows == (mesh is not None)
    error = live_error(scene, studio, [lighting])
    assert error.rms <= error.worst < most
    assert f"{error.rms:.1%}" in error.stated
    # What is measured is the light as it is turned: turned the wrong way it is far off.
    (light,) = scene.lights
    flipped = replace(light, lamps=light.lamps * [1, -1, 1, 1])
    assert live_error(replace(scene, lights=(flipped,)), studio, [lighting]).worst > 3 * most


def test_a_mesh_of_many_faces_is_drawn_with_fewer_which_is_said(
    cat_mesh: TriangleMesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few, many = 4000, 7000
    monkeypatch.setattr("invrender.output.live.few_faces.MOST_FACES", few)
    # One small picture of a matte cat shows what the faces do.
    monkeypatch.setattr("invrender.output.live.drawn._SIDE", 60)
    monkeypatch.setattr("invrender.output.live.drawn._COMPARED", ((0.0, 20.0, 0.0),))
    write_result(tmp_path / "result", interreflection={"taken_off": False})
    write_exr(tmp_path / "result" / "lighting.exr", room())
    studio, lighting = studio_of(tmp_path / "result", simplified(cat_mesh, many))
    scene = live_scene(studio, [lighting])
    assert len(scene.mesh.faces) <= few
    assert scene.notes == (f"The mesh of {many:,} faces is shown with {len(scene.mesh.faces):,}.",)
    # It is compared with the whole mesh. It is 3% off, most of it where borders of shadows run.
    assert live_error(scene, studio, [lighting]).worst < 0.05


def test_what_varies_from_vertex_to_vertex_stays_in_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("invrender.output.live.few_faces.MOST_FACES", 1000)
    ball = tessellated(np.zeros(3), 0.02, 32)
    studio, _ = studio_of(gloss(tmp_path / "result"), ball)
    assert isinstance(studio.subject.body, MeshBody)
    mesh = studio.subject.body.mesh
    one = np.zeros((1, 1, 3))
    heights = 0.5 + 20 * mesh.vertices[None]
    known = (mesh.vertices[None, :, 2] > 0).astype(float)
    textures = SavedTextures(heights, one + 0.05, one, one, known, at_vertices=True)
    shown, notes = with_few_faces(replace(studio, material=replace(studio.material, textures=textures)))
    assert notes
    assert isinstance(shown.subject.body, MeshBody)
    vertices = shown.subject.body.mesh.vertices
    assert shown.material.textures is not None
    assert shown.material.textures.known is not None
    # Vertices lie above the ball; its faces, with edges of 2 mm, 0.025 mm below it. At its middle some aren't known.
    whole = vertices[:, 2] > 0.002
    places = 0.02 * vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    assert_allclose(shown.material.textures.kd[0, whole], 0.5 + 20 * places[whole], atol=20 * 5e-5)
    assert_allclose(shown.material.textures.known[0, whole], 1)
    assert_allclose(shown.material.textures.known[0, vertices[:, 2] < -0.002], 0)


def test_a_mesh_of_nothing_but_seams_loses_them_and_keeps_its_texture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scans have a chart of their texture for every few faces, and files of facets a normal for each."""
    monkeypatch.setattr("invrender.output.live.few_faces.MOST_FACES", 1000)
    ball = tessellated(np.zeros(3), 0.02, 32)
    corners = ball.vertices[ball.faces]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    whole = np.linalg.norm(facets, axis=1) > 1e-9
    facets = facets[whole] / np.linalg.norm(facets[whole], axis=1, keepdims=True)
    corners = corners[whole]
    # Each face has a row of texels of its own, which rises with z; u is z.
    rows, count = np.arange(len(corners)), len(corners)
    heights = np.clip(corners[..., 2] / 0.04 + 0.5, 0.01, 0.99)
    uv = np.stack([heights, 1 - (np.broadcast_to(rows[:, None], heights.shape) + 0.5) / count], axis=-1)
    texels = np.broadcast_to((np.arange(64)[None, :, None] + 0.5) / 64, (count, 64, 3))
    soup = TriangleMesh(
        corners.reshape(-1, 3),
        np.arange(3 * count).reshape(-1, 3),
        facets.repeat(3, axis=0),
        uv.reshape(-1, 2),
    )
    studio, _ = studio_of(gloss(tmp_path / "result"), soup)
    one = np.zeros((1, 1, 3))
    textures = SavedTextures(texels.copy(), one + 0.05, one, one)
    shown, notes = with_few_faces(replace(studio, material=replace(studio.material, textures=textures)))
    assert notes == (
        f"The mesh of {count:,} faces is shown with {len(shown.subject.body.mesh.faces):,}, smooth everywhere and its"
        " texture from corner to corner.",
    )
    vertices = shown.subject.body.mesh.vertices
    assert shown.subject.body.mesh.uv is None
    assert shown.material.textures is not None
    assert shown.material.textures.at_vertices
    # Vertices lie up to 0.03 mm above the ball, of 40 mm; texels show 0.6 mm each.
    assert_allclose(shown.material.textures.kd[0, :, 0], vertices[:, 2] / 0.04 + 0.5, atol=0.012)


def test_what_borders_keep_from_getting_fewer_faces_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("invrender.output.live.few_faces.MOST_FACES", 10)
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    apart = (triangle + 2 * np.arange(20)[:, None, None]).reshape(-1, 3)
    normals = np.broadcast_to([0.0, 0, 1], apart.shape)
    with pytest.raises(ValueError, match=r"cat\.obj: its mesh has 20 faces.* its borders keep 20"):
        few_faces(TriangleMesh(apart, np.arange(60).reshape(-1, 3), normals), "cat.obj")


def test_textures_keep_to_the_texels_that_are_known() -> None:
    texels = np.random.default_rng(5).uniform(0.1, 0.9, (8, 16, 3))
    known = np.ones((8, 16))
    known[2:4, 3:9] = 0
    nothing = np.zeros((1, 1, 3))
    textures = SavedTextures(texels, np.full((1, 1, 3), 0.05), nothing, nothing, known)
    brdf = Microfacet(texels.mean(axis=(0, 1)), np.full(3, 0.05), 1.5, 0.1)
    kd, ks = live_reflectances(Reflectance(brdf, np.zeros((3, 4, 4)), {}, (), textures), 7)
    assert kd.has_gaps
    assert not ks.has_gaps
    assert_allclose(kd.codes[..., 3], 255 * known)
    assert_allclose(kd.scale, texels[known > 0].max(axis=0))
    assert_allclose(ks.scale, 0.05)
    assert kd.at_vertices.shape == (7, 4)


def test_a_scene_is_packed_as_its_page_reads_it(tmp_path: Path) -> None:
    studio, lighting = studio_of(gloss(tmp_path / "result"))
    scene = live_scene(studio, [lighting])
    (light,) = scene.lights
    assert packed_light(light) == packed_light(light)
    for data, name, values in (
        (packed_subject(scene), "positions", (scene.mesh.vertices - scene.centre) / scene.radius),
        (packed_light(light), "maps", light.maps.maps),
    ):
        block = gzip.decompress(data)
        length = int.from_bytes(block[:4], "little")
        header = json.loads(block[4 : 4 + length])
        entry = header["arrays"][name]
        assert (4 + length) % 8 == entry["offset"] % 8 == 0
        kind = {"f16": np.float16, "f32": np.float32}[entry["type"]]
        start = 4 + length + entry["offset"]
        read = np.frombuffer(block, kind, int(np.prod(entry["shape"])), start).reshape(entry["shape"])
        assert_allclose(read, values, atol=1e-6)


def test_the_page_holds_all_that_it_shows(
    lightfactor: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    smaller_comparison(monkeypatch)
    folder = gloss(tmp_path / "result")
    code, out, err = lightfactor("export", folder, "--format", "html", "-o", tmp_path / "page")
    assert (code, err) == (0, "")
    text, document = ((tmp_path / "page" / name).read_text() for name in ("object.html", "export.json"))
    assert "Live pictures are off by" in " ".join(out.split())
    error = json.loads(document)["error"]
    assert 0 < error["rms"] <= error["worst"] < 0.02
    for asked in ("http:", "https:", "src=", "@import", "url("):
        assert asked not in text
    assert "\nimport " not in text


def test_what_a_page_can_not_be_is_said(lightfactor: Command, tmp_path: Path) -> None:
    folder = gloss(tmp_path / "result")
    for options, said in (
        (("--format", "html", "--light"), "leave out --light"),
        (("--format", "html", "--albedo", "0.5"), "leave out --albedo"),
        (("--format", "htm"), "did you mean 'html'?"),
    ):
        code, _, err = lightfactor("export", folder, *options, "-o", tmp_path / "page")
        assert code == 1
        assert said in err
    assert not (tmp_path / "page").exists()
    brushed = {"model": "brushed beckmann", "brushed_about": [0, 0, 1]}
    write_result(tmp_path / "metal", "beckmann", 1.5, 0.1)
    path = tmp_path / "metal" / "result.json"
    document = json.loads(path.read_text())
    document["brdf"] |= brushed
    path.write_text(json.dumps(document))
    code, _, err = lightfactor("export", tmp_path / "metal", "--format", "html", "-o", tmp_path / "page")
    assert code == 1
    assert "brushed" in err

"""Terms of predicted pictures' gradients against brute force, analytic truths, and as a command."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from capture.arc.gantry import Arc
from capture.camera import Camera
from invrender.brdf.microfacet import Microfacet
from invrender.output.gradients import run
from invrender.output.gradients.document import TERMS
from invrender.output.gradients.photograph import photo_gradients
from invrender.output.render.subject import Subject, mesh_subject, sphere_subject
from invrender.result.reflectance import Reflectance
from invrender.result.saved_textures import SavedTextures
from invrender.transport.transfer import LightElement
from recon.mesh.bodies import MeshBody
from recon.mesh.trianglemesh import TriangleMesh
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.render.gather import from_source
from synthetic.shapes.ball import Ball
from synthetic.shapes.surface import Points

from .renders import plates, read, tile_result

Command = Callable[..., tuple[int, str, str]]
Floats = NDArray[np.float64]

CENTRE, RADIUS = np.array([0.001, 0.0, -0.001]), 0.02
LAMP = PointSource(np.array([0.05, -0.03, 0.025]), np.array([0.006, 0.005, 0.004]))
SUN = DirectionalSource(np.array([0.5, 0.6, 0.8]), np.array([0.3, 0.2, 0.1]))
DELRIN = radiometric(RH01_MATERIALS["delrin"])
# Of a pixel: central differences err by its square.
STEP = 1e-3
# Rays meet meshes in single precision, 1e-7 of a tile, of which a pixel is 1/300.
HITS = 1e-4


def material(kd: object = (0.1, 0.2, 0.3), textures: SavedTextures | None = None) -> Reflectance:
    """A Lambertian one, known exactly."""
    matte = Microfacet(np.array(kd, float), np.zeros(3), None, None)
    return Reflectance(matte, np.zeros((3, 4, 4)), {}, (), textures)


def lights(*sources: DirectionalSource | PointSource) -> LightElement:
    """Sources as predictions take them: a row (u, q) is seen from p towards u - q p."""
    rows = [
        np.append(of.position, 1.0) if isinstance(of, PointSource) else np.append(of.direction, 0.0)
        for of in sources
    ]
    strengths = [of.intensity if isinstance(of, PointSource) else of.irradiance for of in sources]
    return LightElement("lights", np.array(rows), np.array(strengths))


def brute_force(ball: Ball, points: Points, views: Floats) -> Floats:
    """Radiance (n, 3) that the scenes' own renderer finds at points."""
    irradiance, lobe = np.zeros((2, len(views), 3))
    for source in (SUN, LAMP):
        from_source(ball, DELRIN, source, points, views, irradiance, lobe)
    return np.asarray(DELRIN.kd * irradiance + DELRIN.ks * lobe)


def test_terms_on_a_ball_near_a_lamp_are_differences_of_brute_force() -> None:
    ball = Ball(CENTRE, RADIUS)
    pose = Arc(np.zeros(3), [0, 0, 1], 0.2, [1, 0, 0]).pose(np.radians(20.0))
    camera = Camera("PINHOLE", np.array([8000.0, 8000.0, 1200.0, 1000.0]), 2400, 2000, pose)
    reflectance = Reflectance(
        Microfacet(DELRIN.kd, DELRIN.ks, DELRIN.mu, DELRIN.sigma), np.zeros((3, 4, 4)), {}, ()
    )
    found = photo_gradients(sphere_subject(CENTRE, RADIUS), camera, reflectance, lights(SUN, LAMP), 3000)

    def seen(off: Floats) -> tuple[Points, Floats]:
        origins, directions = camera.rays(found.middles + off)
        hit, points = ball.first_hits(origins, directions)
        assert hit.all()
        return points, -directions

    at, views = seen(np.zeros(2))
    assert_allclose(found.terms.radiance, brute_force(ball, at, views), rtol=1e-9, atol=1e-12)
    # Nor at a horizon, where it has a kink; nor where pixels are long on the surface.
    smooth = (at.normals * views).sum(axis=1) > 0.3
    for source in (SUN, LAMP):
        smooth &= np.abs((at.normals * source.at(at.positions)[0]).sum(axis=1)) > 0.01
    assert smooth.sum() > 1000

    def agrees(values: Floats, ends: list[tuple[Points, Floats]], way: int) -> None:
        more, less = (brute_force(ball, *end) for end in ends)
        expected = (more - less)[smooth] / (2 * STEP)
        # Half a pixel is 1/1600 of the radius: chords err by less than a thousandth of what the largest gradient is.
        assert_allclose(values[smooth, way], expected, atol=1e-3 * np.abs(expected).max())

    for way in (0, 1):
        ends = [seen(sign * STEP * np.eye(2)[way]) for sign in (1, -1)]
        agrees(found.terms.whole, ends, way)
        agrees(found.terms.spatial, [(replace(at, positions=p.positions), views) for p, _ in ends], way)
        agrees(found.terms.perspective, [(at, towards) for _, towards in ends], way)
        agrees(
            found.terms.curvature,
            [(replace(at, normals=p.normals, tangents=p.tangents), views) for p, _ in ends],
            way,
        )
    # All three are there to be told apart.
    three = (found.terms.spatial, found.terms.perspective, found.terms.curvature)
    strengths = [np.abs(term).max() for term in three]
    assert min(strengths) > 0.01 * max(strengths)
    assert not found.terms.texture.any()
    assert not np.any(found.terms.visibility)
    # 1 / d against 2 / r.
    _, distances, _ = LAMP.at(at.positions)
    lit = (at.normals * LAMP.at(at.positions)[0]).sum(axis=1) > 0
    assert_allclose(found.curvature, 1 / RADIUS, rtol=1e-9)
    assert_allclose(found.nearness, np.where(lit, RADIUS / (2 * distances), 0), rtol=1e-9)


def plate(kd_maps: SavedTextures | None = None) -> tuple[Subject, Camera, Reflectance]:
    """A tile of 1 m that faces up, seen from 3 m above by a camera that sees it as 300 pixels."""
    corners = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    mesh = TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.tile([0, 0, 1.0], (4, 1)))
    return Subject(MeshBody(mesh), np.zeros(3), 0.8), from_above(300, 300), material(textures=kd_maps)


def from_above(width: int, height: int) -> Camera:
    pose = np.diag([1.0, -1, -1, 1])
    pose[2, 3] = 3
    return Camera("PINHOLE", np.array([900.0, 900.0, width / 2, height / 2]), width, height, pose)


def test_on_a_plate_near_a_lamp_all_is_spatial() -> None:
    subject, camera, reflectance = plate()
    lamp = PointSource(np.array([0.1, 0.2, 0.4]), np.array([1.0, 2.0, 3.0]))
    found = photo_gradients(subject, camera, reflectance, lights(lamp), 5000)
    # A pixel is 3 m / 900 wide; rows go down, towards -Y.
    x, y = ((found.middles - 150) * [1, -1] / 300).T
    away = np.column_stack([0.1 - x, 0.2 - y, np.full(len(x), 0.4)])
    distance = np.linalg.norm(away, axis=1)
    # B = kd I h / d^3, whose gradient is 3 kd I h / d^5 times the way to the lamp.
    slopes = 3 * 0.4 / distance**5 * (away[:, :2] * [1, -1]).T / 300
    expected = slopes.T[..., None] * (reflectance.brdf.kd * lamp.intensity)
    assert_allclose(found.terms.spatial, expected, atol=HITS * np.abs(expected).max())
    for rest in (found.terms.curvature, found.terms.perspective, found.terms.texture):
        assert_allclose(rest, 0, atol=1e-9 * np.abs(expected).max())
    assert (found.curvature == 0).all()
    assert np.isinf(found.nearness).all()


def test_paint_that_varies_is_the_texture_term() -> None:
    ramp = np.array([[0.1, 0.1, 0.1], [0.3, 0.2, 0.1], [0.3, 0.2, 0.1], [0.1, 0.1, 0.1]])
    none = np.zeros((1, 1, 3))
    paint = SavedTextures(ramp[None], none, none, none, at_vertices=True)
    subject, camera, reflectance = plate(paint)
    found = photo_gradients(subject, camera, reflectance, lights(SUN), 5000)
    irradiance = SUN.irradiance * SUN.direction[2]
    # To the right Kd rises by its difference over 300 pixels, down it stays.
    expected = np.zeros_like(found.terms.texture)
    expected[:, 0] = np.array([0.2, 0.1, 0]) / 300 * irradiance
    assert_allclose(found.terms.texture, expected, atol=HITS * expected.max())
    assert_allclose(found.remainder, 0, atol=1e-12)
    assert not found.nearness.any()


def test_a_shadow_is_the_visibility_term(tmp_path: Path) -> None:
    plates(tmp_path / "plates.ply")
    subject = mesh_subject(tmp_path / "plates.ply", None)
    # From the left above the upper plate, 0.3 m to either side, 0.5 m up: its shadow lies to the right.
    sun = DirectionalSource(np.array([-1.0, 0, 1]), np.array([2.0, 2, 2]))
    found = photo_gradients(subject, from_above(900, 20), material(), lights(sun), 900**2)
    assert found.stride == 1
    lit = material().brdf.kd * sun.irradiance * np.sqrt(0.5)
    visibility = found.picture(np.asarray(found.terms.visibility))
    middle = visibility[len(visibility) // 2, :, 0]
    table = (np.arange(middle.shape[0]) + found.first[1] - 450) / 300
    # The right border of the shadow of its upper side, 0.6 m up, is at 0.9 m: from dark to lit.
    border = (table > 0.8) & (table < 0.97)
    assert_allclose(middle[border].sum(axis=0), lit, rtol=1e-6)
    assert (np.abs(middle[border]).sum(axis=1) > 0).sum() <= 3
    # Beyond it nothing changes.
    assert not middle[table > 0.97][:-3].any()
    assert_allclose(found.remainder, 0, atol=1e-9)


def photographs(*files: str) -> list[dict[str, object]]:
    return [{"file": file, "lighting": "sky", "held_out": False, "rms_relative": 0.0} for file in files]


def test_the_command_writes_terms_that_add_up(lightfactor: Command, workshop: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, said, err = lightfactor("gradients", workshop / "result", "-o", out, "--photo", "001.exr")
    assert (code, err) == (0, "")
    document = json.loads((out / "gradients.json").read_text())
    (entry,) = document["photos"]
    assert entry["file"] == "001.exr"
    assert sum(entry["terms"][name]["share"] for name in TERMS) == pytest.approx(1)
    assert entry["terms"]["curvature"]["share"] > 0.9
    # Its radius is 20 mm, and a hundredth is where light becomes near.
    assert entry["near"]["near_below_m"]["median"] == pytest.approx(1.0, rel=0.02)
    assert "1 m (median pixel) would count as near" in said
    radiance, layers = read(out / "001.exr")
    assert {f"{name}-{way}" for name in TERMS for way in "xy"} | {"near"} == set(layers)
    # Where they are smooth, terms are what the picture's own neighbours differ by.
    whole = sum(layers[f"{name}-x"] for name in TERMS)
    shown = (radiance > 0).all(axis=2)
    inside = shown[:, 1:-1] & shown[:, 2:] & shown[:, :-2]
    between = (radiance[:, 2:] - radiance[:, :-2]) / 2
    off = (whole[:, 1:-1] - between)[inside]
    assert np.sqrt((off**2).mean() / (between[inside] ** 2).mean()) < 0.15
    assert (out / "001.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_photo_set_is_processed_first(
    lightfactor: Command, workshop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def processed(photoset: Path, out: Path) -> None:
        asked.append(photoset)
        shutil.copytree(workshop / "result", out)

    # What it makes is tested elsewhere, and takes its time.
    monkeypatch.setattr(run, "run_process", processed)
    out = tmp_path / "out"
    code, said, err = lightfactor("gradients", workshop / "set", "-o", out, "--pixels", 400)
    assert (code, err) == (0, "")
    assert asked == [workshop / "set"]
    assert (out / "result" / "report.html").is_file()
    entries = json.loads((out / "gradients" / "gradients.json").read_text())["photos"]
    assert [entry["file"] for entry in entries] == ["000.exr", "001.exr", "002.exr", "003.exr"]
    assert all(150 < entry["pixels"] < 600 for entry in entries)
    assert "mean of 4" in said


def test_flat_facets_are_said(lightfactor: Command, tmp_path: Path) -> None:
    result = tile_result(tmp_path, photos=photographs("000.exr"))
    code, said, err = lightfactor("gradients", result, "-o", tmp_path / "out")
    assert (code, err) == (0, "")
    assert "The mesh has flat facets: at 100% of the pixels the normal doesn't turn" in said
    (entry,) = json.loads((tmp_path / "out" / "gradients.json").read_text())["photos"]
    # A tile under a white sky looks the same all over.
    assert entry["near"]["near_below_m"]["median"] is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("result", "--photo", "01.exr"), "--photo 01.exr: "),
        (("set", "--photo", "01.exr"), "--photo 01.exr: "),
        (("result", "--set", "nowhere"), "nowhere"),
        (("set", "--set", "set"), "--set names the photo set of a result"),
        (("nothing",), "nothing: does not exist"),
        (("result", "--assume", "sigma=x"), "'x' is not a number"),
    ],
)
def test_bad_input_is_one_sentence(
    lightfactor: Command, workshop: Path, tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    source, *options = arguments
    options = [str(workshop / name) if name == "set" else name for name in options]
    code, _, err = lightfactor("gradients", workshop / source, *options, "-o", tmp_path / "out")
    assert code == 1
    assert words in err
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()


def test_a_result_without_photographs_is_refused(lightfactor: Command, tmp_path: Path) -> None:
    code, _, err = lightfactor("gradients", tile_result(tmp_path), "-o", tmp_path / "out")
    assert code == 1
    assert "holds no photographs" in err

"""Lamps near the object: each point sees them in a direction and a strength of its own."""

from __future__ import annotations

import json
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.arc.gantry import Arc
from capture.camera import Camera
from capture.files.imagefile import read_pixels
from capture.lighting import Lighting, seen_from
from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import GGX_FORM, PLASTICS, RH01_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.plan.photographs import unexposed
from invrender.transport.columns import photo_columns
from invrender.transport.predict import predict, predict_columns
from invrender.transport.transfer import LightElement, light_elements
from recon.mesh.bodies import MeshBody, SphereBody, sees
from recon.mesh.trianglemesh import TriangleMesh
from recon.sampling.draw import sample_body
from recon.sampling.lightfield import LightField
from recon.sphere.sphere import Sphere
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import PointSource
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.scene import Scene, Shot
from synthetic.scenes.schema import BallTable
from synthetic.shapes.ball import Ball
from synthetic.staging import Staging
from synthetic.writer import write_photoset

Command = Callable[..., tuple[int, str, str]]

CENTRE, RADIUS = np.array([0.001, 0.0, -0.001]), 0.02
LAMP = PointSource(np.array([0.05, -0.03, 0.025]), np.array([0.006, 0.005, 0.004]))
BALL = SphereBody(Sphere(CENTRE, RADIUS, np.zeros((4, 4))))
DELRIN = radiometric(RH01_MATERIALS["delrin"])


def lit_by(lamp: PointSource, centre: np.ndarray = CENTRE) -> Lighting:
    """A lamp as lightings have it, with a distant source beside it."""
    offset = lamp.position - centre
    distance = np.linalg.norm(offset)
    return Lighting(
        "lamp",
        None,
        np.array([[0.0, 0.6, 0.8], offset]),
        np.array([[0.3, 0.2, 0.1], lamp.intensity / distance**2]),
        closeness=np.array([0, 1 / distance]),
        centre=centre,
    )


def camera(angle_deg: float = 20.0) -> Camera:
    pose = Arc(np.zeros(3), [0, 0, 1], 0.6, [1, 0, 0]).pose(np.radians(angle_deg))
    return Camera("PINHOLE", np.array([720.0, 720.0, 40.0, 30.0]), 80, 60, pose)


def sphere_field(lighting: Lighting, samples: int = 60) -> LightField:
    return sample_body(
        BALL, camera(), unexposed(camera()), None, lighting.sources, samples, np.random.default_rng(3)
    )


def test_points_see_a_lamp_as_the_scenes_renderer_does() -> None:
    points = np.random.default_rng(1).normal(scale=0.02, size=(20, 3))
    lighting = lit_by(LAMP)
    directions, factors = seen_from(lighting.sources, points)
    towards, _, irradiances = LAMP.at(points)
    assert_allclose(directions[:, 1], towards, atol=1e-12)
    assert_allclose(factors[:, 1:] * lighting.irradiances[1], irradiances, rtol=1e-12)
    # The distant source beside it looks the same from everywhere.
    assert_allclose(directions[:, 0], np.tile(lighting.directions[0], (20, 1)), atol=1e-15)
    assert_allclose(factors[:, 0], 1, atol=1e-15)


@pytest.mark.parametrize("form", [RH01_FORM, GGX_FORM, PLASTICS[GGX_FORM]], ids=lambda form: form.name)
def test_each_point_sees_a_distant_source_of_its_own(form: LobeForm) -> None:
    lighting, brdf = lit_by(LAMP), Microfacet(DELRIN.kd, DELRIN.ks, 1.5, 0.1, form)
    field = sphere_field(lighting)
    elements = light_elements(lighting)
    found = predict(brdf, elements, np.ones((1, 3)), field)
    # The lamp as the scene's own renderer has it, at one ray after the other.
    directions, _, irradiances = LAMP.at(field.positions)
    alone = np.empty_like(field.positions)
    for k in range(len(alone)):
        source = LightElement(
            "one",
            np.stack([lighting.directions[0], directions[k]]),
            np.stack([lighting.irradiances[0], irradiances[k]]),
        )
        ray = replace(one_ray(field, k), radiance=np.zeros((1, 3)))
        alone[k] = predict(brdf, [source], np.ones((1, 3)), ray)[0]
    # Equal to rounding; columns interpolate in mu and sigma.
    assert_allclose(found, field.mean_over_rays(alone), rtol=1e-9)
    columns = photo_columns("lamp", elements, field, form)
    assert_allclose(predict_columns(columns, brdf, np.ones((1, 3))), found, rtol=2e-3)
    # The lamp is near: from afar it would look otherwise.
    afar = predict(brdf, light_elements(lighting.from_afar), np.ones((1, 3)), field)
    assert np.abs(afar - found).max() > 0.2 * found.max()


def one_ray(field: LightField, k: int) -> LightField:
    """A ray of a field as a sample of its own."""
    nothing = np.zeros((1, 3))
    return LightField(
        rows=np.zeros(1),
        columns=np.zeros(1),
        radiance=nothing,
        variance=nothing,
        weight=np.ones(1),
        ray_sample=np.zeros(1),
        positions=field.positions[k : k + 1],
        normals=field.normals[k : k + 1],
        views=field.views[k : k + 1],
        reflected_visible=np.ones(1, bool),
        sources_visible=np.zeros((1, 0), bool),
    )


def test_a_lamp_far_away_is_a_distant_source() -> None:
    brdf = Microfacet(DELRIN.kd, DELRIN.ks, 1.5, 0.1)
    far = PointSource(CENTRE + 1e5 * np.array([0.6, -0.48, 0.64]), np.full(3, 1e10))
    lighting = lit_by(far)
    field = sphere_field(lighting)
    found = predict(brdf, light_elements(lighting), np.ones((1, 3)), field)
    # By the object's radius over the distance, 2e-7, over the lobe's width.
    distant = predict(brdf, light_elements(lighting.from_afar), np.ones((1, 3)), field)
    assert_allclose(found, distant, atol=1e-5 * found.max())


def two_plates() -> MeshBody:
    """Two facing squares, 0.2 m wide: at x = 0, looking along +X, and at x = 0.1, looking back."""
    square = np.array([[0, -0.1, -0.1], [0, 0.1, -0.1], [0, 0.1, 0.1], [0, -0.1, 0.1]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    other = square + np.array([0.1, 0, 0])
    normals = np.repeat([[1.0, 0, 0], [-1.0, 0, 0]], 4, axis=0)
    mesh = TriangleMesh(np.vstack([square, other]), np.vstack([faces, faces[:, ::-1] + 4]), normals)
    return MeshBody(mesh)


def test_what_lies_behind_a_lamp_casts_no_shadow() -> None:
    body = two_plates()
    rng = np.random.default_rng(0)
    points = np.column_stack([np.zeros(50), rng.uniform(-0.09, 0.09, (50, 2))])
    facets = np.tile([1.0, 0, 0], (50, 1))
    between, behind = np.array([0.05, 0, 0]), np.array([0.25, 0, 0])
    assert sees(body, points, facets, np.append(between, 1)).all()
    assert not sees(body, points, facets, np.array([1.0, 0, 0])).any()
    # From behind the second plate, rays to points y, z of the first cross it within its square.
    assert not sees(body, points, facets, np.append(behind, 1)).any()
    # The row may be scaled: 1 / distance from any centre is as good.
    assert sees(body, points, facets, np.append(between, 1) * 7).all()
    assert body.clearance(between) > 0


def test_clearance_tells_inside_from_outside() -> None:
    assert BALL.clearance(CENTRE + np.array([0.03, 0, 0])) == pytest.approx(0.01)
    assert BALL.clearance(CENTRE) == pytest.approx(-0.02)
    corners = np.array([[x, y, z] for x in (0, 1.0) for y in (0, 1.0) for z in (0, 1.0)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    cube = MeshBody(TriangleMesh(corners, np.array(faces), (corners - 0.5) / np.sqrt(0.75)))
    assert cube.clearance(np.array([0.4, 0.5, 0.6])) < 0
    # To the nearest vertex.
    assert cube.clearance(np.array([1.3, 1.4, 1.0])) == pytest.approx(0.5)


@pytest.fixture(scope="module")
def near_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four photographs of a delrin sphere under a lamp two of its diameters away, by brute force."""
    light = Illumination("lamp", (), (LAMP,))
    shots = tuple(Shot(camera(angle), light, angle == 10) for angle in (-80.0, -50.0, -20.0, 10.0))
    folder = tmp_path_factory.mktemp("near") / "set"
    write_photoset(Staging(Scene("near", Ball(CENTRE, RADIUS), DELRIN, shots)), folder)
    return folder


@pytest.mark.usefixtures("few_forms", "no_causes")
def test_a_near_lamp_is_solved_saved_rendered_and_exported(
    lightfactor: Command, near_set: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    code, said, _ = lightfactor("process", near_set, "-o", out)
    assert code == 0, said
    found = json.loads((out / "result.json").read_text())
    # 1% of noise is all that is left.
    assert found["fit"]["rms_relative"] < 0.012
    assert found["fit"]["held_out_rms_relative"] < 0.012
    for name, truth in (("kd", DELRIN.kd), ("ks", DELRIN.ks), ("mu", DELRIN.mu), ("sigma", DELRIN.sigma)):
        entry = found["brdf"][name]
        value, std = np.array(entry["value"]), np.array(entry["std"])
        assert np.all(np.abs(value - truth) < 4 * std), (name, value, std, truth)
        assert np.all(std < 0.15 * value)
    (source,) = found["lighting"][0]["directional"]
    assert_allclose(source["position"], LAMP.position, atol=1e-9)
    # Rendered where a photograph was taken it is that photograph, but for noise.
    code, _, said = lightfactor(
        "render", out, "--set", near_set, "--photo", "003.exr", "-o", tmp_path / "picture.exr"
    )
    assert code == 0, said
    shown, taken = read_pixels(tmp_path / "picture.exr"), read_pixels(near_set / "truth" / "003.exr")
    inside = (shown[..., :3] > 0).all(axis=-1) & (taken > 0.02 * taken.max()).all(axis=-1)
    off = shown[..., :3][inside] - taken[inside]
    assert np.sqrt(np.mean(off**2) / np.mean(taken[inside] ** 2)) < 0.01
    # Other programs get a lamp at its place: Mitsuba's lengths are millimetres here.
    assert lightfactor("export", out, "--format", "mitsuba", "-o", tmp_path / "mitsuba")[0] == 0
    (file,) = (tmp_path / "mitsuba").glob("*.xml")
    (emitter,) = (one for one in ET.parse(file).getroot().iter("emitter") if one.get("type") == "point")
    place = emitter.find("point")
    assert place is not None
    assert_allclose([float(place.get(axis, "nan")) for axis in "xyz"], 1000 * LAMP.position, rtol=1e-6)
    rgb = emitter.find("rgb")
    assert rgb is not None
    assert_allclose([float(v) for v in str(rgb.get("value")).split()], 1e6 * LAMP.intensity, rtol=1e-6)


@pytest.mark.parametrize(
    "recover",
    [pytest.param(False, marks=pytest.mark.slow), pytest.param(True, marks=pytest.mark.sweep)],
    ids=["known", "strength recovered"],
)
def test_a_near_lamp_that_is_called_distant_is_found(
    lightfactor: Command,
    near_set: Path,
    tmp_path: Path,
    request: pytest.FixtureRequest,
    no_pictures: None,
    recover: bool,
) -> None:
    if not recover:
        request.getfixturevalue("few_forms")
    folder = Path(shutil.copytree(near_set, tmp_path / "set"))
    manifest = folder / "photoset.toml"
    offset = LAMP.position - CENTRE
    distance = float(np.linalg.norm(offset))
    told = f"directional = [{{ direction = {offset.tolist()}"
    told += " }]" if recover else f", irradiance = {(LAMP.intensity / distance**2).tolist()} }}]"
    told += '\nrecover = ["irradiance"]' if recover else ""
    manifest.write_text(re.sub("near = .*", told, manifest.read_text()))
    code, said, _ = lightfactor("process", folder, "-o", tmp_path / "out")
    assert code == 0, said
    assert "Their distances from the object's centre were found with the BRDF: lamp: 0.0" in said
    found = json.loads((tmp_path / "out" / "result.json").read_text())
    assert found["fit"]["rms_relative"] < 0.012
    assert found["causes"] == []
    entry = found["lighting"][0]
    assert "distance" in entry["recovered"]
    (source,) = entry["directional"]
    # The direction is the centre's that masks showed: beside it the place is a distance.
    std = source["distance_std"]
    assert 0 < std < 0.01 * distance
    assert np.linalg.norm(np.array(source["position"]) - LAMP.position) < 4 * std + 1e-4 * distance
    if not recover:
        kd = found["brdf"]["kd"]
        assert np.all(np.abs(np.array(kd["value"]) - DELRIN.kd) < 4 * np.array(kd["std"]))


def test_a_near_lamp_of_unknown_light_is_found(
    lightfactor: Command, near_set: Path, tmp_path: Path, few_forms: None
) -> None:
    folder = Path(shutil.copytree(near_set, tmp_path / "set"))
    manifest = folder / "photoset.toml"
    manifest.write_text(re.sub("near = .*", "unknown = true\ndark = true", manifest.read_text()))
    code, said, err = lightfactor("process", folder, "-o", tmp_path / "out", "--samples", 1200)
    assert code == 0, err
    distance = float(np.linalg.norm(LAMP.position - CENTRE))
    assert "The lamps are near. Their distances" in " ".join(said.split())
    found = json.loads((tmp_path / "out" / "result.json").read_text())
    assert found["causes"] == []
    assert found["fit"]["rms_relative"] < 0.012
    assert found["fit"]["held_out_rms_relative"] < 0.012
    (source,) = found["lighting"][0]["directional"]
    std = source["distance_std"]
    assert 0 < std < 0.02 * distance
    # The direction is the centre's that masks showed, as above.
    assert np.linalg.norm(np.array(source["position"]) - LAMP.position) < 4 * std + 1e-3 * distance
    entry = found["brdf"]["ks"]
    off = np.array(entry["value"]) - DELRIN.ks / (DELRIN.kd + DELRIN.ks)
    assert (np.abs(off) < 4 * np.array(entry["std"])).all()
    code, said, _ = lightfactor("compare", tmp_path / "out", near_set / "truth.json")
    assert f"{distance:.4g} m in B" in " ".join(said.split())


@pytest.mark.sweep
def test_a_mirror_ball_from_two_places_tells_how_far_a_lamp_is(
    lightfactor: Command, tmp_path: Path, few_forms: None, no_causes: None
) -> None:
    light = Illumination("lamp", (), (LAMP,), "ball")
    shots = []
    for angle in (-80.0, -50.0, -20.0, 10.0):
        small = camera(angle)
        params = np.array([2100.0, 2100.0, 90.0, 80.0])
        shots.append(Shot(Camera("PINHOLE", params, 180, 160, small.world_to_camera), light))
    scene = Scene("near", Ball(CENTRE, RADIUS), DELRIN, tuple(shots))
    write_photoset(Staging(scene, ball=BallTable(azimuths_deg=(-60.0, 20.0))), tmp_path / "set")
    code, _, err = lightfactor("process", tmp_path / "set", "-o", tmp_path / "out")
    assert code == 0, err
    found = json.loads((tmp_path / "out" / "result.json").read_text())
    # Taken for distant, it leaves 12%.
    assert found["fit"]["rms_relative"] < 0.02
    (source,) = found["lighting"][0]["directional"]
    distance = float(np.linalg.norm(LAMP.position - CENTRE))
    std = source["distance_std"]
    assert abs(np.linalg.norm(source["position"] - CENTRE) - distance) < 3 * std < 0.2 * distance
    kd = found["brdf"]["kd"]
    assert np.all(np.abs(np.array(kd["value"]) - DELRIN.kd) < 4 * np.array(kd["std"]))


def test_samples_say_what_sees_a_near_lamp(lightfactor: Command, near_set: Path, tmp_path: Path) -> None:
    code, _, said = lightfactor("samples", near_set, "-o", tmp_path / "out", "--samples", 2000)
    assert code == 0, said
    with np.load(tmp_path / "out" / "samples" / "001.npz") as field:
        towards, _, _ = LAMP.at(field["positions"])
        # A sphere hides a lamp from what looks away from it, and from nothing else.
        assert (field["sources_visible"][:, 0] == ((field["normals"] * towards).sum(axis=1) > 0)).all()
        assert 0.1 < field["sources_visible"].mean() < 0.9


def test_what_a_lamp_at_a_place_may_not_be(lightfactor: Command, near_set: Path, tmp_path: Path) -> None:
    manifest = near_set / "photoset.toml"
    text = manifest.read_text()
    row = next(line for line in text.splitlines() if line.startswith("near ="))
    try:
        for other, said in (
            ("near = [{ position = [0, 0, 0], intensity = [1, 1, 1] }]", "lies inside the object"),
            ("near = [{ position = [0.023, 0, 0], intensity = [1, 1, 1] }]", "a tenth of its size (0.04 m)"),
            ("near = [{ position = [0.05, 0, 0] }]", "near source 1 has no intensity; give it, or"),
            (f"unknown = true\n{row}", "unknown = true contradicts near"),
        ):
            manifest.write_text(text.replace(row, other))
            code, _, err = lightfactor("process", near_set, "-o", tmp_path / "out")
            assert code == 1, other
            assert said in " ".join(err.split()), err
            assert not (tmp_path / "out").exists()
    finally:
        manifest.write_text(text)
    code, _, err = lightfactor("brdf", near_set, "-o", tmp_path / "out")
    assert code == 1
    assert "lamps at a place are for `lightfactor process`" in " ".join(err.split())

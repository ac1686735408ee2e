"""The built-in scenes: each is whole, says what it is for, and shows that."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS
from synthetic.materials.smith import SmithMaterial
from synthetic.materials.texture import Textured
from synthetic.scenes import build
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_names, scene_path
from synthetic.scenes.scenefile import read_scene_file
from synthetic.sensing.development import Development
from synthetic.shapes import doll
from synthetic.shapes.ball import Ball
from synthetic.shapes.meshing import mesh_implicit
from synthetic.shapes.meshsurface import MeshSurface
from synthetic.staging import Staging

# RH01, section 6, by figure; what can't be determined; what goes wrong; further materials, cameras and set-ups.
EXPERIMENTS = {
    *(f"rh01-{name}" for name in RH01_MATERIALS),
    "rh01-area",
    "rh01-cat",
    "rh01-doll",
    "rh01-lighting",
    "rh01-marschner",
    "rh01-teflon-3views",
}
FAILURES = {
    "fail-matte",
    "fail-near-light",
    "fail-no-grazing",
    "fail-one-photo",
    "fail-soft-light",
    "fail-texture-light",
    "fail-two-sources",
    "fail-unreached",
}
FAULTS = {
    "stress-noise",
    "stress-outliers",
    "stress-poses",
    "stress-saturation",
    "cat-interreflection",
    "cat-misaligned",
    "doll-poses",
}
OTHERS = {
    "anisotropic",
    "camera-bracket",
    "camera-raw",
    "demo",
    "exact-ggx",
    "exact-teflon",
    "phong",
    "turntable",
}


@pytest.fixture(scope="module", autouse=True)
def coarse_meshes() -> Iterator[None]:
    """Cat and doll with few triangles and without an atlas, each made once."""
    meshed = cache(lambda field, reach, edge: mesh_implicit(field, reach, 0.002))
    turned = cache(lambda edge: doll.doll_mesh(0.004))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "mesh_implicit", meshed)
        patch.setattr(build, "doll_mesh", turned)
        patch.setattr(build, "with_atlas", lambda mesh: mesh)
        patch.setattr(
            build, "doll_textures", lambda height: (np.full((4, 4, 3), 0.1), np.full((4, 4, 3), 0.02))
        )
        yield


@cache
def staging(name: str) -> Staging:
    return read_staging(scene_path(name))


def test_all_scenes_are_there() -> None:
    assert set(scene_names()) >= EXPERIMENTS | FAILURES | FAULTS | OTHERS
    assert scene_names() == tuple(sorted(scene_names()))


@pytest.mark.parametrize("name", scene_names())
def test_a_built_in_scene_is_whole(name: str) -> None:
    file = read_scene_file(scene_path(name))
    assert file.description.endswith(".")
    scene = staging(name).scene
    shot = scene.shots[0]
    # The object fills a good part of the picture, and no more unless it is meant to.
    pixels = (
        2
        * scene.surface.reach
        * shot.camera.focal_px
        / np.linalg.norm(shot.camera.centre - scene.surface.centre)
    )
    assert pixels / shot.camera.height > 0.5
    assert (pixels < shot.camera.height) == (name != "fail-unreached")
    # Photographs that are fitted exist, and most scenes keep some to score by.
    assert not all(shot.held_out for shot in scene.shots)


def test_no_two_scenes_have_one_name() -> None:
    # By which the command tells an earlier set of a scene from another one.
    names = [read_scene_file(scene_path(name)).name for name in scene_names()]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("name", RH01_MATERIALS)
def test_rh01s_spheres_have_the_numbers_of_fig_11(name: str) -> None:
    scene, row = staging(f"rh01-{name}").scene, RH01_MATERIALS[name]
    material = scene.material
    assert isinstance(material, MicrofacetMaterial)
    assert (material.mu, material.sigma) == (row.mu, row.sigma)
    np.testing.assert_allclose(material.kd / material.kd.max(), np.array(row.kd) / max(row.kd), rtol=1e-12)
    np.testing.assert_allclose(material.ks / material.kd.max(), np.array(row.ks) / max(row.kd), rtol=1e-12)
    # Section 6: an area light and a source, 60 photographs at intervals of 3 degrees.
    assert len(scene.shots) == 60
    (light,) = scene.illuminations
    assert (len(light.extended), len(light.sources)) == (1, 1)


def test_each_failure_has_its_cause() -> None:
    def light(name: str) -> object:
        return staging(name).scene.shots[0].illumination

    assert isinstance(staging("fail-matte").scene.material, Lambertian)
    assert len(staging("fail-one-photo").scene.shots) == 1
    (lamp,) = staging("fail-near-light").scene.shots[0].illumination.sources
    ball = staging("fail-near-light").scene.surface
    assert isinstance(lamp, PointSource)
    # Irradiance changes by more than half across the sphere.
    assert np.linalg.norm(lamp.position - ball.centre) < 8 * ball.reach
    pair = staging("fail-two-sources").scene
    first, second = pair.shots[0].illumination.sources
    assert isinstance(first, DirectionalSource)
    assert isinstance(second, DirectionalSource)
    assert isinstance(pair.material, MicrofacetMaterial)
    assert np.arccos(first.direction @ second.direction) < pair.material.sigma
    grazing = staging("fail-no-grazing").scene
    (source,) = grazing.shots[0].illumination.sources
    assert isinstance(source, DirectionalSource)
    for shot in grazing.shots:
        # The highlight's exitant angle is half that between source and camera.
        away = shot.camera.centre / np.linalg.norm(shot.camera.centre)
        assert np.degrees(np.arccos(away @ source.direction)) / 2 < 10
    secret = {"fail-matte", "fail-one-photo", "fail-texture-light", "fail-two-sources", "fail-unreached"}
    for name in FAILURES:
        assert (staging(name).scene.illuminations[0].given == "nothing") == (name in secret)


def test_shapes_materials_and_cameras_vary() -> None:
    assert isinstance(staging("rh01-cat").scene.surface, MeshSurface)
    assert isinstance(staging("rh01-doll").scene.material, Textured)
    assert isinstance(staging("demo").scene.surface, Ball)
    assert staging("cat-interreflection").scene.effort.bounces >= 2
    assert isinstance(staging("exact-teflon").scene.material, SmithMaterial)
    assert not staging("anisotropic").scene.material.is_isotropic
    raw, bracket = staging("camera-raw"), staging("camera-bracket")
    assert isinstance(raw.sensor, Development)
    assert isinstance(bracket.sensor, Development)
    assert (raw.sensor.file, np.isfinite(raw.sensor.sensor.focal_px)) == ("dng", True)
    assert len(bracket.sensor.bracket) == 3
    assert bracket.ball is not None
    assert raw.calibration is not None
    lights = {shot.illumination.name for shot in staging("turntable").scene.shots}
    assert len(lights) == len(staging("turntable").scene.shots)
    # Held out under a light of its own, of which the set tells all.
    for name in ("rh01-cat", "rh01-doll", "rh01-area"):
        last = staging(name).scene.shots[-1]
        assert last.held_out
        assert (last.illumination.name, last.illumination.given) == ("lamp", "all")

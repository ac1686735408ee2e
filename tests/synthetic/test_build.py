"""What is built from scene files: lights, materials, meshes and sensors of all kinds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.files.imagefile import write_exr
from recon.mesh.trianglemesh import write_mesh
from synthetic.lights.arealight import AreaLight
from synthetic.lights.disc import DiscLight
from synthetic.lights.latlong import LatLongLight
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.materials.facets import BeckmannSlopes, GGXSlopes
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.mirror import Mirror
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.plastic import Plastic
from synthetic.materials.smith import SmithMaterial
from synthetic.scenes.build import read_staging
from synthetic.sensing.development import Development
from synthetic.sensing.noise import Noise
from synthetic.shapes.ball import Ball
from synthetic.shapes.meshsurface import MeshSurface

from .scenetext import CAMERA, LIGHT, MATERIAL, OBJECT, WHOLE, read, tetrahedron


def test_the_least_that_a_scene_file_says(tmp_path: Path) -> None:
    staging = read(tmp_path, WHOLE)
    scene = staging.scene
    assert (scene.name, scene.seed, len(scene.shots)) == ("tiny", 0, 2)
    assert isinstance(scene.surface, Ball)
    assert isinstance(scene.material, Lambertian)
    assert scene.material.kd.tolist() == [0.2, 0.2, 0.2]
    assert staging.sensor == Noise()
    assert staging.source == WHOLE
    assert read_staging(tmp_path / "tiny.toml", seed=5).scene.seed == 5


def test_lights_of_all_kinds(tmp_path: Path) -> None:
    pixels = np.random.default_rng(1).uniform(0, 1, (4, 8, 3)).astype(np.float32)
    write_exr(tmp_path / "sky.exr", pixels)
    lights = (
        "area = [{ azimuth_deg = 90, radiance = [1, 2, 3], width_deg = 10 }]\n"
        "directional = [{ direction = [0, 0, 2], irradiance = 3 },"
        " { azimuth_deg = 180, elevation_deg = 30, irradiance = 1, radius_deg = 0.5 }]\n"
        "lamp = [{ azimuth_deg = 0, elevation_deg = 90, distance = 0.5, irradiance = [4, 8, 12] }]\n"
        'map = "sky.exr"\nmap_scale = 2\n'
    )
    text = WHOLE.replace(LIGHT, lights).replace(OBJECT, OBJECT + "centre = [0, 0, 0.001]\n")
    light = read(tmp_path, text).scene.shots[0].illumination
    area, latlong, disc = light.extended
    assert isinstance(area, AreaLight)
    assert_allclose(area.axis, [0, 1, 0], atol=1e-15)
    assert_allclose(area.width_rad, np.radians(10))
    assert area.radiance.tolist() == [1, 2, 3]
    assert isinstance(latlong, LatLongLight)
    assert_allclose(latlong.pixels, 2 * pixels)
    assert isinstance(disc, DiscLight)
    assert_allclose(disc.direction, [-np.sqrt(0.75), 0, 0.5], atol=1e-15)
    assert_allclose(disc.radius_rad, np.radians(0.5))
    distant, lamp = light.sources
    assert isinstance(distant, DirectionalSource)
    assert distant.direction.tolist() == [0, 0, 1]
    assert isinstance(lamp, PointSource)
    # The lamp stands so far from the object's centre, and gives that irradiance there.
    assert_allclose(lamp.position, [0, 0, 0.501], atol=1e-15)
    assert_allclose(lamp.at(np.array([[0, 0, 0.001]]))[2], [[4, 8, 12]], rtol=1e-12)


@pytest.mark.parametrize(
    ("table", "kind", "numbers"),
    [
        ("kd = 0.1\nks = 0.1\nsigma = 0.2\nmu = 1.5", MicrofacetMaterial, {"mu": 1.5, "sigma": 0.2}),
        (
            'model = "smith"\nkd = 0.1\nks = 0.05\nsigma = 0.2',
            SmithMaterial,
            {"facets": BeckmannSlopes(0.2, 0.2), "mu": None},
        ),
        (
            'model = "ggx"\nkd = 0.1\nks = 0.01\nalpha = 0.3\nmu = 1.5',
            SmithMaterial,
            {"facets": GGXSlopes(0.3, 0.3), "mu": 1.5},
        ),
        (
            'model = "anisotropic"\nkd = 0.1\nks = 0.1\nalpha_x = 0.3\nalpha_y = 0.1',
            SmithMaterial,
            {"facets": GGXSlopes(0.3, 0.1)},
        ),
        ('model = "plastic"\nkd = 0.1\nks = 0.04\nmu = 1.5\nalpha = 0.3', Plastic, {"is_isotropic": True}),
        ('model = "phong"\nkd = 0.1\nks = 0.1\nexponent = 20', PhongMaterial, {"exponent": 20.0}),
        ('name = "steel"', MicrofacetMaterial, {"mu": None, "sigma": 0.2}),
        (
            'model = "smith"\nname = "delrin"',
            SmithMaterial,
            {"mu": 1.44, "facets": BeckmannSlopes(0.10, 0.10)},
        ),
    ],
)
def test_materials_of_all_kinds(tmp_path: Path, table: str, kind: type, numbers: dict[str, object]) -> None:
    material = read(tmp_path, WHOLE.replace(MATERIAL, f"[material]\n{table}\n")).scene.material
    assert type(material) is kind
    assert {key: getattr(material, key) for key in numbers} == numbers


def test_a_mirror_is_seen_under_lights_with_a_size(tmp_path: Path) -> None:
    lights = "directional = [{ azimuth_deg = 0, irradiance = 1, radius_deg = 2 }]\n"
    text = WHOLE.replace(LIGHT, lights)
    mirror = read(
        tmp_path, text.replace(MATERIAL, '[material]\nmodel = "mirror"\nkd = 0\nks = 1\n')
    ).scene.material
    assert isinstance(mirror, Mirror)


def test_a_mesh_is_read_in_its_unit_and_stands_at_the_centre(tmp_path: Path) -> None:
    write_mesh(tmp_path / "body.obj", tetrahedron())
    shape = '[object]\nshape = "mesh"\nmesh = "body.obj"\nunit = "cm"\ncentre = [0.01, 0, 0]\n'
    staging = read(tmp_path, WHOLE.replace(OBJECT, shape))
    assert isinstance(staging.scene.surface, MeshSurface)
    assert staging.mesh is not None
    assert_allclose(np.abs(staging.mesh.vertices), 0.01)
    assert_allclose(staging.mesh_to_world[:3, 3], [0.01, 0, 0])
    assert_allclose(staging.scene.surface.centre, [0.01, 0, 0], atol=1e-12)


def test_sensors_have_the_defaults_of_their_files(tmp_path: Path) -> None:
    for file, bits, response in (
        ("png", 8, "srgb"),
        ("jpeg", 8, "srgb"),
        ("tiff", 16, "linear"),
        ("dng", 14, "linear"),
    ):
        sensor = read(tmp_path, WHOLE + f'[sensor]\nfile = "{file}"\n').sensor
        assert isinstance(sensor, Development)
        assert (sensor.sensor.bits, sensor.sensor.response, sensor.bracket) == (bits, response, (0.0,))
        assert np.isinf(sensor.sensor.focal_px)
    dark = read(tmp_path, WHOLE + '[sensor]\nfile = "tiff"\nread_noise = 0\nvignetting = true\n').sensor
    assert isinstance(dark, Development)
    assert (dark.sensor.read_noise == 0).all()
    assert dark.sensor.focal_px == 220


@pytest.mark.parametrize("given", ["ball", "nothing"])
def test_what_the_command_says_of_the_light_goes_for_fitted_photographs(tmp_path: Path, given: str) -> None:
    lamp = '[[lighting]]\nname = "lamp"\n' + LIGHT
    view = '[[view]]\nazimuth_deg = 0\nlighting = "lamp"\nheld_out = true\n'
    path = tmp_path / "tiny.toml"
    path.write_text(WHOLE.replace(CAMERA, lamp + CAMERA) + view)
    staging = read_staging(path, given=given)  # type: ignore[arg-type]
    told = {light.name: light.given for light in staging.scene.illuminations}
    assert told == {"lab": given, "lamp": "all"}
    assert (staging.ball is not None) == (given == "ball")

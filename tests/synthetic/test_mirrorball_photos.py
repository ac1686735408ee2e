"""Photographs of a mirror ball: the light that `recon` reads off them is the light that fell on it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.files.imagefile import read_pixels
from capture.lighting import latlong_directions, latlong_solid_angles
from capture.photoset import load_photoset
from recon.lighting import read_lighting
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.render.lobes import irradiance
from synthetic.scene import Effort
from synthetic.scenes.build import read_staging
from synthetic.sensing.contactsheet import write_contact_sheet
from synthetic.sensing.development import Development
from synthetic.sensing.sensor import vignetting
from synthetic.staging import Staging
from synthetic.writer import write_photoset

SCENE = """
format = 1
name = "ball"
[object]
shape = "sphere"
radius = 0.004
centre = [0.002, -0.001, 0.003]
[material]
model = "lambertian"
kd = 0.2
[[lighting]]
name = "lab"
area = [{ azimuth_deg = 100, elevation_deg = 40, radiance = [1.5, 1.6, 1.8], width_deg = 20 }]
directional = [{ azimuth_deg = -20, elevation_deg = 25, irradiance = [1.6, 1.5, 1.35] }]
given = "ball"
[camera]
width = 120
height = 90
focal_px = 1012
[mirror_ball]
radius = 0.02
[[view]]
azimuth_deg = 10
"""
SENSORS = {
    "exr": "",
    "png": '[sensor]\nfile = "png"\nvignetting = true\n',
    "jpeg": '[sensor]\nfile = "jpeg"\n',
    "dng": '[sensor]\nfile = "dng"\nvignetting = true\n',
}


def photographed(folder: Path, scene: str) -> Staging:
    """Photograph a scene into folder / "set"."""
    folder.mkdir()
    path = folder / "ball.toml"
    path.write_text(scene)
    staging = read_staging(path)
    # Matte and small: next to no work but the balls.
    staging = replace(staging, scene=replace(staging.scene, effort=Effort(directions=64, per_side=1)))
    write_photoset(staging, folder / "set")
    return staging


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Staging]]:
    folder = tmp_path_factory.mktemp("balls")
    return {
        name: (folder / name / "set", photographed(folder / name, SCENE + SENSORS[name])) for name in SENSORS
    }


@pytest.mark.parametrize("file", SENSORS)
def test_the_light_is_read_off_the_ball(file: str, sets: dict[str, tuple[Path, Staging]]) -> None:
    folder, staging = sets[file]
    photoset = load_photoset(folder)
    found = read_lighting(photoset, photoset.lightings[0])
    (light,) = staging.scene.illuminations
    (source,), (area,) = light.sources, light.extended
    assert isinstance(source, DirectionalSource)
    assert isinstance(area, AreaLight)
    assert not found.warnings
    assert found.directions.shape == (1, 3)
    # A pixel of the ball's picture, 34 px in radius, turns its reflection by 3.4 degrees.
    assert np.degrees(np.arccos(found.directions[0] @ source.direction)) < 0.3
    # The lamp shows as a disc of a pixel's size, which 64 points per pixel cut to some percent.
    assert_allclose(found.irradiances[0], source.irradiance, rtol=0.03)
    # The rest of the light as a matte surface sees it, whichever way it faces.
    assert found.radiance_map is not None
    height = len(found.radiance_map)
    flux = found.radiance_map * latlong_solid_angles(height)[..., None]
    normals = np.concatenate([np.eye(3), -np.eye(3), area.axis[None]])
    cosines = np.maximum(np.einsum("hwc,nc->nhw", latlong_directions(height), normals), 0)
    measured = np.einsum("nhw,hwc->nc", cosines, flux)
    expected = irradiance(area, normals)[:, None] * area.radiance
    # The maps of two views, of 64 rows, and what is left of the source where one of them sees it badly.
    assert_allclose(measured, expected, atol=0.03 * expected.max())


@pytest.mark.parametrize(
    ("file", "keys"), [("exr", set()), ("png", {"exposure_s"}), ("dng", {"exposure_s", "iso", "f_number"})]
)
def test_exposures_are_stated_as_the_photographs_state_theirs(
    file: str, keys: set[str], sets: dict[str, tuple[Path, Staging]], tmp_path: Path
) -> None:
    # ISO and f-number only where EXIF holds them for the photographs: a set in which some have them is refused.
    folder, _ = sets[file]
    (table,) = load_photoset(folder).lightings
    assert table.mirror_ball is not None
    for view in table.mirror_ball.views:
        given = {key for key in ("exposure_s", "iso", "f_number") if getattr(view, key) is not None}
        assert given == keys
    write_contact_sheet(folder, tmp_path / "contact.png")


def test_a_ball_shows_all_its_light_and_nothing_beside_it(sets: dict[str, tuple[Path, Staging]]) -> None:
    folder = sets["exr"][0] / "mirrorball"
    names = ["lab-0.exr", "lab-0_mask.png", "lab-1.exr", "lab-1_mask.png"]
    assert sorted(path.name for path in folder.iterdir()) == names
    for stem in ("lab-0", "lab-1"):
        radiance = read_pixels(folder / f"{stem}.exr")
        mask = read_pixels(folder / f"{stem}_mask.png")[..., 0]
        assert not radiance[mask == 0].any()
        # 34 px in radius, at the object's place: a little off the middle of the picture.
        assert_allclose((mask / 255).sum(), np.pi * 33.75**2, rtol=0.02)
        # The lamp, a disc of a pixel's turn, 2 / 34 rad: irradiance / (pi sin^2) where it fills a pixel.
        assert 0.7 < radiance.max() / (1.6 / (np.pi * np.sin(2 / 33.75) ** 2)) < 1


def test_a_lens_that_vignettes_darkens_the_ball_too(sets: dict[str, tuple[Path, Staging]]) -> None:
    through, ideal = (read_pixels(sets[name][0] / "mirrorball" / "lab-1.exr") for name in ("dng", "exr"))
    sensor = sets["dng"][1].sensor
    assert isinstance(sensor, Development)
    assert_allclose(through, ideal * vignetting(sensor.sensor, 120, 90)[..., None], rtol=1e-6)  # float32
    assert through[0, 0].max() == ideal[0, 0].max() == 0


COARSE = SCENE.replace("120", "40").replace("90", "30").replace("1012", "340")


def test_a_ball_is_as_large_as_the_object_unless_that_fills_the_picture(tmp_path: Path) -> None:
    scene = COARSE.replace("[mirror_ball]\nradius = 0.02\n", "[mirror_ball]\n")
    for name, radius, pixels in (("small", 0.01, 5.67), ("large", 0.1, 13.5)):
        photographed(tmp_path / name, scene.replace("radius = 0.004", f"radius = {radius}\nstated = true"))
        mask = read_pixels(tmp_path / name / "set" / "mirrorball" / "lab-0_mask.png")[..., 0]
        # Nine tenths of a picture 30 high; perspective adds up to 1%, and so does the place nearer to the camera.
        assert_allclose(np.sqrt((mask / 255).sum() / np.pi), pixels, rtol=0.02)


def test_a_secret_light_is_told_of_in_the_truth_only(tmp_path: Path) -> None:
    photographed(tmp_path / "secret", COARSE.replace('given = "ball"', 'given = "nothing"'))
    folder = tmp_path / "secret" / "set"
    (table,) = load_photoset(folder).lightings
    assert (table.unknown, table.map, table.directional, table.mirror_ball) == (True, None, (), None)
    (lighting,) = json.loads((folder / "truth.json").read_text())["lighting"]
    assert (folder / lighting["map"]).parent.name == "truth"
    assert not (folder / "lighting.exr").exists()
    # Whoever is to judge a recovered light finds the ball's photographs, and from where they were taken.
    views = lighting["mirror_ball"]["views"]
    assert len(views) == 2
    assert all((folder / view["photo"]).exists() for view in views)
    assert np.array(views[1]["world_to_camera"]).shape == (4, 4)

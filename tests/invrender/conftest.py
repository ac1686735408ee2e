"""Small photo sets for end-to-end tests, and photographs in memory for the numerical ones."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

import lightfactor as lf
from capture.arc.gantry import Arc
from capture.camera import Camera
from capture.lighting import Lighting
from capture.radiance import RadianceImage
from invrender.brdf.microfacet import Microfacet as Brdf
from invrender.output.report.run import run_process
from invrender.transport.columns import PhotoColumns, photo_columns
from invrender.transport.predict import predict
from invrender.transport.transfer import light_elements
from recon.mesh.bodies import SphereBody
from recon.sampling.draw import NO_SOURCES, sample_body
from recon.sampling.lightfield import LightField, off_terminators
from recon.sphere.sphere import Sphere
from synthetic.demo import write_demo
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import Illumination, latlong_map
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.render.lobes import reflected_radiance
from synthetic.scene import Scene, Shot
from synthetic.shapes.ball import Ball
from synthetic.staging import Staging
from synthetic.writer import write_photoset

from .faultysets import write_set
from .fewforms import few_forms_tried, no_causes_sought, no_figures_drawn, no_pictures_drawn

Floats = np.ndarray
Command = Callable[..., tuple[int, str, str]]


_WINDOW = AreaLight(np.array([-0.3, 0.8, 0.52]), np.array([1.0, 1.2, 1.4]), width_rad=0.4)
_LAMP = DirectionalSource(np.array([0.85, -0.31, 0.42]), np.array([1.5, 1.4, 1.3]))
_DELRIN = radiometric(RH01_MATERIALS["delrin"])


def _write_small_set(
    folder: Path,
    areas: tuple[AreaLight, ...],
    lamps: tuple[DirectionalSource, ...] = (_LAMP,),
    material: Material = _DELRIN,
) -> Path:
    """Four photographs of a sphere under sources and area lights, the last one held out; 80x60 pixels."""
    angles = np.radians([0.0, 50.0, 100.0, 150.0])
    poses = [Arc(np.zeros(3), [0, 0, 1], 0.6, [1, 0, 0]).pose(angle) for angle in angles]
    light = Illumination("lighting", areas, lamps)
    camera = Camera("PINHOLE", np.array([720.0, 720.0, 40.0, 30.0]), 80, 60, np.eye(4))
    scene = Scene(
        name="small",
        surface=Ball(np.array([0.001, 0.0, -0.001]), 0.02),
        material=material,
        shots=tuple(Shot(camera.posed(pose), light, index == 3) for index, pose in enumerate(poses)),
    )
    write_photoset(Staging(scene), folder)
    return folder


@pytest.fixture(scope="session")
def small_set_original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four photographs of a delrin sphere under an area light and a source, the last one held out."""
    return _write_small_set(tmp_path_factory.mktemp("small") / "set", (_WINDOW,))


@pytest.fixture(scope="session")
def lamp_set_original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same under the source alone: solved in a third of the time, as no lobe meets a map of the light."""
    return _write_small_set(tmp_path_factory.mktemp("lamp") / "set", ())


@pytest.fixture
def matte_set(tmp_path: Path) -> Path:
    """The same of a Lambertian sphere, under the area light alone."""
    return _write_small_set(tmp_path / "matte", (_WINDOW,), (), Lambertian(_DELRIN.kd))


@pytest.fixture
def matte_lamp_set(tmp_path: Path) -> Path:
    """The same of a Lambertian sphere, under both: no lobe meets the map."""
    return _write_small_set(tmp_path / "matte", (_WINDOW,), (_LAMP,), Lambertian(_DELRIN.kd))


@pytest.fixture
def few_forms() -> Iterator[None]:
    """The test's fits try few forms of highlights."""
    with few_forms_tried():
        yield


@pytest.fixture
def no_causes() -> Iterator[None]:
    """The test's fits seek no causes of what they leave beyond noise."""
    with no_causes_sought():
        yield


@pytest.fixture
def no_pictures() -> Iterator[None]:
    """`process` writes numbers alone."""
    with no_pictures_drawn():
        yield


@pytest.fixture
def no_figures() -> Iterator[None]:
    """What the test's runs write has empty figures."""
    with no_figures_drawn():
        yield


@pytest.fixture
def small_set(small_set_original: Path, tmp_path: Path) -> Path:
    """A copy of the small set that a test may damage."""
    return Path(shutil.copytree(small_set_original, tmp_path / "set"))


@pytest.fixture
def lamp_set(lamp_set_original: Path, tmp_path: Path) -> Path:
    """A copy of the set under the source alone that a test may damage."""
    return Path(shutil.copytree(lamp_set_original, tmp_path / "set"))


@pytest.fixture(scope="session")
def fitted_original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A glossy sphere under a lamp per photograph, with the result of all of its pixels in `fit`; as it is."""
    folder = write_set(tmp_path_factory.mktemp("fitted") / "set")
    with few_forms_tried(), no_causes_sought():
        lf.process(folder).save(folder / "fit")
    return folder


@pytest.fixture(scope="session")
def workshop(small_set_original: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a photo set and, beside it, its result; tests that change either copy it."""
    folder = tmp_path_factory.mktemp("workshop")
    shutil.copytree(small_set_original, folder / "set")
    with few_forms_tried():
        run_process(folder / "set", folder / "result", 2500)
    return folder


def direction(azimuth_deg: float, elevation_deg: float) -> Floats:
    """Unit vector at an azimuth from +X towards +Y and an elevation above the horizon."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


AREA_LIGHT = AreaLight(direction(110, 40), np.array([1.5, 1.6, 1.8]), width_rad=0.35)
# Behind the first photographs' sphere and beside the last ones': highlights from 16 to 78 degrees.
SOURCE = DirectionalSource(direction(-20, 25), np.array([1.6, 1.5, 1.35]))
_SPHERE = Sphere(np.zeros(3), 0.02, np.zeros((4, 4)))


def known_lighting(
    lights: Sequence[AreaLight] = (AREA_LIGHT,),
    sources: Sequence[DirectionalSource] = (SOURCE,),
    name: str = "light",
    **recover: bool,
) -> Lighting:
    """What a fit is told of synthetic lights: a map of the area lights, and the sources."""
    return Lighting(
        name,
        latlong_map(lights, 128) if lights else None,
        np.array([source.direction for source in sources]).reshape(-1, 3),
        np.array([source.irradiance for source in sources]).reshape(-1, 3),
        **recover,
    )


def sphere_field(
    angle_deg: float,
    samples: int = 150,
    radius_px: float = 60.0,
    seed: int = 0,
    sources: NDArray[np.floating] = NO_SOURCES,
) -> LightField:
    """Samples, still black, of a sphere that a camera looks at from an angle on an arc from +X towards +Y.

    At 60 px radius the normals within 63 degrees of the camera have one ray each, those beyond it four.
    """
    focal, side = radius_px * 0.6 / _SPHERE.radius, int(2.2 * radius_px)
    pose = Arc(np.zeros(3), [0, 0, 1], 0.6, [1, 0, 0]).pose(np.radians(angle_deg))
    camera = Camera("PINHOLE", np.array([focal, focal, side / 2, side / 2]), side, side, pose)
    black = np.zeros((side, side, 3), np.float32)
    image = RadianceImage(black, black, np.zeros((side, side), bool))
    rng = np.random.default_rng([seed, int(angle_deg * 1000) % 2**31])
    return sample_body(SphereBody(_SPHERE), camera, image, None, sources, samples, rng)


def photograph(
    material: MicrofacetMaterial,
    angles_deg: Sequence[float],
    lights: Sequence[AreaLight] = (AREA_LIGHT,),
    sources: Sequence[DirectionalSource] = (SOURCE,),
    told: Lighting | None = None,
    samples: int = 150,
) -> list[PhotoColumns]:
    """Photographs without noise, as columns; radiance by brute-force integration over incident directions.

    told : the lighting that the fit is told; the true one if None.
    """
    told = told or known_lighting(lights, sources)
    elements = light_elements(told)
    photos = []
    for angle in angles_deg:
        field = off_terminators(sphere_field(angle, samples, sources=told.directions), told.directions)
        radiance = reflected_radiance(material, lights, sources, field.normals, field.views)
        field = replace(field, radiance=field.mean_over_rays(radiance))
        photos.append(photo_columns(told.name, elements, field))
    return photos


def predicted_photographs(
    brdf: Brdf, angles_deg: Sequence[float], told: Lighting, samples: int
) -> list[PhotoColumns]:
    """Photographs of a sphere whose BRDF is one of the product's own, without noise, as columns of RH01's form."""
    elements = light_elements(told)
    fields = [sphere_field(float(angle), samples) for angle in angles_deg]
    return [
        with_radiance(
            photo_columns(told.name, elements, field),
            predict(brdf, elements, np.ones((len(elements), 3)), field),
        )
        for field in fields
    ]


def with_radiance(photo: PhotoColumns, radiance: Floats) -> PhotoColumns:
    """The same photograph with other radiances (n, 3)."""
    return replace(photo, field=replace(photo.field, radiance=radiance))


def with_noise(
    photos: Sequence[PhotoColumns], rng: np.random.Generator, relative: float = 0.01, floor: float = 0.001
) -> list[PhotoColumns]:
    """Gaussian noise of two parts; `floor` as a share of each photograph's mean radiance."""
    noisy = []
    for photo in photos:
        deviation = np.hypot(relative * photo.radiance, floor * photo.radiance.mean())
        noisy.append(with_radiance(photo, photo.radiance + deviation * rng.standard_normal(deviation.shape)))
    return noisy


@pytest.fixture(scope="session")
def bench() -> SimpleNamespace:
    """The laboratory bench of the numerical tests: lights, a sphere, its photographs as columns."""
    return SimpleNamespace(
        area_light=AREA_LIGHT,
        source=SOURCE,
        direction=direction,
        known_lighting=known_lighting,
        sphere_field=sphere_field,
        photograph=photograph,
        predicted_photographs=predicted_photographs,
        with_radiance=with_radiance,
        with_noise=with_noise,
    )


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


@pytest.fixture(scope="session")
def demo_set_original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demonstration's photographs."""
    folder = tmp_path_factory.mktemp("demo") / "set"
    write_demo(folder)
    return folder


@pytest.fixture
def demo_set(demo_set_original: Path, tmp_path: Path) -> Path:
    """A copy of the demonstration's photographs that a test may damage."""
    return Path(shutil.copytree(demo_set_original, tmp_path / "set"))

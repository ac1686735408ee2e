"""Scenes for Mitsuba, rendered by Mitsuba: its formula is the one that was fitted, and its pictures are ours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.arc.gantry import look_at
from capture.camera import Camera
from capture.lighting import Lighting
from invrender.brdf.form import Angles
from invrender.brdf.lobes import BECKMANN, GGX_FORM, PLASTICS
from invrender.brdf.microfacet import Microfacet
from invrender.output.export.mapping import Mapping, map_brdf
from invrender.output.export.material import ExportedBRDF
from invrender.output.export.mitsuba import write_mitsuba
from invrender.output.export.mitsuba_target import MITSUBA
from invrender.output.export.shape import Shape
from invrender.output.render.light import light_element
from invrender.output.render.picture import take_picture
from invrender.output.render.subject import Subject, mesh_subject, sphere_subject
from invrender.result.reflectance import Reflectance
from invrender.result.saved_textures import SavedTextures
from recon.mesh.tessellated import tessellated
from recon.mesh.trianglemesh import write_mesh
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric

mi = pytest.importorskip("mitsuba")

CENTRE, RADIUS = np.array([0.002, -0.001, 0.003]), 0.02
POSE = look_at([0.25, 0.1, 0.15], CENTRE, [0, 0, 1])
CAMERA = Camera("PINHOLE", np.array([400.0, 400.0, 32.0, 32.0]), 64, 64, POSE)
NOTHING = np.zeros((0, 3))
# Of several lights Mitsuba's paths choose one by chance; one leaves next to no noise.
SOURCE = Lighting("source", None, np.array([[0.8, 0.5, 0.3]]), np.array([[2.0, 1.0, 0.5]]))
TEFLON = radiometric(RH01_MATERIALS["teflon"])
SPHERE = Shape(tessellated(CENTRE, RADIUS), CENTRE, RADIUS, True)


@pytest.fixture(autouse=True)
def variant() -> Iterator[None]:
    """The variant that needs nothing but Mitsuba; other tests keep theirs."""
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    yield
    if before is not None:
        mi.set_variant(before)


def brdf_of(name: str, form: Any = BECKMANN) -> Microfacet:
    material = radiometric(RH01_MATERIALS[name])
    return Microfacet(material.kd, material.ks, material.mu, material.sigma, form)


def exported(
    folder: Path,
    brdf: Microfacet,
    lighting: Lighting,
    shape: Shape = SPHERE,
    textures: SavedTextures | None = None,
) -> Mapping:
    mapping = map_brdf(brdf, MITSUBA)
    write_mitsuba(folder, shape, ExportedBRDF(brdf, textures, np.ones(3), {}, ()), mapping, lighting, CAMERA)
    return mapping


def rendered(folder: Path, samples: int) -> np.ndarray:
    return np.array(mi.render(mi.load_file(str(folder / "scene.xml")), spp=samples), float)[:, :, :3]


def predicted(
    brdf: Microfacet,
    lighting: Lighting,
    subject: Subject | None = None,
    textures: SavedTextures | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Our radiance, and which pixels are all object."""
    reflectance = Reflectance(brdf, np.zeros((3, 4, 4)), {}, (), textures)
    picture = take_picture(
        subject or sphere_subject(CENTRE, RADIUS), CAMERA, reflectance, light_element(lighting)
    )
    inner = picture.coverage == 1
    assert inner.sum() > 1500
    return picture.radiance.astype(float), inner


def relative_rms(ours: np.ndarray, theirs: np.ndarray, inner: np.ndarray) -> float:
    return float(np.sqrt(((theirs - ours)[inner] ** 2).mean() / (ours[inner] ** 2).mean()))


@pytest.mark.parametrize(
    "brdf",
    [
        # More than 1 in all, which Mitsuba takes as an image only.
        pytest.param(brdf_of("delrin"), id="weak index"),
        pytest.param(brdf_of("bronze", GGX_FORM), id="coloured GGX without index"),
        pytest.param(Microfacet(np.zeros(3), np.array([0.9, 0.6, 0.3]), None, 0.3, GGX_FORM), id="metal"),
        pytest.param(Microfacet(np.array([0.1, 0.2, 0.3]), np.zeros(3), None, None), id="matte"),
        pytest.param(brdf_of("teflon", PLASTICS[BECKMANN]), id="plastic"),
        pytest.param(brdf_of("teflon", PLASTICS[GGX_FORM]), id="GGX plastic"),
    ],
)
def test_the_material_is_the_formula_that_was_fitted(brdf: Microfacet, tmp_path: Path) -> None:
    mapping = exported(tmp_path, brdf, SOURCE)
    bsdf = mi.load_file(str(tmp_path / "scene.xml")).shapes()[0].bsdf()
    rng = np.random.default_rng(5)
    wi, wo = rng.normal(size=(2, 300, 3))
    wi[::2] = wo[::2] / np.linalg.norm(wo[::2], axis=1, keepdims=True) * [-1, -1, 1] + 0.1 * wi[::2]
    wi, wo = (w / np.linalg.norm(w, axis=1, keepdims=True) for w in (wi, wo))
    wi[:, 2], wo[:, 2] = np.abs(wi[:, 2]), np.abs(wo[:, 2])
    clear = (wi[:, 2] > 0.1) & (wo[:, 2] > 0.1)
    values = []
    for light, viewer in zip(wi[clear], wo[clear], strict=True):
        si = mi.SurfaceInteraction3f()
        si.uv = [0.5, 0.5]
        si.wi = viewer.tolist()
        values.append(np.array(bsdf.eval(mi.BSDFContext(), si, light.tolist())))
    ours = mapping.target.reflected(
        Angles.between(np.array([0, 0, 1.0]), wi[clear], wo[clear]), mapping.numbers
    )
    # Single precision; Beckmann's shadowing is a rational fit there, good to 0.35% on either side.
    assert_allclose(np.array(values), ours, rtol=8e-3, atol=1e-6)


def test_pictures_under_a_source_are_ours(tmp_path: Path) -> None:
    brdf = brdf_of("teflon")
    mapping = exported(tmp_path, brdf, SOURCE)
    ours, inner = predicted(brdf, SOURCE)
    assert mapping.relative_rms < 0.002
    # Along the terminator a pixel is a mean over some rays of either; 200 rays leave 0.2%.
    loss = relative_rms(ours, rendered(tmp_path, 196), inner)
    assert loss < 0.004


def test_what_pictures_lose_is_what_the_mapping_says(tmp_path: Path) -> None:
    # RH01's own lobe, of which Mitsuba has none.
    printed = Microfacet(TEFLON.kd, TEFLON.ks, TEFLON.mu, TEFLON.sigma)
    mapping = exported(tmp_path, printed, SOURCE)
    ours, inner = predicted(printed, SOURCE)
    loss = relative_rms(ours, rendered(tmp_path, 196), inner)
    # The lamp isn't grazing here: less than over all directions, 0.3%.
    assert loss < min(mapping.relative_rms, 0.006)


def test_maps_stand_as_ours_do(tmp_path: Path) -> None:
    # Three colours from three sides, none of them opposite: no flip or turn looks the same.
    lights = [
        AreaLight(np.array(axis) / np.linalg.norm(axis), np.array(colour), 0.6)
        for axis, colour in (
            ([1, 0.2, 0.1], [2, 0, 0]),
            ([0.1, 1, 0.3], [0, 2, 0]),
            ([0.2, -0.3, 1], [0, 0, 2]),
        )
    ]
    lighting = Lighting("map", latlong_map(lights, 64), NOTHING, NOTHING)
    matte = Microfacet(np.array([0.2, 0.2, 0.2]), np.zeros(3), None, None)
    exported(tmp_path, matte, lighting)
    ours, inner = predicted(matte, lighting)
    theirs = rendered(tmp_path, 64)
    # Noise of 64 paths is averaged over blocks of 8 pixels.
    blocks = [
        np.where(inner[:, :, None], picture, 0).reshape(8, 8, 8, 8, 3).mean(axis=(1, 3))
        for picture in (ours, theirs)
    ]
    assert relative_rms(*blocks, np.ones((8, 8), bool)) < 0.015
    assert (ours[inner].mean(axis=0) > 0.01).all()


def test_textures_lie_where_ours_do(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    kd, ks = rng.uniform(0.05, 0.25, (8, 16, 3)), rng.uniform(0.01, 0.03, (8, 16, 3))
    textures = SavedTextures(kd, ks, np.zeros((1, 1, 3)), np.zeros((1, 1, 3)))
    brdf = replace(brdf_of("teflon"), kd=kd.mean(axis=(0, 1)), ks=ks.mean(axis=(0, 1)))
    mesh = tessellated(CENTRE, RADIUS, 24)
    write_mesh(tmp_path / "ball.obj", mesh)
    exported(tmp_path, brdf, SOURCE, Shape(mesh, CENTRE, RADIUS, False), textures)
    subject = mesh_subject(tmp_path / "ball.obj", None)
    ours, inner = predicted(brdf, SOURCE, subject, textures)
    # As above, and edges of shadows on flat triangles.
    assert relative_rms(ours, rendered(tmp_path, 196), inner) < 0.01


def test_scenes_name_only_what_is_beside_them(tmp_path: Path) -> None:
    lighting = replace(SOURCE, radiance_map=np.ones((8, 16, 3), np.float32))
    exported(tmp_path, brdf_of("delrin"), lighting)
    scene = ET.parse(tmp_path / "scene.xml").getroot()
    named = {node.get("value") for node in scene.iter("string") if node.get("name") == "filename"}
    assert named == {path.name for path in tmp_path.iterdir()} - {"scene.xml"}
    assert len(scene.findall("emitter")) == 2

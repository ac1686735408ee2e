"""Results for other programs: mappings by exact cases and by hand, files read back by trimesh and an XML parser."""

from __future__ import annotations

import json
import re
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from capture.files.documents import file_hash
from capture.files.imagefile import read_pixels, write_exr
from capture.srgb import srgb_to_linear
from invrender.brdf.lobes import GGX_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.output.export.directions import direction_pairs
from invrender.output.export.gltf_target import GLTF
from invrender.output.export.lights import panorama
from invrender.output.export.target import Numbers
from recon.mesh.tessellated import tessellated
from recon.mesh.trianglemesh import write_mesh

Command = Callable[..., tuple[int, str, str]]

# The sphere of the photo set that the tests' result is of.
CENTRE, RADIUS = np.array([0.001, 0.0, -0.001]), 0.02


@pytest.fixture
def result(workshop: Path, tmp_path: Path) -> Path:
    """A copy of the result that a test may change, the set beside it."""
    shutil.copytree(workshop / "set", tmp_path / "set")
    return Path(shutil.copytree(workshop / "result", tmp_path / "result"))


def change(result: Path, edit: Callable[[Any], object]) -> None:
    path = result / "result.json"
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document))


def make_mesh(result: Path, kd: np.ndarray | None = None, ks: np.ndarray | None = None) -> None:
    """Put a mesh of the sphere, with texture coordinates, in its place, and textures beside the result."""
    photoset = result.parent / "set"
    write_mesh(photoset / "ball.obj", tessellated(np.zeros(3), RADIUS, 16))
    manifest = photoset / "photoset.toml"
    pose = np.eye(4)
    pose[:3, 3] = CENTRE
    text = re.sub(
        r"\[object\][^\[]*",
        f'[object]\nshape = "mesh"\nmesh = "ball.obj"\nmesh_to_world = {pose.tolist()}\n\n',
        manifest.read_text(),
    )
    manifest.write_text(text)

    def edit(document: Any) -> None:
        document["object"] |= {"shape": "mesh", "mesh_to_world": pose.tolist()}
        name = next(name for name in document["inputs"] if name.endswith(".toml"))
        document["inputs"][name] = file_hash(manifest)

    change(result, edit)
    for name, texels in (("texture_kd.exr", kd), ("texture_ks.exr", ks)):
        if texels is not None:
            write_exr(result / name, texels)


def glb_parts(path: Path) -> tuple[Any, bytes]:
    """The JSON and the binary chunk of a .glb."""
    data = path.read_bytes()
    magic, version, length = struct.unpack("<4sII", data[:12])
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack("<I4s", data[12:20])
    assert kind == b"JSON"
    assert size % 4 == 0
    binary, kind = struct.unpack("<I4s", data[20 + size : 28 + size])
    assert kind == b"BIN\0"
    assert len(data) == 28 + size + binary
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def glb_image(path: Path, index: int) -> np.ndarray:
    """Codes (h, w, 3 or 4) of an image in a .glb, RGB."""
    document, binary = glb_parts(path)
    view = document["bufferViews"][document["images"][index]["bufferView"]]
    data = np.frombuffer(binary, np.uint8)[view["byteOffset"] :][: view["byteLength"]]
    codes = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    return codes[:, :, [2, 1, 0, 3][: codes.shape[2]]]


def test_a_sphere_in_gltf(lightfactor: Command, result: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, said, err = lightfactor("export", result, "--format", "gltf", "--light", "-o", out)
    assert (code, err) == (0, "")
    assert "glTF metallic-roughness" in said
    export = json.loads((out / "export.json").read_text())
    assert f"differs from the BRDF by {export['lost']['relative_rms']:.1%}" in said
    mesh = trimesh.load(out / "object.glb").to_geometry()
    saved = json.loads((result / "result.json").read_text())
    x, y, z = saved["object"]["centre"]
    # Metres, our +Z up and our +Y away.
    assert_allclose(mesh.bounds.mean(axis=0), [x, z, -y], atol=1e-6)
    assert_allclose(np.ptp(mesh.bounds, axis=0), 2 * saved["object"]["radius"], rtol=1e-5)
    assert mesh.volume > 0
    document, _ = glb_parts(out / "object.glb")
    (described,) = document["materials"]
    surface, specular = described["pbrMetallicRoughness"], described["extensions"]["KHR_materials_specular"]
    assert mesh.visual.material.roughnessFactor == pytest.approx(surface["roughnessFactor"])
    # Roughness is the root of alpha, which is near sigma = 0.1.
    assert surface["roughnessFactor"] ** 2 == pytest.approx(0.1, abs=0.015)
    assert surface["metallicFactor"] == 0
    # pi Kd is 0.75; the lobe takes a few percent from it.
    assert_allclose(surface["baseColorFactor"], [0.783, 0.783, 0.783, 1], atol=0.01)
    index = described["extensions"]["KHR_materials_ior"]["ior"]
    f0 = specular["specularFactor"] * max(specular["specularColorFactor"]) * ((index - 1) / (index + 1)) ** 2
    at_normal = saved["brdf"]["ks"]["value"][1]
    assert at_normal < f0 < 2 * at_normal
    assert export["material"]["parameters"]["pbrMetallicRoughness"] == surface
    assert document["extensionsUsed"] == [
        "KHR_materials_ior",
        "KHR_materials_specular",
        "KHR_lights_punctual",
    ]
    (light,) = document["extensions"]["KHR_lights_punctual"]["lights"]
    (source,) = saved["lighting"][0]["directional"]
    assert_allclose(np.array(light["color"]) * light["intensity"], source["irradiance"], rtol=1e-6)
    # Light goes along a node's -Z, away from the source.
    x, y, z = source["direction"]
    along = Rotation.from_quat(document["nodes"][1]["rotation"]).apply([0, 0, -1])
    assert_allclose(along, [-x, -z, y], atol=1e-6)
    map_file = result / saved["lighting"][0]["map"]
    assert_allclose(read_pixels(out / "environment.exr"), panorama(read_pixels(map_file)))


def test_textures_in_gltf(lightfactor: Command, result: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    kd, ks = rng.uniform(0.02, 0.2, (8, 16, 3)), rng.uniform(0.01, 0.03, (8, 16, 1)) * [1, 0.8, 0.9]

    def edit(document: Any) -> None:
        # Facets of which glTF can say nearly all.
        document["brdf"] |= {"model": "GGX"}
        document["brdf"]["mu"]["value"] = 1.8
        for name, texels in (("kd", kd), ("ks", ks)):
            document["brdf"][name]["value"] = texels.mean(axis=(0, 1)).tolist()

    make_mesh(result, kd, ks)
    change(result, edit)
    out = tmp_path / "out"
    code, _, err = lightfactor("export", result, "--format", "gltf", "-o", out)
    assert (code, err) == (0, "")
    document, _ = glb_parts(out / "object.glb")
    (described,) = document["materials"]
    specular, index = (described["extensions"][f"KHR_materials_{name}"] for name in ("specular", "ior"))
    base, lobe = glb_image(out / "object.glb", 0), glb_image(out / "object.glb", 1)
    factor = specular["specularFactor"] * lobe[:, :, 3:] / 255
    # A material of its own for every texel, as if it were all there is.
    f0 = ((index["ior"] - 1) / (index["ior"] + 1)) ** 2
    f0 = f0 * np.array(specular["specularColorFactor"]) * srgb_to_linear(lobe[:, :, :3] / 255)
    alpha = described["pbrMetallicRoughness"]["roughnessFactor"] ** 2
    sigma = json.loads((result / "result.json").read_text())["brdf"]["sigma"]["value"]
    pairs = direction_pairs(sigma)
    for row, column in ((0, 0), (3, 7), (7, 15)):
        here = row, column
        theirs = Numbers(alpha, float(factor[here][0]), srgb_to_linear(base[here] / 255), f0[here])
        ours = Microfacet(kd[here], ks[here], 1.8, sigma, GGX_FORM)
        uniform = pairs.per_view(GLTF.reflected(pairs.angles, theirs))
        lobe_only = ours.form.reflected(pairs.angles, ours.mu, sigma)[:, None]
        truth = pairs.per_view(kd[here] * pairs.angles.cos_i[:, None] + ks[here] * lobe_only)
        # Of albedos of 0.1 to 0.7: 8 bits per channel, and the mapping of the means.
        assert_allclose(uniform, truth, atol=0.01)
    mesh = trimesh.load(out / "object.glb").to_geometry()
    # trimesh has v up, as our meshes have.
    north = mesh.vertices[:, 1] > CENTRE[2] + 0.999 * RADIUS
    assert_allclose(mesh.visual.uv[north, 1], 1, atol=1e-6)


def test_a_relative_gauge_gets_a_plausible_scale_and_says_so(
    lightfactor: Command, result: Path, tmp_path: Path
) -> None:
    change(result, lambda document: document.update(gauge="relative: mean irradiance fixed to 1 per channel"))
    saved = json.loads((result / "result.json").read_text())
    total = np.pi * np.array(saved["brdf"]["kd"]["value"]) + saved["brdf"]["ks"]["value"]
    cases = (None, 0.5 / total.max()), ("0.3", 0.3 / total.max()), ("0.3,0.4,0.5", [0.3, 0.4, 0.5] / total)
    for albedo, scale in cases:
        options = () if albedo is None else ("--albedo", albedo)
        out = tmp_path / "out"
        code, said, err = lightfactor("export", result, "--format", "gltf", "--light", *options, "-o", out)
        assert (code, err) == (0, "")
        assert "no scale of its own" in said
        assert ("--albedo" in said) == (albedo is None)
        export = json.loads((out / "export.json").read_text())
        assert_allclose(export["scale"], np.broadcast_to(scale, 3), rtol=1e-9)
        assert_allclose(
            export["brdf"]["kd"]["value"], scale * np.array(saved["brdf"]["kd"]["value"]), rtol=1e-9
        )
        document, _ = glb_parts(out / "object.glb")
        (light,) = document["extensions"]["KHR_lights_punctual"]["lights"]
        source = np.array(saved["lighting"][0]["directional"][0]["irradiance"])
        # The product of both, which photographs tell, is untouched.
        assert_allclose(np.array(light["color"]) * light["intensity"] * export["scale"], source, rtol=1e-6)


def test_matte_results_are_exact(lightfactor: Command, result: Path, tmp_path: Path) -> None:
    def edit(document: Any) -> None:
        document["brdf"] |= {"model": "lambertian", "ks": None, "mu": None, "sigma": None}
        document["brdf"]["kd"]["value"] = [0.1, 0.2, 0.25]
        document["brdf"]["covariance"] = {"names": [], "values": []}

    change(result, edit)
    for form in ("gltf", "mitsuba", "materialx", "openpbr"):
        code, _, err = lightfactor("export", result, "--format", form, "-o", tmp_path / form)
        assert (code, err) == (0, "")
        lost = json.loads((tmp_path / form / "export.json").read_text())["lost"]
        assert lost["relative_rms"] < 1e-12
    surface = glb_parts(tmp_path / "gltf" / "object.glb")[0]["materials"][0]
    assert_allclose(
        surface["pbrMetallicRoughness"]["baseColorFactor"][:3], np.pi * np.array([0.1, 0.2, 0.25])
    )
    assert surface["extensions"]["KHR_materials_specular"]["specularFactor"] == 0


def test_metal_in_places_keeps_its_strength(lightfactor: Command, result: Path, tmp_path: Path) -> None:
    gilt = np.where(np.arange(16) % 2, 0.55, 0.08)[None, :, None] * np.ones((8, 1, 3))
    make_mesh(result, np.full((8, 16, 3), 0.03), gilt)

    def edit(document: Any) -> None:
        document["brdf"]["model"] = "GGX"
        document["brdf"]["kd"]["value"] = [0.03] * 3
        document["brdf"]["ks"]["value"] = [0.315] * 3
        document["brdf"]["mu"] |= {"value": 3.4, "std": 0.006218, "status": "weak"}

    change(result, edit)
    code, said, _ = lightfactor("export", result, "--format", "gltf", "-o", tmp_path / "gltf")
    assert code == 0
    assert "(3.4000 ± 0.0062)" in said
    extensions = glb_parts(tmp_path / "gltf" / "object.glb")[0]["materials"][0]["extensions"]
    specular, index = extensions["KHR_materials_specular"], extensions["KHR_materials_ior"]["ior"]
    factor = specular["specularFactor"] * glb_image(tmp_path / "gltf" / "object.glb", 1)[:, :, 3] / 255
    f0 = factor * max(specular["specularColorFactor"]) * ((index - 1) / (index + 1)) ** 2
    layers = []
    for form, name, weight in (
        ("materialx", "specular_IOR", "specular"),
        ("openpbr", "specular_ior", "specular_weight"),
    ):
        assert lightfactor("export", result, "--format", form, "-o", tmp_path / form)[0] == 0
        layer = json.loads((tmp_path / form / "export.json").read_text())["material"]["parameters"]
        colour = read_pixels(tmp_path / form / "specular_color.exr")[:, :, 1]
        index = layer[name]
        layers.append(layer[weight] * colour * ((index - 1) / (index + 1)) ** 2)
    # The mapping of the mean puts F0 up to a tenth elsewhere, for the sake of grazing angles. Cut off at what the
    # mean's index gives at most, the gilt texels' was too small by two fifths.
    for theirs in (f0, *layers):
        assert_allclose(theirs, gilt[:, :, 0], rtol=0.15)


@pytest.mark.parametrize(
    ("form", "node"), [("materialx", "standard_surface"), ("openpbr", "open_pbr_surface")]
)
def test_materialx_is_one_document_with_what_it_names(
    lightfactor: Command, result: Path, tmp_path: Path, form: str, node: str
) -> None:
    make_mesh(result, np.full((4, 8, 3), 0.1), np.linspace(0.01, 0.02, 32).reshape(4, 8, 1) * np.ones(3))
    out = tmp_path / "out"
    assert lightfactor("export", result, "--format", form, "-o", out)[0] == 0
    root = ET.parse(out / "material.mtlx").getroot()
    assert root.tag == "materialx"
    assert root.get("colorspace") == "lin_rec709"
    nodes = {child.get("name"): child for child in root}
    assert nodes["reflectance"].tag == node
    inputs = {entry.get("name"): entry for entry in nodes["reflectance"]}
    written = json.loads((out / "export.json").read_text())["material"]["parameters"]
    assert set(inputs) == set(written)
    for name, entry in inputs.items():
        if node := entry.get("nodename"):
            texels = read_pixels(out / next(iter(nodes[node])).get("value", ""))
            assert texels.shape == (4, 8, 3)
            assert 0 <= texels.min() < texels.max() <= 1
        else:
            value = np.array(entry.get("value", "").split(","), float)
            assert_allclose(value, np.atleast_1d(written[name]), rtol=1e-8)
    assert {name for name in inputs if inputs[name].get("nodename")} == {"base_color", "specular_color"}
    assert written["specular_roughness"] ** 2 == pytest.approx(0.1, abs=0.02)
    assert nodes["material"][0].get("nodename") == "reflectance"
    assert trimesh.load(out / "object.obj", process=False).bounds[1, 2] == pytest.approx(CENTRE[2] + RADIUS)
    assert sorted(path.name for path in out.iterdir()) == sorted(
        ["export.json", *json.loads((out / "export.json").read_text())["files"]]
    )


def test_undetermined_numbers_are_asked_for(lightfactor: Command, result: Path, tmp_path: Path) -> None:
    def edit(document: Any) -> None:
        document["brdf"]["sigma"] = {"value": None, "std": None, "status": "undetermined"}
        for finding in document["identifiability"]:
            if finding["parameter"] == "sigma":
                finding |= {"reason": "the light is soft", "remedy": "add a small source"}

    change(result, edit)
    out = tmp_path / "out"
    code, _, err = lightfactor("export", result, "--format", "gltf", "-o", out)
    assert code == 1
    assert not out.exists()
    for part in ("sigma is undetermined", "the light is soft", "add a small source", "--assume sigma="):
        assert part in err
    code, said, _ = lightfactor("export", result, "--format", "gltf", "--assume", "sigma=0.2", "-o", out)
    assert code == 0
    assert "sigma = 0.2 is assumed" in said
    sigma = json.loads((out / "export.json").read_text())["brdf"]["sigma"]
    assert sigma == {"value": 0.2, "result_value": None, "result_std": None, "status": "undetermined"}


def test_what_cannot_be_exported_is_refused_in_words(
    lightfactor: Command, result: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"

    def refused(*options: object, form: str = "gltf") -> str:
        code, _, err = lightfactor("export", result, "--format", form, *options, "-o", out)
        assert code == 1
        assert err.startswith("lightfactor: error: ")
        assert "Traceback" not in err
        assert not out.exists()
        return err

    assert "did you mean 'gltf'" in refused(form="glft")
    assert "there are 'gltf', 'mitsuba', 'materialx', 'openpbr'" in refused(form="usd")
    assert "has no light" in refused("--light", form="materialx")
    assert "has no camera" in refused("--view", "0,20")
    assert "did you mean 'lighting'" in refused("--light", "--lighting", "lightnig")
    assert "is known" in refused("--albedo", "0.5")
    original = (result / "result.json").read_text()
    change(result, lambda document: document.update(gauge="relative: x"))
    assert "below 1" in refused("--albedo", "50")
    (result / "result.json").write_text(original)
    change(result, lambda document: document.update(format=2))
    assert "its format is 2" in refused()
    (result / "result.json").write_text(original[: len(original) // 2])
    assert "is not valid JSON" in refused()
    (result / "result.json").write_text(original)
    (result / "lighting.exr").rename(result / "elsewhere.exr")
    assert "lighting.exr" in refused(form="mitsuba")
    make_mesh(result, np.full((4, 8, 3), 0.1), np.full((4, 4, 3), 0.02))
    assert "8x4 and 4x4" in refused()
    (result / "texture_ks.exr").unlink()
    # The ball has coordinates, but the texture isn't by them: it came out as one row of a map.
    change(result, lambda document: document.update(texture={"at": "vertices"}))
    assert "from vertex to vertex" in refused()
    (tmp_path / "set" / "ball.obj").unlink()
    assert "ball.obj" in refused()
    shutil.rmtree(tmp_path / "set")
    assert "--set" in refused()
    (result / "result.json").unlink()
    assert "holds no result.json" in refused()


def test_folders_that_hold_something_else_are_kept(
    lightfactor: Command, result: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert lightfactor("export", result, "--format", "mitsuba", "-o", out)[0] == 0
    assert lightfactor("export", result, "--format", "gltf", "-o", out)[0] == 0
    assert {path.name for path in out.iterdir()} == {"export.json", "object.glb"}
    (out / "notes.txt").write_text("mine")
    code, _, err = lightfactor("export", result, "--format", "gltf", "-o", out)
    assert code == 1
    assert "notes.txt" in err

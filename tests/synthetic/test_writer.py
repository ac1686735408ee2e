"""Photo sets as written: same bytes from the same seed, photographs that decode to the truth, faults kept secret."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import binary_erosion
from scipy.spatial.transform import Rotation

from capture.decode import decode_photo, read_mask
from capture.files.imagefile import read_pixels
from capture.lighting import read_latlong
from capture.photoset import load_photoset
from recon.mesh.trianglemesh import read_mesh
from synthetic.lights.sources import PointSource
from synthetic.render.photograph import photographs
from synthetic.render.pixels import pixel_coverage
from synthetic.scene import Shot
from synthetic.scenes import build
from synthetic.scenes.build import read_staging
from synthetic.scenes.views import seen_from
from synthetic.sensing.contactsheet import displayed, write_contact_sheet
from synthetic.shapes.ball import Ball
from synthetic.staging import Staging
from synthetic.writer import write_photoset

Write = Callable[..., tuple[Path, Staging]]

SPHERE = '[object]\nshape = "sphere"\n'
MESH = '[object]\nshape = "mesh"\nmesh = "body.obj"\ncentre = [0.001, 0, 0]\n'
GGX = '[material]\nmodel = "ggx"\nkd = [0.1, 0.2, 0.15]\nks = 0.05\nmu = 1.5\nalpha = 0.3\n'
LAB = """[[lighting]]
name = "lab"
area = [{ azimuth_deg = 60, elevation_deg = 40, radiance = [1.5, 1.6, 1.8] }]
directional = [{ azimuth_deg = -20, elevation_deg = 25, irradiance = [1.6, 1.5, 1.35] }]
"""
LAMP = """[[lighting]]
name = "lamp"
lamp = [{ azimuth_deg = 40, elevation_deg = 30, distance = 0.3, irradiance = [2, 1, 1] }]
"""
CAMERA = "[camera]\nwidth = 40\nheight = 32\nfocal_px = 380\n"
GANTRY = "[gantry]\nphotos = 2\nstep_deg = 25\nheld_out = [1]\n"
QUICK = "[render]\ndirections = 64\nper_side = 2\n"
ALL_FAULTS = """[faults]
pose_deg = 1.0
pose_m = 0.0005
mesh_m = 0.0003
misaligned_deg = 1.0
misaligned_m = 0.001
outliers = 0.05
background = "room"
"""


def scene(
    what: str = SPHERE, light: str = LAB, views: str = GANTRY, rest: str = "", camera: str = CAMERA
) -> str:
    return f'format = 1\nname = "tiny"\n{what}{GGX}{light}{camera}{views}{QUICK}{rest}'


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Photograph a scene file's text into a folder; a mesh `body.obj` lies beside the file."""
    trimesh.creation.icosphere(2, 0.02).export(tmp_path / "body.obj")

    def written(
        text: str, folder: str = "set", seed: int | None = None, sheet: bool = False
    ) -> tuple[Path, Staging]:
        (tmp_path / "tiny.toml").write_text(text)
        staging = read_staging(tmp_path / "tiny.toml", seed=seed)
        write_photoset(staging, tmp_path / folder)
        if sheet:
            write_contact_sheet(tmp_path / folder, tmp_path / folder / "contact.png")
        return tmp_path / folder, staging

    return written


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def truth_of(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    return document


CAMERAS = {
    "png": 'file = "png"\nbracket_stops = [-1, 1]\ndemosaic = true\nresponse = "film"\n',
    "jpeg": 'file = "jpeg"\n',
    "dng": 'file = "dng"\nvignetting = true\n',
}


@pytest.mark.parametrize("kind", ["mesh", *CAMERAS])
def test_one_seed_gives_one_set_of_bytes_and_another_seed_another(kind: str, write: Write) -> None:
    text = scene(MESH, rest=ALL_FAULTS) if kind == "mesh" else scene(rest=f"[sensor]\n{CAMERAS[kind]}")
    first, again, other = (
        contents(write(text, name, seed, sheet=True)[0]) for name, seed in (("a", 3), ("b", 3), ("c", 4))
    )
    assert first == again
    assert first.keys() == other.keys()
    changed = {name for name in first if first[name] != other[name]}
    # All that is random; rendering is, too, in its last digits.
    photos = {name for name in first if name.startswith("00") and "mask" not in name}
    assert len(photos) == (4 if kind == "png" else 2)
    expected = photos | {"contact.png", "truth.json", "truth/000.exr", "truth/001.exr"}
    if kind == "png":
        # The exposure is chosen by the brightest pixel.
        expected |= {"photoset.toml"}
    if kind == "mesh":
        expected |= {"photoset.toml", "object.obj", "truth/000_outliers.png", "truth/001_outliers.png"}
    assert changed == expected


@pytest.mark.parametrize(
    "sensor",
    [
        'file = "png"\n',
        'file = "png"\nbits = 16\nresponse = "film"\nvignetting = true\n',
        'file = "tiff"\n',
        'file = "dng"\nvignetting = true\n',
    ],
    ids=["8 bits", "film", "TIFF", "DNG"],
)
def test_photographs_decode_to_the_truth_within_their_noise(sensor: str, write: Write) -> None:
    folder, _ = write(scene(rest=f"[sensor]\n{sensor}"))
    photoset, truth = load_photoset(folder), truth_of(folder)
    for photo, entry in zip(photoset.photos, truth["photos"], strict=True):
        assert photo.label == entry["file"]
        image = decode_photo(photoset.radiometry, photo)
        assert not image.saturated.any()
        exact = read_pixels(folder / entry["radiance"]) * truth["sensor"]["radiance_factor"]
        assert photo.mask is not None
        # Away from the rim, where demosaicing mixes the object with the black around it.
        inside = binary_erosion(read_mask(photo.mask, exact.shape[:2]) == 1, iterations=3)
        error = image.radiance[inside] - exact[inside]
        if "dng" in sensor:
            # It mixes pixels, of which no model of noise knows: the means only.
            assert_allclose(image.radiance[inside].mean(axis=0), exact[inside].mean(axis=0), rtol=0.01)
            assert np.sqrt((error**2).mean()) < 0.05 * exact[inside].mean()
            continue
        scores = error / np.sqrt(image.variance[inside])
        # Five standard errors; counted photons and rounding are not quite the Gaussians of the noise's model.
        assert abs(scores.mean()) < 5 / np.sqrt(scores.size) + 0.02
        assert_allclose(scores.std(), 1, rtol=5 / np.sqrt(2 * scores.size) + 0.05)


def test_a_bracket_is_one_photograph_at_rising_times(write: Write) -> None:
    folder, staging = write(scene(rest='[sensor]\nfile = "tiff"\nbracket_stops = [-2, 0, 1]\n'))
    photoset = load_photoset(folder)
    assert [photo.label for photo in photoset.photos] == [f"00{i}_{k}.tif" for i in (0, 1) for k in (0, 1, 2)]
    times = [photo.exposure.exposure_s for photo in photoset.photos]
    assert_allclose(np.array(times) / times[1], [0.25, 1, 2] * 2, rtol=1e-12)  # type: ignore[operator]
    assert [photo.held_out for photo in photoset.photos] == [False] * 3 + [True] * 3
    levels = [decode_photo(photoset.radiometry, photo).radiance.mean() for photo in photoset.photos]
    # The shortest two stops below what fits, the longest one above, which clips its highlight.
    assert_allclose(levels[0], levels[1], rtol=0.02)
    assert decode_photo(photoset.radiometry, photoset.photos[2]).saturated.any()
    assert len(staging.scene.shots) == 2


def test_what_the_set_says_is_the_scene_where_nothing_is_wrong(write: Write) -> None:
    folder, staging = write(
        scene(MESH, LAB + LAMP, GANTRY + '[[view]]\nazimuth_deg = 30\nlighting = "lamp"\n')
    )
    photoset = load_photoset(folder)
    assert [photo.lighting for photo in photoset.photos] == ["lab", "lab", "lamp"]
    for photo, shot in zip(photoset.photos, staging.scene.shots, strict=True):
        assert_allclose(photo.camera.world_to_camera, shot.camera.world_to_camera, atol=1e-15)
        assert photo.held_out == shot.held_out
        coverage = pixel_coverage(staging.scene.surface, shot.camera)
        assert photo.mask is not None
        # Rounded to 255 steps.
        assert_allclose(read_mask(photo.mask, coverage.shape), coverage, atol=0.5 / 255 + 1e-6)
    lab, lamp = photoset.lightings
    assert lab.map == "lighting-lab.exr"
    assert read_latlong(photoset.resolve(lab.map)).shape == (128, 256, 3)
    (near,) = lamp.near
    assert lamp.map is None
    assert not lamp.directional
    source = staging.scene.shots[2].illumination.sources[0]
    assert isinstance(source, PointSource)
    assert_allclose(near.position, source.position, rtol=1e-15)
    assert near.intensity == tuple(source.intensity)
    assert photoset.object.mesh == "object.obj"
    handed = read_mesh(folder / "object.obj")
    placed = np.array(photoset.object.mesh_to_world)
    vertices = handed.vertices @ placed[:3, :3].T + placed[:3, 3]
    assert staging.mesh is not None
    assert_allclose(
        vertices, staging.mesh.vertices + np.array([0.001, 0, 0]), atol=1e-8
    )  # digits in the file
    assert not (folder / "truth" / "object.obj").exists()
    assert (folder / "scene.toml").read_text() == staging.source


def test_a_set_may_call_a_lamp_distant(write: Write) -> None:
    distant = LAMP.replace("[[lighting]]", '[[lighting]]\ngiven = "distant"')
    folder, staging = write(
        scene(MESH, LAB + distant, GANTRY + '[[view]]\nazimuth_deg = 30\nlighting = "lamp"\n')
    )
    lamp = load_photoset(folder).lightings[1]
    assert not lamp.near
    (told,) = lamp.directional
    assert told.direction is not None
    source = staging.scene.shots[2].illumination.sources[0]
    assert isinstance(source, PointSource)
    offset = source.position - staging.scene.surface.centre
    assert_allclose(told.direction, offset / np.linalg.norm(offset), atol=1e-12)
    # The mesh's bounding box has another middle than its origin: by 1e-6 of its size.
    assert_allclose(told.irradiance, [2, 1, 1], rtol=1e-6)


def test_faults_are_in_the_set_and_the_truth_beside_it(write: Write) -> None:
    folder, staging = write(scene(MESH, rest=ALL_FAULTS))
    photoset, truth = load_photoset(folder), truth_of(folder)
    for photo, shot, entry in zip(photoset.photos, staging.scene.shots, truth["photos"], strict=True):
        exact = shot.camera.world_to_camera
        assert_array_equal(entry["world_to_camera"], exact)
        turn = Rotation.from_matrix(photo.camera.world_to_camera[:3, :3] @ exact[:3, :3].T)
        assert 0.1 < np.degrees(turn.magnitude()) < 5  # 1 degree about each of three axes
    believed = np.array(photoset.object.mesh_to_world)
    actual = np.array(truth["object"]["mesh_to_world"])
    assert_array_equal(actual, staging.mesh_to_world)
    turn = Rotation.from_matrix(believed[:3, :3] @ actual[:3, :3].T)
    assert_allclose(np.degrees(turn.magnitude()), 1.0, rtol=1e-9)
    handed, exact = read_mesh(folder / "object.obj"), read_mesh(folder / truth["object"]["mesh"])
    distance = np.linalg.norm(handed.vertices - exact.vertices, axis=1)
    assert 1e-4 < distance.mean() < 6e-4
    assert_allclose(np.linalg.norm(exact.vertices, axis=1), 0.02, rtol=1e-6)
    # Spoilt pixels are marked; elsewhere photographs show the truth before a room, to the noise of 1%.
    for index in range(2):
        photo = read_pixels(folder / f"{index:03d}.exr")
        radiance = read_pixels(folder / "truth" / f"{index:03d}.exr")
        spoilt = read_pixels(folder / "truth" / f"{index:03d}_outliers.png")[..., 0] > 0
        coverage = read_pixels(folder / f"{index:03d}_mask.png")[..., 0] / 255
        assert_allclose(spoilt[coverage > 0].mean(), 0.05, atol=0.002)
        sound = (coverage == 1) & ~spoilt
        assert_allclose(photo[sound], radiance[sound], rtol=0.06, atol=0.006 * radiance[sound].mean())
        assert photo[coverage == 0].min(axis=0).min() > 0
    assert truth["faults"]["outliers"] == 0.05


def test_what_a_set_gives_is_off_by_what_it_states(write: Write) -> None:
    stated = (
        "rotation_deg = 0.5\nposition = 0.0002\nfocal_length = 0.01\ndirection_deg = 2.0\nheight = 0.0001\n"
    )
    views = '[gantry]\nphotos = 12\nstep_deg = 25\n[[view]]\nazimuth_deg = 5\nlighting = "lamp"\n'
    folder, staging = write(scene(MESH, LAB + LAMP, views, f"[uncertainty]\n{stated}"))
    photoset, exact = load_photoset(folder), staging.scene.shots
    assert photoset.errors.stated_pose == (np.radians(0.5), 0.0002)
    assert photoset.errors.height == 0.0001
    centre = staging.scene.surface.centre
    turns, shifts = [], []
    for photo, shot in zip(photoset.photos, exact, strict=True):
        given, true = photo.camera.world_to_camera, shot.camera.world_to_camera
        turns.append(Rotation.from_matrix(given[:3, :3] @ true[:3, :3].T).as_rotvec())
        shifts.append((given[:3, :3] @ centre + given[:3, 3]) - (true[:3, :3] @ centre + true[:3, 3]))
    # Of 39 numbers the RMS is known to 11%.
    assert_allclose(np.sqrt(np.mean(np.square(turns))), np.radians(0.5), rtol=0.3)
    assert_allclose(np.sqrt(np.mean(np.square(shifts))), 0.0002, rtol=0.3)
    # One lens is off alike in all photographs, by 1% or so.
    (focal,) = {photo.camera.params[0] for photo in photoset.photos}
    assert 1e-4 < abs(focal / exact[0].camera.params[0] - 1) < 0.03
    lab, lamp = photoset.lightings
    told = [lab.directional[0].direction, np.array(lamp.near[0].position) - centre]
    true = [shot.illumination.sources[0].at(centre[None])[0][0] for shot in (exact[0], exact[-1])]
    for one, other in zip(told, true, strict=True):
        assert 0.1 < np.degrees(np.arccos(one @ other / np.linalg.norm(one))) < 8
    assert_allclose(np.linalg.norm(told[1]), 0.3, rtol=1e-9)
    handed, mesh = read_mesh(folder / "object.obj"), read_mesh(folder / truth_of(folder)["object"]["mesh"])
    along = np.einsum("nk,nk->n", handed.vertices - mesh.vertices, mesh.normals)
    assert_allclose(along.std(), 0.0001, rtol=0.2)
    # Independent: neighbours are off otherwise.
    edges = mesh.faces[:, :2]
    assert abs(np.corrcoef(along[edges[:, 0]], along[edges[:, 1]])[0, 1]) < 0.2


def test_a_turntable_in_the_room_shows_the_same_pictures(write: Write) -> None:
    # In the object's frame the camera and the light go round; in the room's the object turns.
    text = scene(SPHERE + "centre = [0.003, -0.002, 0.001]\n")
    text = text.replace(GANTRY, "[turntable]\nphotos = 3\nstep_deg = 40\nazimuth_deg = 15\n").replace(
        QUICK, ""
    )
    text = text.replace(GGX, '[material]\nname = "delrin"\n')
    folder, staging = write(text)
    lab = staging.scene.shots[0].illumination
    camera = staging.scene.shots[0].camera.posed(seen_from(15, 20, 0.6, np.zeros(3)))
    photoset = load_photoset(folder)
    assert [photo.lighting for photo in photoset.photos] == ["lab-000", "lab-001", "lab-002"]
    assert len(photoset.lightings) == 3
    assert len({table.map for table in photoset.lightings}) == 3
    for index in range(3):
        turn = Rotation.from_euler("z", 40 * index, degrees=True).as_matrix()
        ball = Ball(turn @ staging.scene.surface.centre, staging.scene.surface.reach)
        room = replace(staging.scene, surface=ball, shots=(Shot(camera, lab),))
        ((radiance, coverage),) = photographs(room)
        written = read_pixels(folder / "truth" / f"{index:03d}.exr")
        # Single precision within the quadrature; the rim's points fall in or out by rounding.
        assert_allclose(written[coverage == 1], radiance[coverage == 1], rtol=2e-4)
        assert_allclose(written.mean(), radiance.mean(), rtol=1e-4)
        table = photoset.lightings[index]
        assert table.directional[0].direction is not None
        assert_allclose(turn @ table.directional[0].direction, lab.sources[0].direction, atol=1e-12)  # type: ignore[union-attr]


def test_secret_light_leaves_no_trace_outside_the_truth(write: Write) -> None:
    folder, _ = write(scene(light=LAB + 'given = "nothing"\n'))
    (table,) = load_photoset(folder).lightings
    assert (table.unknown, table.map, table.directional) == (True, None, ())
    assert not (folder / "lighting.exr").exists()
    (lighting,) = truth_of(folder)["lighting"]
    assert lighting["map"] == "truth/lighting.exr"
    assert read_latlong(folder / lighting["map"]).max() > 1
    assert_allclose(lighting["directional"][0]["irradiance"], [1.6, 1.5, 1.35])


def test_the_truth_says_what_was_drawn_and_how_well(write: Write) -> None:
    folder, staging = write(scene(), seed=12)
    truth = truth_of(folder)
    assert (truth["name"], truth["seed"]) == ("tiny", 12)
    assert truth["brdf"] == {
        "model": "ggx",
        "kd": [0.1, 0.2, 0.15],
        "ks": [0.05] * 3,
        "mu": 1.5,
        "alpha": 0.3,
    }
    assert truth["object"] == {"shape": "sphere", "centre": [0, 0, 0], "radius": 0.02}
    assert truth["integration"]["directions"] == staging.scene.effort.directions
    # With as few as 64 directions it isn't exact, and says so.
    assert 1e-4 < truth["integration"]["relative_rms_error"] < 0.05


def test_a_black_photograph_is_exact(write: Write) -> None:
    # The lamp stands behind the object: no light, no noise, and numbers all the same.
    behind = '[[lighting]]\nname = "lamp"\ndirectional = [{ azimuth_deg = 180, irradiance = 1 }]\n'
    folder, _ = write(scene(light=behind, views="[[view]]\nazimuth_deg = 0\n"))
    assert not read_pixels(folder / "000.exr").any()
    assert truth_of(folder)["integration"]["relative_rms_error"] == 0


def test_the_dolls_textures_are_part_of_the_truth(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "_TEXTURE_HEIGHT", 32)
    text = scene('[object]\nshape = "doll"\nedge = 0.004\n', camera=CAMERA.replace("380", "160"))
    folder, staging = write(text.replace(GGX, ""))
    assert load_photoset(folder).object.texture
    brdf = truth_of(folder)["brdf"]
    assert brdf["model"] == "microfacet"
    for key in ("kd", "ks"):
        texels = read_pixels(folder / brdf[f"{key}_map"])
        assert_allclose(texels.mean(axis=(0, 1)), brdf[key], rtol=1e-5)  # single precision
        assert texels.std() > 0
    handed = read_mesh(folder / "object.obj")
    assert staging.mesh is not None
    assert staging.mesh.uv is not None
    assert_allclose(handed.uv, staging.mesh.uv, atol=1e-6)  # digits in the file


def test_pictures_are_shown_by_the_objects_own_brightness() -> None:
    radiance = np.zeros((10, 10, 3))
    seen = np.zeros((10, 10), bool)
    seen[:5] = True
    radiance[:5] = 0.5
    radiance[0, 0] = 1000  # dust, or a lamp's image
    radiance[5:] = 100  # the room
    shown = displayed(radiance, seen)
    assert_allclose(shown[0, 0], 1)
    assert 0.2 < shown[3, 3, 0] < 0.5
    assert not displayed(np.zeros((10, 10, 3)), seen).any()
    # Half the object black, one point lit: that is what there is to see.
    radiance[:5] = 0
    radiance[0, 0] = 1
    assert_allclose(displayed(radiance, seen)[0, 0], 1)

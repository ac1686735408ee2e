from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.arc.gantry import Arc
from capture.exposure import ExposureSettings
from capture.manifest import LightingTable
from capture.photoset import PhotoSet, load_photoset

# The example of the format's definition, its comments aside.
EXAMPLE = """
format = 1
name = "teflon sphere"

[camera]
model = "OPENCV"
params = [1600.0, 1600.0, 160.0, 120.0, 0, 0, 0, 0]
width = 320
height = 240

[radiometry]
encoding = "linear"
exposure = "equal"

[object]
shape = "sphere"

[[lighting]]
name = "room"
map = "room.exr"
directional = [{ direction = [-0.3, 0.7, 0.65], irradiance = [0.6, 0.6, 0.6] }]

[[photo]]
file = "000.exr"
mask = "000_mask.png"
world_to_camera = [[1,0,0,0],[0,1,0,0],[0,0,1,0.6],[0,0,0,1]]
lighting = "room"
exposure_s = 0.02
held_out = false
"""

PINHOLE = """
format = 1
name = "set"
[camera]
model = "PINHOLE"
params = [100.0, 100, 50, 50]
width = 100
height = 90
"""
POSE = "world_to_camera = [[1,0,0,0],[0,1,0,0],[0,0,1,2],[0,0,0,1]]\n"
PHOTO = f'[[photo]]\nfile = "a.png"\n{POSE}'
KNOWN = '[[lighting]]\nname = "key"\ndirectional = [{ direction = [0, 0, 1] }]\n'
UNKNOWN = '[[lighting]]\nname = "sky"\nunknown = true\n'


@pytest.fixture
def load(tmp_path):
    def write_and_load(text: str) -> PhotoSet:
        (tmp_path / "photoset.toml").write_text(text, encoding="utf-8")
        return load_photoset(tmp_path)

    return write_and_load


def test_the_formats_example_means_what_it_says(load, tmp_path):
    photoset = load(EXAMPLE)
    (photo,) = photoset.photos
    assert (photoset.name, photoset.folder) == ("teflon sphere", tmp_path)
    assert (photoset.radiometry.encoding, photoset.radiometry.exposure) == ("linear", "equal")
    assert (photoset.object.shape, photoset.object.centre, photoset.object.radius) == ("sphere", None, None)
    (table,) = photoset.lightings
    assert (table.name, table.map, table.directional[0].irradiance) == ("room", "room.exr", (0.6, 0.6, 0.6))
    assert (photo.file, photo.mask) == (tmp_path / "000.exr", tmp_path / "000_mask.png")
    assert (photo.label, photo.lighting, photo.held_out) == ("000.exr", "room", False)
    assert photo.exposure == ExposureSettings(exposure_s=0.02)
    assert (photo.camera.model, photo.camera.width, photo.camera.height) == ("OPENCV", 320, 240)
    assert photo.camera.params.tolist() == [1600, 1600, 160, 120, 0, 0, 0, 0]
    assert_allclose(photo.camera.centre, [0, 0, -0.6], atol=1e-15)
    # The file itself will do, too.
    assert load_photoset(tmp_path / "photoset.toml").name == photoset.name


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        (PINHOLE.replace("params", "paramz") + PHOTO, ["[camera]", "'paramz'", "'params'"]),
        (PINHOLE + PHOTO + 'maks = "m.png"\n', ['[[photo]] 1 ("a.png")', "'maks'", "'mask'"]),
        (
            PINHOLE + PHOTO + "[photo.camera]\nwidht = 3\n",
            ['[[photo]] 1 ("a.png") camera', "'widht'", "'width'"],
        ),
        (
            PINHOLE + KNOWN + UNKNOWN.replace("unknown", "directinal") + PHOTO,
            ['[[lighting]] 2 ("sky")', "'directinal'", "'directional'"],
        ),
        (
            PINHOLE + '[[lighting]]\nname = "b"\nmirror_ball = { photoo = "b.png" }\n' + PHOTO,
            ['[[lighting]] 1 ("b") mirror_ball', "'photoo'", "did you mean 'photo'?"],
        ),
        (
            PINHOLE + KNOWN.replace("direction =", "directon =") + PHOTO,
            ['[[lighting]] 1 ("key") directional.0', "'directon'", "did you mean 'direction'?"],
        ),
        (PINHOLE + "[radiometri]\n" + PHOTO, ["top level", "'radiometri'", "'radiometry'"]),
        (PINHOLE + "[object]\nradios = 1\n" + PHOTO, ["[object]", "'radios'", "'radius'"]),
        (PINHOLE + "[gantry]\nradius = 1\nstrat = [1,0,0]\n" + PHOTO, ["[gantry]", "'strat'", "'start'"]),
        # Nothing is near: all keys are named.
        (PINHOLE + "[radiometry]\nqqq = 1\n" + PHOTO, ["[radiometry]", "encoding, exposure, file"]),
    ],
)
def test_an_unknown_key_is_named_with_its_table_and_the_nearest_valid_key(load, tmp_path, text, messages):
    with pytest.raises(ValueError, match="has an unknown key") as error:
        load(text)
    for message in [str(tmp_path / "photoset.toml"), *messages]:
        assert message in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = [", "is not valid TOML: "),
        (PINHOLE.replace("format = 1", "") + PHOTO, "the top level lacks the key 'format'"),
        (PINHOLE.replace("format = 1", "format = 2") + PHOTO, "key format is 2: input should be 1"),
        (PINHOLE, "the top level lacks the key 'photo'"),
        ("photo = []\n" + PINHOLE, "lists no [[photo]]"),
        ("photo = [7]\n" + PINHOLE, "key photo[0] is 7: input should be a table"),
        (PINHOLE + PHOTO.replace("[[photo]]", "[photo]"), "write its head with double brackets, [[photo]]"),
        (PINHOLE + PHOTO.replace("file", "mask"), "[[photo]] 1 (\"\") lacks the key 'file'"),
        # A wrong type is an error, never a conversion.
        (PINHOLE.replace("100\n", '"100"\n') + PHOTO, "[camera] key width is '100': input should be"),
        (PINHOLE + PHOTO + 'held_out = "no"\n', "held_out is 'no': input should be a valid boolean"),
        (PINHOLE + PHOTO + 'exposure_s = "1/30"\n', "exposure_s is '1/30': input should be a valid number"),
        (PINHOLE + PHOTO + "exposure_s = 0\n", "exposure_s is 0: input should be greater than 0"),
        (PINHOLE + PHOTO + "camera = 3\n", '[[photo]] 1 ("a.png") key camera is 3: input should be a table'),
        (
            PINHOLE + '[object]\nshape = "cube"\n' + PHOTO,
            "'cube': input should be 'sphere', 'mesh' or 'normals'",
        ),
        (PINHOLE + "[object]\nradius = nan\n" + PHOTO, "key radius is nan: input should be a finite number"),
        (PINHOLE + "[object]\ncentre = [0, 0, inf]\n" + PHOTO, "key centre[2] is inf: input should be"),
        (PINHOLE + "[object]\ncentre = [0, 0]\n" + PHOTO, "[object] key centre is too short: it lacks [2]"),
        (PINHOLE + "[object]\ncentre = [0, 0, 0, 1]\n" + PHOTO, "array should have at most 3 items"),
        (PINHOLE + '[radiometry]\nencoding = "sRGB"\n' + PHOTO, "should be 'linear', 'srgb' or 'response'"),
        # Lighting.
        (PINHOLE + UNKNOWN + 'map = "a.exr"\n' + PHOTO, '("sky") unknown = true contradicts map'),
        (
            PINHOLE + UNKNOWN + "source_regions = [{ direction = [0, 0, 0], radius_deg = 9 }]\n" + PHOTO,
            "direction is [0, 0, 0]; give the way from the object to the lamp",
        ),
        (
            PINHOLE + UNKNOWN + "source_regions = [{ direction = [0, 0, 1], radius_deg = 181 }]\n" + PHOTO,
            "source_regions.0 key radius_deg is 181: input should be less",
        ),
        (
            PINHOLE
            + '[[lighting]]\nname = "sky"\nmap = "a.exr"\n'
            + "source_regions = [{ direction = [0, 0, 1], radius_deg = 9 }]\n"
            + PHOTO,
            "source_regions says where lamps are looked for, in unknown light or on a mirror ball, but map gives",
        ),
        (PINHOLE + UNKNOWN.replace("true", "false") + PHOTO, '("sky") says nothing of the light'),
        (
            PINHOLE + KNOWN + 'mirror_ball = { photo = "b.png" }\n' + PHOTO,
            '("key") mirror_ball and directional both give this lighting',
        ),
        (PINHOLE + KNOWN + 'recover = ["colour"]\n' + PHOTO, "key recover[0] is 'colour'"),
        (PINHOLE + KNOWN + KNOWN + PHOTO, "two [[lighting]] tables are named 'key'"),
        (PINHOLE + PHOTO + 'lighting = "key"\n', "'key' is not defined; the [[lighting]] tables are none"),
        (
            PINHOLE + KNOWN + PHOTO + 'lighting = "kye"\n',
            "'kye' is not defined; the [[lighting]] tables are 'k",
        ),
        (PINHOLE + KNOWN + UNKNOWN + PHOTO, "key 'lighting' is needed, because there are 2: 'key', 'sky'"),
        # Camera and pose.
        (PINHOLE.replace("height = 90", "") + PHOTO, "photo \"a.png\": the camera lacks 'height'"),
        (PINHOLE.replace("PINHOLE", "PINHOL") + PHOTO, "photo \"a.png\": camera model 'PINHOL' is not known"),
        (PINHOLE + PHOTO.replace(POSE, ""), 'photo "a.png" has no pose; give world_to_camera'),
        (PINHOLE + PHOTO + "gantry_angle_deg = 3\n", "world_to_camera and gantry_angle_deg both give"),
        (PINHOLE + PHOTO.replace(POSE, "gantry_angle_deg = 3\n"), "but there is no [gantry] table"),
        (
            PINHOLE
            + "[gantry]\nradius = 1\naxis = [1, 0, 0]\n"
            + PHOTO.replace(POSE, "gantry_angle_deg = 3"),
            "[gantry]: start is along the axis",
        ),
        (PINHOLE + PHOTO.replace(",[0,0,0,1]]", "]"), '"a.png": world_to_camera has 3 rows; it must be 4x4'),
        (PINHOLE + PHOTO.replace("[0,0,1,2]", "[0,0,1]"), "world_to_camera is too short: it lacks [2][3]"),
        (PINHOLE + PHOTO.replace("[1,0,0,0]", "[-1,0,0,0]"), 'photo "a.png": world_to_camera mirrors'),
        (
            PINHOLE + PHOTO.replace("[1,0,0,0]", "[3,0,0,0]"),
            '"a.png": the 3x3 part of world_to_camera is not',
        ),
        (PINHOLE + PHOTO.replace("[0,0,1,2],[0,0,0,1]", "[0,0,1,0],[0,0,2,1]"), "it looks transposed"),
    ],
)
def test_a_bad_manifest_names_file_place_and_fault(load, tmp_path, text, message):
    with pytest.raises(ValueError, match=r"photoset\.toml") as error:
        load(text)
    assert str(error.value).startswith(f"{tmp_path / 'photoset.toml'}: ")
    assert message in str(error.value)


def test_every_fault_is_reported_at_once(load):
    with pytest.raises(ValueError, match="maks") as error:
        load(PINHOLE.replace("params", "paramz") + PHOTO + 'maks = "m.png"\n')
    assert [line.count("unknown key") for line in str(error.value).splitlines()] == [1, 1]


def test_a_set_that_is_not_there_says_so(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"empty: holds no photoset\.toml"):
        load_photoset(tmp_path / "empty")
    with pytest.raises(ValueError, match="nowhere: does not exist"):
        load_photoset(tmp_path / "nowhere")
    (tmp_path / "latin.toml").write_bytes('name = "Kugel, weiß"'.encode("latin-1"))
    with pytest.raises(ValueError, match=r"latin\.toml: is not a UTF-8 text file"):
        load_photoset(tmp_path / "latin.toml")


def test_paths_fill_in_environment_variables(load, monkeypatch, tmp_path):
    text = PINHOLE + PHOTO.replace("a.png", "${PHOTOS}/a.png") + 'mask = "sub/m.png"\n'
    monkeypatch.setenv("PHOTOS", os.fspath(tmp_path / "elsewhere"))
    (photo,) = load(text).photos
    assert photo.file == tmp_path / "elsewhere" / "a.png"
    assert photo.mask == tmp_path / "sub" / "m.png"
    monkeypatch.delenv("PHOTOS")
    with pytest.raises(ValueError, match=r"toml: path '\$\{PHOTOS\}/a.png' names an environment variable"):
        load(text)


def test_a_photo_without_lighting_has_the_only_one_or_an_unknown_one(load):
    untold = load(PINHOLE + PHOTO)
    assert [(table.name, table.unknown) for table in untold.lightings] == [(untold.photos[0].lighting, True)]
    assert load(PINHOLE + UNKNOWN + PHOTO).photos[0].lighting == "sky"
    two = load(PINHOLE + KNOWN + UNKNOWN + PHOTO + 'lighting = "sky"\n')
    assert two.photos[0].lighting == "sky"


def test_what_to_recover_of_a_lighting_is_read(load):
    (table,) = load(PINHOLE + KNOWN + 'recover = ["irradiance", "ambient"]\n' + PHOTO).lightings
    assert isinstance(table, LightingTable)
    assert table.recover == ("irradiance", "ambient")


def test_a_photos_own_camera_overrides_the_shared_one_key_by_key(load):
    second = PHOTO.replace("a.png", "b.png") + "[photo.camera]\nparams = [70.0, 71, 30, 20]\nwidth = 64\n"
    first, other = (photo.camera for photo in load(PINHOLE + PHOTO + second).photos)
    assert (first.params.tolist(), first.width, first.height) == ([100, 100, 50, 50], 100, 90)
    assert (other.params.tolist(), other.width, other.height) == ([70, 71, 30, 20], 64, 90)


def test_an_orthographic_camera_needs_no_params(load):
    text = PINHOLE.replace("PINHOLE", "ORTHOGRAPHIC").replace("params = [100.0, 100, 50, 50]", "")
    assert load(text + PHOTO).photos[0].camera.params.tolist() == [1, 1, 50, 45]


CAMERA_JSON = {"model": "PINHOLE", "params": [200, 210.5, 32, 24], "width": 64, "height": 48, "rms_px": 0.2}
WITH_FILE = f'format = 1\nname = "set"\n[camera]\nfile = "camera.json"\n{PHOTO}'


def test_a_camera_file_is_read_and_can_be_overridden(load, tmp_path):
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA_JSON))
    (photo,) = load(WITH_FILE + "[photo.camera]\nheight = 50\n").photos
    assert photo.camera.params.tolist() == [200, 210.5, 32, 24]
    assert (photo.camera.model, photo.camera.width, photo.camera.height) == ("PINHOLE", 64, 50)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read"),
        ("{", "is not valid JSON"),
        ("[1, 2]", "is not a JSON object"),
        (json.dumps({"model": "PINHOLE"}), "lacks the key 'params'"),
        (json.dumps(CAMERA_JSON | {"width": "64"}), "key width is '64': input should be a valid integer"),
        (json.dumps(CAMERA_JSON | {"params": [1, None, 2, 3]}), r"key params\[1\] is None"),
    ],
)
def test_a_bad_camera_file_is_named(load, tmp_path, content, message):
    if content is not None:
        (tmp_path / "camera.json").write_text(content)
    with pytest.raises(ValueError, match=rf"camera\.json: .*{message}"):
        load(WITH_FILE)


def test_gantry_angles_are_degrees_on_the_gantrys_arc(load):
    gantry = "[gantry]\nradius = 0.7\ncentre = [0.1, 0, 0]\naxis = [0, 1, 0]\nstart = [0, 0, 1]\n"
    (photo,) = load(PINHOLE + gantry + PHOTO.replace(POSE, "gantry_angle_deg = 90\n")).photos
    expected = Arc([0.1, 0, 0], [0, 1, 0], 0.7, [0, 0, 1]).pose(np.pi / 2)
    assert_allclose(photo.camera.world_to_camera, expected, atol=1e-15, equal_nan=False)
    # A quarter turn about +Y takes +Z to +X.
    assert_allclose(photo.camera.centre, [0.8, 0, 0], atol=1e-15)


def test_photos_at_equal_steps_need_no_angles_of_their_own(load):
    gantry = "[gantry]\nradius = 0.7\nstep_deg = 3\n"
    photos = (
        PHOTO.replace(POSE, "")
        + PHOTO.replace("a.png", "b.png")
        + PHOTO.replace("a.png", "c.png").replace(POSE, "")
    )
    first, _, second = load(PINHOLE + gantry + photos).photos
    arc = Arc([0, 0, 0], [0, 0, 1], 0.7, [1, 0, 0])
    assert_allclose(first.camera.world_to_camera, arc.pose(0), atol=1e-15)
    # A photo with a pose of its own doesn't stand on the gantry.
    assert_allclose(second.camera.world_to_camera, arc.pose(np.radians(3)), atol=1e-15)
    with pytest.raises(ValueError, match=r'photo "a\.png" has no pose; give gantry_angle_deg, or step_deg'):
        load(PINHOLE + "[gantry]\nradius = 0.7\n" + PHOTO.replace(POSE, ""))


def test_a_calibrated_gantry_is_read_from_its_file(load, tmp_path):
    tilt = [[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]
    arc = {"centre": [0, 0, 0.1], "axis": [0, 0, 1], "radius": 0.7, "start": [1, 0, 0], "mount": tilt}
    (tmp_path / "gantry.json").write_text(json.dumps(arc | {"step_deg": 5, "format": 1}))
    gantry = '[gantry]\nfile = "gantry.json"\n'
    photoset = load(PINHOLE + gantry + PHOTO.replace(POSE, "gantry_angle_deg = 90\n"))
    (camera,) = (photo.camera for photo in photoset.photos)
    assert_allclose(camera.centre, [0, 0.7, 0.1], atol=1e-12)
    # Tilted by atan(0.6 / 0.8) about its own x axis, downwards: what it looks at is below the arc's centre.
    assert_allclose(camera.world_to_camera[2, :3], [0, -0.8, -0.6], atol=1e-12)
    assert photoset.calibration_files == (tmp_path / "gantry.json",)
    with pytest.raises(ValueError, match=r"\[gantry\] file and radius both give the arc"):
        load(PINHOLE + gantry + "radius = 1\n" + PHOTO)
    (tmp_path / "gantry.json").write_text(json.dumps(arc))
    with pytest.raises(ValueError, match=r"gantry\.json: lacks the key 'step_deg'; a gantry\.json holds"):
        load(PINHOLE + gantry + PHOTO)


def test_lights_on_an_arc_have_the_direction_from_the_object_to_them(load):
    arc = "[light_arc]\nradius = 0.9\n[object]\ncentre = [0, 0, -0.9]\n"
    source = "{ arc_angle_deg = 90, irradiance = [1, 1, 1] }"
    lighting = f'[[lighting]]\nname = "arc"\ndirectional = [{source}]\n'
    (table,) = load(PINHOLE + arc + lighting + PHOTO).lightings
    assert_allclose(table.directional[0].direction, [0, 0.9, 0.9], atol=1e-15)
    with pytest.raises(ValueError, match=r'"arc" has arc_angle_deg, but there is no \[light_arc\] table'):
        load(PINHOLE + lighting + PHOTO)
    both = lighting.replace("arc_angle_deg", "direction = [0, 0, 1], arc_angle_deg")
    with pytest.raises(ValueError, match="a source needs direction, or arc_angle_deg"):
        load(PINHOLE + arc + both + PHOTO)


@pytest.mark.parametrize(
    ("radiometry", "message"),
    [
        ('encoding = "response"', "encoding = 'response' needs file"),
        ('encoding = "srgb"\nfile = "r.json"', "file is for encoding = 'response'"),
        ('white_balance = "camera"', "white_balance = 'camera', but no photo is camera RAW"),
        ("white_balance = [1, 0, 1]", "white_balance is .1, 0, 1.: give"),
        ('noise = "nowhere.json"', r"nowhere\.json: cannot be read"),
        ('flat_field = "nowhere.json"', r"nowhere\.json: cannot be read"),
        ('encoding = "response"\nfile = "nowhere.json"', r"nowhere\.json: cannot be read"),
    ],
)
def test_a_radiometry_that_cannot_be_is_refused(load, radiometry, message):
    with pytest.raises(ValueError, match=message):
        load(PINHOLE + f"[radiometry]\n{radiometry}\n" + PHOTO)


def test_the_psm_set_loads_and_its_photographs_are_there(data_dir, monkeypatch):
    monkeypatch.setenv("LIGHTFACTOR_DATA", os.fspath(data_dir))
    photoset = load_photoset(Path(__file__).parents[1] / "sets" / "psm")
    assert len(photoset.photos) == len(photoset.lightings) == 12
    for index, (photo, table) in enumerate(zip(photoset.photos, photoset.lightings, strict=True)):
        assert photo.lighting == table.name == f"light-{index}"
        assert table.mirror_ball is not None
        ball = [photoset.resolve(table.mirror_ball.photo[0]), photoset.resolve(table.mirror_ball.mask)]
        assert [path.name for path in ball] == [f"chrome.{index}.png", "chrome.mask.png"]
        assert [photo.file.name, photo.mask.name] == [f"gray.{index}.png", "gray.mask.png"]
        assert all(path.is_file() for path in [photo.file, photo.mask, *ball])
        # x right, y up, z towards the camera: what is to the right, up and near lies right, up, and nearer.
        step = np.diff(photo.camera.project([[0, 0, 0], [1, 2, 3]]), axis=0)
        assert_allclose(step, [[1, -2]], atol=1e-12)
        assert np.diff(photo.camera.depth([[0, 0, 0], [1, 2, 3]])) == -3


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('[object]\nmesh = "cat.ply"', r"\[object\] mesh is for shape = 'mesh'"),
        ('[radiometry]\nfile = "response.json"', r"\[radiometry\] file is for encoding = 'response'"),
    ],
)
def test_a_key_that_nothing_would_read_is_refused(tmp_path, table, message):
    (tmp_path / "photoset.toml").write_text(f'format = 1\nname = "n"\nphoto = []\n{table}\n')
    with pytest.raises(ValueError, match=message):
        load_photoset(tmp_path)

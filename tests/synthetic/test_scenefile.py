"""What scene files may not say: one clear sentence, with the file and the key, for each thing that is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_names, scene_path

from .scenetext import CAMERA, GANTRY, LIGHT, LIGHTING, MATERIAL, OBJECT, WHOLE, read

# What of the whole scene file is replaced, by what, and what is said about it.
WRONG = {
    "a misspelt key": (
        "focal_px",
        "focal_pix",
        r"\[camera\] has an unknown key 'focal_pix'; did you mean 'focal_px'",
    ),
    "a misspelt key in a list": (
        "irradiance",
        "iradiance",
        r'\[\[lighting\]\] 1 \("lab"\) directional.0 has an unknown key',
    ),
    "a word for a number": (
        "width = 24",
        'width = "24"',
        r"\[camera\] key width is '24': input should be a valid integer",
    ),
    "an endless number": ("220", "inf", r"\[camera\] key focal_px is inf: input should be a finite number"),
    "another format": ("format = 1", "format = 2", "key format is 2: input should be 1"),
    "no TOML": ("format = 1", "format =", r"is not valid TOML: Invalid value \(at line 1"),
    "a table for a list of tables": (
        "[[lighting]]",
        "[lighting]",
        r"write its head with double brackets, \[\[lighting\]\]",
    ),
    "no camera": (CAMERA, "", "lacks the key 'camera'"),
    "no photographs": (GANTRY, "", r"has no photographs: give \[gantry\], \[turntable\] or \[\[view\]\]"),
    "no light": (LIGHT, "", r'"lab"\) has no light: give area, directional, lamp or map'),
    "no material": (MATERIAL, "", r"lacks the table \[material\]; only the doll brings its own"),
    "a shape": ("sphere", "sphre", "key shape is 'sphre': input should be 'sphere', 'cat', 'doll' or 'mesh'"),
    "a key of another shape": (
        OBJECT,
        OBJECT + "edge = 0.001\n",
        r"\[object\] edge is for shape = 'cat' or 'doll'",
    ),
    "a mesh without a file": ("sphere", "mesh", r"\[object\] lacks the key 'mesh': the file of the mesh"),
    "a mesh that is missing": (
        OBJECT,
        '[object]\nshape = "mesh"\nmesh = "none.obj"\n',
        r"tiny.toml: .*none.obj: there is no such file",
    ),
    "an open mesh": (
        OBJECT,
        '[object]\nshape = "mesh"\nmesh = "open.obj"\n',
        r"\[object\] open.obj: the mesh isn't closed",
    ),
    "a colour": ("kd = 0.2", 'kd = "red"', r"\[material.kd\] is 'red': give one number >= 0, or three"),
    "two channels": ("kd = 0.2", "kd = [0.1, 0.2]", r"\[material.kd\] is \[0.1, 0.2\]: give one number"),
    "a yes": ("kd = 0.2", "kd = true", r"\[material.kd\] is True: give one number"),
    "too bright": (
        "kd = 0.2",
        "kd = 0.5",
        r"tiny.toml: the material reflects 1.57 of the light that falls on it \(red",
    ),
    "too glossy": (
        MATERIAL,
        "[material]\nkd = 0.1\nks = 0.9\nsigma = 0.1\nmu = 1.5\n",
        r"reflects 2.39 of the light .* lower kd or ks",
    ),
    "a parameter of another model": (
        "kd = 0.2",
        "kd = 0.2\nsigma = 0.1",
        r"\[material\] sigma is no parameter of model = 'lambertian', which has kd",
    ),
    "a parameter that lacks": (
        MATERIAL,
        "[material]\nkd = 0.1\nks = 0.1\n",
        r"\[material\] lacks the key 'sigma', which model = 'microfacet' needs",
    ),
    "a plastic of two widths": (
        MATERIAL,
        '[material]\nmodel = "plastic"\nkd = 0.1\nks = 0.04\nmu = 1.5\nsigma = 0.1\nalpha = 0.1\n',
        "model = 'plastic' needs sigma, of facets as 'smith' has them, or alpha, as 'ggx' does: one of the two",
    ),
    "a plastic without an index": (
        MATERIAL,
        '[material]\nmodel = "plastic"\nkd = 0.1\nks = 0.04\nsigma = 0.1\n',
        "lacks the key 'mu', which model = 'plastic' needs",
    ),
    "no kd": (
        MATERIAL,
        "[material]\nsigma = 0.1\nks = 0.1\n",
        "lacks the key 'kd', which model = 'microfacet' needs",
    ),
    "a name and a parameter": (
        MATERIAL,
        '[material]\nname = "teflon"\nkd = 0.1\n',
        r"\[material\] name and kd both give the material: remove one",
    ),
    "a name and a model": (
        "kd = 0.2",
        'name = "teflon"',
        "is a sphere of RH01, for model = 'microfacet' or 'smith'",
    ),
    "an index below 1": (
        MATERIAL,
        "[material]\nkd = 0.1\nks = 0.1\nsigma = 0.1\nmu = 0.9\n",
        r"\[material\] key mu is 0.9: input should be greater than 1",
    ),
    "a table that is missing": (
        MATERIAL,
        '[material]\nmodel = "table"\nfile = "none.binary"\n',
        r"none.binary: cannot be read \(No such file",
    ),
    "a Cornell file that is missing": (
        MATERIAL,
        '[material]\nmodel = "table"\nfile = "none.txt"\n',
        r"tiny.toml: .*none.txt: cannot be read \(No such file",
    ),
    "a painted doll with a kd": (
        "sphere",
        "doll",
        r"has kd in \[material\], but the doll is painted: remove it",
    ),
    "two directions": (
        "azimuth_deg = -20",
        "direction = [0, 0, 1], azimuth_deg = -20",
        r"directional.0 needs direction, or azimuth_deg with elevation_deg: one of the two",
    ),
    "no direction": ("azimuth_deg = -20, ", "", "directional.0 needs direction, or azimuth_deg"),
    "no way to a lamp": (
        LIGHT,
        "lamp = [{ direction = [0, 0, 0], distance = 1, irradiance = 1 }]\n",
        r"direction of a lamp is \[0.0, 0.0, 0.0\]",
    ),
    "a lamp in the object": (
        LIGHT,
        "lamp = [{ azimuth_deg = 0, distance = 0.01, irradiance = 1 }]\n",
        r"the lamp at \[0.01, 0.0, 0.0\] m stands inside the object",
    ),
    "a map that is missing": (LIGHT, 'map = "none.exr"\n', r"tiny.toml: .*none.exr: does not exist"),
    "a scale without a map": (
        LIGHT,
        LIGHT + "map_scale = 2\n",
        "map_scale is for a map: remove it, or give map",
    ),
    "a name that is no file's": ('"lab"', '"a/b"', r"name is 'a/b', but names files: write it with letters"),
    "one name for two": (
        CAMERA,
        LIGHTING + CAMERA,
        r"has two \[\[lighting\]\] tables named 'lab'; names must differ",
    ),
    "an idle lighting": (
        CAMERA,
        LIGHTING.replace("lab", "lamp") + CAMERA,
        "has a lighting 'lamp' under which nothing is photographed: write lighting = 'lamp' in",
    ),
    "an unknown lighting": (
        GANTRY,
        GANTRY + 'lighting = "lap"\n',
        r"names lighting 'lap' in \[gantry\]; there are 'lab'",
    ),
    "an unknown lighting in a view": (
        GANTRY,
        '[[view]]\nazimuth_deg = 1\n[[view]]\nazimuth_deg = 2\nlighting = "lap"\n',
        r"names lighting 'lap' in \[\[view\]\] 2",
    ),
    "a ball without its table": (
        LIGHT,
        LIGHT + 'given = "ball"\n',
        r"gives a lighting by 'ball': add a \[mirror_ball\]",
    ),
    "a lamp in a ball": (
        LIGHT,
        "lamp = [{ azimuth_deg = 0, distance = 1, irradiance = 1 }]\n[mirror_ball]\nazimuths_deg = [0]\n",
        "lighting 'lab': a mirror ball can't show from one place how far a lamp is",
    ),
    "held out beyond the end": (
        GANTRY,
        GANTRY + "held_out = [2]\n",
        "held_out names photograph 2, counted from 0, but there are 2",
    ),
    "an arc along its axis": (GANTRY, GANTRY + "axis = [1, 0, 0]\n", "start is along the axis"),
    "two places of a view": (
        GANTRY,
        "[[view]]\nazimuth_deg = 1\nworld_to_camera = [[1,0,0,0],[0,1,0,0],[0,0,1,1],[0,0,0,1]]\n",
        r"\[\[view\]\] 1 .* needs azimuth_deg \(elevation_deg, distance\), or world_to_camera: one of the two",
    ),
    "a pose of three rows": (
        GANTRY,
        "[[view]]\nworld_to_camera = [[1,0,0,0],[0,1,0,0],[0,0,1,1]]\n",
        r"world_to_camera has shape \(3, 4\); it must be 4x4",
    ),
    "a camera in the object": (
        GANTRY,
        "[[view]]\nazimuth_deg = 0\ndistance = 0.01\n",
        r"camera 0 at \[0.01, 0.0, .*\] m is inside the object",
    ),
    "an object out of the picture": (
        OBJECT,
        OBJECT + "centre = [0, 1, 0]\n",
        r"the object's centre is at pixel \[378.7, 10.0\] of camera 0, outside its 24 x 20 picture",
    ),
    "noise of a camera": (
        GANTRY,
        GANTRY + '[sensor]\nfile = "png"\nnoise = 0.1\n',
        r"\[sensor\] noise is the ideal sensor's, for file = 'exr', but",
    ),
    "bits of floats": (
        GANTRY,
        GANTRY + "[sensor]\nbits = 8\n",
        r"\[sensor\] bits is a camera's: give file = 'png'",
    ),
    "two exposures": (
        GANTRY,
        GANTRY + '[sensor]\nfile = "png"\nexposure_s = 1\nsaturated = 0.1\n',
        "exposure_s and saturated both give the exposure: remove one",
    ),
    "an empty bracket": (
        GANTRY,
        GANTRY + '[sensor]\nfile = "png"\nbracket_stops = []\n',
        r"bracket is \[\]; it must be rising stops",
    ),
    "calibration of no camera": (
        GANTRY,
        GANTRY + "[calibration]\n",
        r"has \[calibration\], photographs of a camera, but the sensor writes EXR",
    ),
    "no board": (
        GANTRY,
        GANTRY + '[sensor]\nfile = "png"\n[calibration]\nboard = "x"\n',
        r"\[calibration.board\] board 'x': 'x' is no kind of board",
    ),
    "a background": (
        GANTRY,
        GANTRY + '[faults]\nbackground = "white"\n',
        r"\[faults.background\] is 'white': give 'black', 'room', or a radiance",
    ),
    "a background of two": (
        GANTRY,
        GANTRY + "[faults]\nbackground = [1, 2]\n",
        r"\[faults.background\] is \[1, 2\]",
    ),
    "all outliers": (
        GANTRY,
        GANTRY + "[faults]\noutliers = 1.0\n",
        r"\[faults\] key outliers is 1.0: input should be less than 1",
    ),
    "a misaligned sphere": (
        GANTRY,
        GANTRY + "[faults]\nmisaligned_m = 0.1\n",
        r"has misaligned_m in \[faults\], which is for meshes",
    ),
    "a sphere's scan": (
        GANTRY,
        GANTRY + "[uncertainty]\nheight = 1e-4\n",
        r"has height in \[uncertainty\], of a mesh's vertices, but shows a sphere",
    ),
    "a sure pose": (GANTRY, GANTRY + "[uncertainty]\nrotation = 0.1\n", "rotation"),
    "sub-samples": (GANTRY, GANTRY + "[render]\nper_side = 3\n", "per_side is 3; it must be 1, 2, 4 or 8"),
    "directions": (
        GANTRY,
        GANTRY + "[render]\ndirections = 500\n",
        "directions is 500; it must be a power of two and at least",
    ),
    "too many reflections": (
        GANTRY,
        GANTRY + "[render]\nbounces = 17\n",
        "bounces is 17; it must be 0 to 16",
    ),
    "reflections of RH01's lobe": (
        MATERIAL,
        '[material]\nname = "teflon"\n[render]\nbounces = 1\n',
        "RH01's lobe as printed reflects without bound at grazing angles.* use model = 'smith'",
    ),
    "a lamp in a mirror": (
        MATERIAL,
        '[material]\nmodel = "mirror"\nkd = 0\nks = 1\n',
        "a mirror shows lamps only if they have a size: give the sources of lighting 'lab' a radius_deg",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_with_file_and_key(tmp_path: Path, case: str) -> None:
    old, new, message = WRONG[case]
    assert WHOLE.count(old) >= 1
    (tmp_path / "open.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(ValueError, match=message) as raised:
        read(tmp_path, WHOLE.replace(old, new, 1))
    assert str(raised.value).startswith(str(tmp_path / "tiny.toml"))


def test_a_file_that_is_missing_or_no_text(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none.toml: cannot be read \(No such file"):
        read_staging(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"name = '\xff\xfe'")
    with pytest.raises(ValueError, match=r"bytes.toml: is not valid TOML: 'utf-8' codec can't decode"):
        read_staging(tmp_path / "bytes.toml")
    with pytest.raises(ValueError, match=r"cannot be read \(Is a directory\)"):
        read_staging(tmp_path)


def test_the_painted_doll_bounces_no_lobe_of_rh01(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Its material is a texture over one.
    monkeypatch.setattr("synthetic.scenes.build._TEXTURE_HEIGHT", 32)
    doll = WHOLE.replace(OBJECT, '[object]\nshape = "doll"\nedge = 0.004\n').replace(MATERIAL, "")
    with pytest.raises(ValueError, match="RH01's lobe as printed"):
        read(tmp_path, doll + "[render]\nbounces = 1\n")


def test_a_name_is_a_built_in_scene_or_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # The folder into which a scene was photographed doesn't stand in its way.
    (tmp_path / "rh01-cat").mkdir()
    assert scene_path("rh01-cat").name == "rh01-cat.toml"
    assert "rh01-cat" in scene_names()
    (tmp_path / "mine").write_text(WHOLE)
    assert scene_path("mine") == Path("mine")
    assert scene_path("new.toml") == Path("new.toml")
    with pytest.raises(ValueError, match=r"'rh01-kat' is no built-in scene .* did you mean 'rh01-cat'"):
        scene_path("rh01-kat")
    with pytest.raises(ValueError, match="`lightfactor synth --list` shows them"):
        scene_path("xyzzy")

"""`calibrate response` and `hdr` as a user meets them: files in, files out, and sentences when something is wrong."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from capture.bracket.response import read_response
from capture.commands.hdr import hdr
from capture.commands.response import response
from capture.files.imagefile import read_exr_layers, read_pixels, write_exr
from synthetic.sensing.sensor import Sensor, expose

TIMES = (1.0, 0.25, 4.0)


def scene() -> np.ndarray:
    rng = np.random.default_rng(11)
    noise = cv2.GaussianBlur(rng.normal(size=(36, 48, 3)), (0, 0), 6)
    return 0.1 * np.exp2(np.linspace(-2, 2, 36)[:, None, None] + 2 * noise / noise.std())


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bracket with ä")
    paths = []
    for index, time in enumerate(TIMES):
        codes = expose(scene(), time, Sensor(response="srgb", bits=8), np.random.default_rng(index))
        exif = Image.Exif()
        exif.get_ifd(34665)[33434] = IFDRational(int(4 * time), 4)
        exif[34665] = 0  # Pillow writes the sub-directory only where the main one mentions it
        paths.append(folder / f"photo {index} ä.png")
        Image.fromarray(codes).save(paths[-1], exif=exif)
    return paths


def test_a_bracket_becomes_a_response_and_then_radiance(photos, tmp_path, capsys):
    curve = tmp_path / "r é.json"
    response(photos, output=curve)  # exposures from EXIF
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r é-figure.png", "r é.json"]
    document = json.loads(curve.read_text(encoding="utf-8"))
    assert set(document["inputs"]) == {path.name for path in photos}
    assert [one["given"] for one in document["ratios"]] == pytest.approx([4, 4])
    assert len(document["channels"]["green"]["log_exposure"]) == 256
    assert read_response(curve).determined(1)[0] < 0.05
    printed = capsys.readouterr().out
    # Of three times, each known to 4%, the ratio of neighbours is known to 4% / sqrt(2).
    assert re.search(r"(4|4\.0\d+|3\.99\d*) ± 0\.1[01]", printed)
    assert "certain to 2.0%" in " ".join(printed.split())

    truth = scene()
    for out, settings in (("a.exr", {"response": curve}), ("b.exr", {"encoding": "srgb"}), ("c.exr", {})):
        from capture.commands.hdr import Encoding

        if "encoding" in settings:
            settings = {"encoding": Encoding.SRGB}
        hdr(photos, tmp_path / out, **settings)
        radiance = read_pixels(tmp_path / out)
        layers = read_exr_layers(tmp_path / out)
        known = layers["saturated"] == 0
        assert known.mean() > 0.95
        ratio = radiance[known] / truth[known]
        # Noise of single pixels in the dark is some per cent; a scale is free where the response was recovered.
        assert np.median(np.abs(ratio / np.median(ratio, axis=0) - 1)) < 0.02
        scaled = (radiance[known] - np.median(ratio, axis=0) * truth[known]) / np.sqrt(
            layers["variance"][known]
        )
        assert 0.7 < np.sqrt(np.median(scaled**2) / 0.4549) < 1.4
    assert "the response that this bracket shows" in capsys.readouterr().out


def test_linear_files_merge_and_compare(tmp_path, capsys):
    truth = scene().astype(np.float32)
    times = (0.1, 0.4)
    rng = np.random.default_rng(0)
    paths = []
    for index, time in enumerate(times):
        paths.append(tmp_path / f"{index}.exr")
        write_exr(paths[-1], truth * time + 1e-3 * rng.normal(size=truth.shape))
    write_exr(tmp_path / "other.exr", truth * np.array([1, 2, 3]))
    hdr(paths, tmp_path / "out.exr", times="0.1, 0.4", compare=tmp_path / "other.exr")
    printed = " ".join(capsys.readouterr().out.split())
    assert "The files are linear." in printed
    assert "after a scale of 0.5" in printed
    # sqrt(0.1^2 + 0.4^2) is the exposure that both have together.
    variance = read_exr_layers(tmp_path / "out.exr")["variance"]
    assert np.median(variance) == pytest.approx(1e-6 / (0.1**2 + 0.4**2), rel=0.15)


def test_what_is_wrong_is_said_and_nothing_is_written(photos, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    cut = tmp_path / "cut.png"
    cut.write_bytes(photos[0].read_bytes()[:1500])
    bare = tmp_path / "bare.png"
    Image.open(photos[0]).convert("RGB").copy().save(bare)
    cases = (
        (photos[:1], {}, "photo 0 ä.png: .*two or more"),
        (photos, {"times": "1,1,1"}, "all exposures are equal"),
        (photos, {"times": "1,2"}, "2 exposure times for 3 photos"),
        (photos, {"times": "1,x,2"}, "'x' is not a number of seconds"),
        ([*photos[:2], cut], {"times": "1,2,3"}, r"cut\.png: cannot be decoded"),
        ([*photos[:2], bare], {}, r"bare\.png: its EXIF holds no exposure time; .*--times"),
    )
    for images, settings, message in cases:
        with pytest.raises(ValueError, match=message):
            response(images, output=out / "r.json", **settings)
        with pytest.raises(ValueError, match=message):
            hdr(images, out / "o.exr", **settings)
    with pytest.raises(ValueError, match=r"o\.png: must end in \.exr"):
        hdr(photos, out / "o.png")
    reversed_times = ",".join(str(1 / time) for time in TIMES)
    with pytest.raises(ValueError, match=r"photo 2 ä\.png, although its exposure .* look reversed"):
        response(photos, times=reversed_times, output=out / "r.json")
    assert not list(out.iterdir())

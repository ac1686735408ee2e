"""Damaged JPEG data are refused, and whole ones aren't, however they were written."""

from __future__ import annotations

import io
import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from capture.decode import decode
from capture.files.jpegscan import jpeg_fault

SECTOR = 512


def photograph(height: int = 400, width: int = 600) -> np.ndarray:
    """Smooth shades with noise, as cameras see them."""
    rng = np.random.default_rng(0)
    shades = cv2.resize(rng.uniform(0, 255, (9, 12, 3)), (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(shades + rng.normal(0, 4, shades.shape), 0, 255).astype(np.uint8)


def jpeg(picture: np.ndarray, mode: str = "RGB", **options) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).convert(mode).save(file, "JPEG", **options)
    return file.getvalue()


GREY = np.full((96, 130, 3), 128, np.uint8)
PICTURES = {
    "photograph": photograph(120, 90),
    "black": np.zeros_like(GREY),
    # Middle grey is what decoders put where data are missing.
    "grey": GREY,
    "grey at the end": np.concatenate([photograph(100, 130), GREY]),
    "a line": photograph(1, 70),
}
WRITTEN = {
    "baseline": {},
    "own codes": {"optimize": True},
    "restarts": {"restart_marker_blocks": 5},
    "restarts by rows": {"restart_marker_rows": 1},
    "progressive": {"progressive": True},
    "progressive with restarts": {"progressive": True, "restart_marker_rows": 1},
}


@pytest.mark.parametrize("options", WRITTEN.values(), ids=WRITTEN)
@pytest.mark.parametrize("picture", PICTURES.values(), ids=PICTURES)
def test_whole_files_have_no_fault(picture, options):
    for quality, (mode, subsampling) in itertools.product(
        (30, 95), (("RGB", 0), ("RGB", 1), ("RGB", 2), ("L", 0), ("CMYK", 0))
    ):
        data = jpeg(picture, mode, quality=quality, subsampling=subsampling, **options)
        assert jpeg_fault(data) is None
        # Phones write more pictures behind the first one; some cameras pad their data with zeros.
        assert jpeg_fault(data + data) is None
        if "progressive" not in options:
            assert jpeg_fault(data[:-2] + bytes(100) + data[-2:]) is None


DAMAGES = {
    "cut off and closed": lambda data, at: data[:at] + b"\xff\xd9",
    "a sector is lost": lambda data, at: data[:at] + data[at + SECTOR :],
    "a sector is zero": lambda data, at: data[:at] + bytes(SECTOR) + data[at + SECTOR :],
    "a sector is another file's": lambda data, at: (
        data[:at] + np.random.default_rng(at).bytes(SECTOR) + data[at + SECTOR :]
    ),
    "two sectors changed places": lambda data, at: (
        data[:at]
        + data[at + 4 * SECTOR : at + 8 * SECTOR]
        + data[at : at + 4 * SECTOR]
        + data[at + 8 * SECTOR :]
    ),
}


@pytest.mark.parametrize("written", ["baseline", "own codes", "restarts", "restarts by rows"])
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_damage_in_the_middle_is_refused_in_silence(tmp_path: Path, capfd, damage, written):
    data = jpeg(photograph(), quality=92, **WRITTEN[written])
    path = tmp_path / "photo.jpg"
    places = np.linspace(0.1, 0.8, 12) * len(data)
    refused = 0
    for at in places.astype(int):
        path.write_bytes(damage(data, at))
        try:
            decode(path)
        except ValueError as error:
            assert "photo.jpg: cannot be decoded; it is truncated, damaged" in str(error)  # noqa: PT017
            refused += 1
    # Codes that fall back into step at once after a wrong part are rare: one or two in twelve in the worst case.
    assert refused >= len(places) - 2
    if refused == len(places):
        assert capfd.readouterr().err == ""


def test_restarts_locate_the_damage():
    data = jpeg(photograph(), quality=92, subsampling=2, restart_marker_rows=1)
    starts = [k for k in range(len(data) - 1) if data[k] == 0xFF and 0xD0 <= data[k + 1] <= 0xD7]
    # In the fourth row of 16 pixels.
    damaged = data[: starts[2] + 200] + data[starts[2] + 300 :]
    assert jpeg_fault(damaged) == "its data are out of step between the rows 48 to 64"
    lost = data[: starts[2] + 2] + data[starts[3] + 2 :]
    assert "restart markers" in str(jpeg_fault(lost))


def test_progressive_files_with_data_left_over_are_refused():
    data = jpeg(photograph(), quality=92, progressive=True)
    scans = [k for k in range(len(data) - 1) if data[k : k + 2] == b"\xff\xda"]
    # A hole of 2 kB in the largest scan, and in the first one: half of such damage is seen.
    sizes = np.diff([*scans, len(data)])
    refused = 0
    for scan in (int(sizes.argmax()), 0):
        middle = scans[scan] + int(sizes[scan]) // 2
        refused += sum(
            jpeg_fault(data[: middle + k] + data[middle + k + 300 :]) is not None for k in range(8)
        )
    assert refused >= 4


def test_damage_in_a_compressed_tiff_is_refused(tmp_path: Path, capfd):
    whole, path = tmp_path / "whole.tif", tmp_path / "photo.tif"
    assert cv2.imwrite(str(whole), photograph().astype(np.uint16) * 257, [cv2.IMWRITE_TIFF_COMPRESSION, 8])
    data = bytearray(whole.read_bytes())
    decode(whole)
    data[len(data) // 2] ^= 16
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"photo\.tif: cannot be decoded; .*checksums are wrong"):
        decode(path)
    assert capfd.readouterr() == ("", "")

"""Files that cannot be read: each is named, and the codecs keep silent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from capture.decode import decode
from capture.files.imagefile import read_pixels, write_exr

from .pictures import write


def noise(suffix: str, folder: Path) -> bytes:
    """A valid file of noise, which hardly compresses."""
    rgb = np.random.default_rng(8).integers(0, 256, (40, 50, 3), np.uint8)
    path = folder / f"good{suffix}"
    if suffix == ".exr":
        write_exr(path, rgb / 255)
    else:
        write(path, rgb if suffix != ".hdr" else rgb.astype(np.float32))
    return path.read_bytes()


@pytest.mark.parametrize("share", [0.01, 0.5, 0.95])
@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".exr", ".hdr"])
def test_a_truncated_file_is_named_in_silence(tmp_path, capfd, suffix, share):
    whole = noise(suffix, tmp_path)
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(ValueError, match=rf"cut{suffix}: cannot be decoded.* truncated, damaged or not an"):
        decode(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".exr", ".hdr"])
def test_a_file_that_is_no_image_is_named_in_silence(tmp_path, capfd, suffix):
    path = tmp_path / f"text{suffix}"
    path.write_text("This is a text file.\n" * 100)
    with pytest.raises(ValueError, match=rf"text{suffix}: cannot be decoded"):
        decode(path)
    path.write_bytes(b"")
    with pytest.raises(ValueError, match=rf"text{suffix}: (is an empty file|cannot be decoded)"):
        decode(path)
    with pytest.raises(ValueError, match=rf"nowhere{suffix}: does not exist"):
        decode(tmp_path / f"nowhere{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(ValueError, match=rf"folder{suffix}: is a folder"):
        decode(tmp_path / f"folder{suffix}")
    assert capfd.readouterr() == ("", "")


def test_what_is_printed_around_a_decoding_is_not_lost(tmp_path, capfd):
    print("before")  # noqa: T201
    (tmp_path / "a.png").write_text("text")
    with pytest.raises(ValueError, match="cannot be decoded"):
        decode(tmp_path / "a.png")
    print("after")  # noqa: T201
    assert capfd.readouterr().out == "before\nafter\n"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_counted_and_located(tmp_path, value):
    radiance = np.ones((5, 6, 3), np.float32)
    radiance[2, 4, 1] = value
    radiance[3, 0] = value
    write_exr(tmp_path / "a.exr", radiance)
    with pytest.raises(ValueError, match=r"a\.exr: 2 pixels are not finite.* column 4, row 2"):
        decode(tmp_path / "a.exr")


def test_exr_channels_are_grey_or_colour_and_nothing_else(tmp_path):
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    grey = np.random.default_rng(9).random((4, 5)).astype(np.float32)

    def write_channels(*names: str) -> Path:
        with OpenEXR.File(header, dict.fromkeys(names, grey)) as file:
            file.write(str(tmp_path / "a.exr"))
        return tmp_path / "a.exr"

    assert_array_equal(read_pixels(write_channels("Y")), np.stack([grey] * 3, axis=-1))
    assert_array_equal(read_pixels(write_channels("R", "G", "B", "A", "Z")), np.stack([grey] * 3, axis=-1))
    with pytest.raises(ValueError, match=r"a\.exr: holds the channels G, R; R, G, B \(or Y\) are needed"):
        read_pixels(write_channels("R", "G"))
    with pytest.raises(ValueError, match=r"a\.exr: holds luminance and chroma"):
        read_pixels(write_channels("Y", "RY", "BY"))


def test_integers_of_another_size_are_named(tmp_path):
    Image.fromarray(np.zeros((4, 5), np.int32)).save(tmp_path / "a.tif")
    with pytest.raises(ValueError, match=r"a\.tif: pixels are int32; 8- or 16-bit"):
        decode(tmp_path / "a.tif")

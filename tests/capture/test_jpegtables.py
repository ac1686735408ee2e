from __future__ import annotations

import io

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from capture.files.jpegtables import jpeg_tables


def compressed(mode: str = "RGB", **options) -> bytes:
    buffer = io.BytesIO()
    noise = np.random.default_rng(1).integers(0, 256, (40, 56, 4), np.uint8)
    Image.fromarray(noise[..., :3]).convert(mode).save(buffer, "JPEG", **options)
    return buffer.getvalue()


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize(
    ("subsampling", "reduction"), [("4:4:4", (1, 1)), ("4:2:2", (1, 2)), ("4:2:0", (2, 2))]
)
def test_tables_are_those_of_the_standard(progressive, subsampling, reduction):
    exif = Image.Exif()
    exif[0x010F] = "maker"  # a segment before the tables
    data = compressed(quality=50, subsampling=subsampling, progressive=progressive, exif=exif)
    found = jpeg_tables(memoryview(data))
    # At quality 50 libjpeg writes the examples of ITU-T T.81, annex K; that of luma isn't symmetric.
    assert_array_equal(found.steps[0, 0], [16, 11, 10, 16, 24, 40, 51, 61])
    assert_array_equal(found.steps[0, :, 0], [16, 12, 14, 14, 18, 24, 49, 72])
    assert_array_equal(found.steps[1:, 0], [[17, 18, 24, 47, 99, 99, 99, 99]] * 2)
    assert found.reduction == ((1, 1), reduction, reduction)
    assert found.luma_chroma


def test_own_tables_land_where_they_belong():
    # A step of its own for each coefficient tells every permutation.
    own = list(range(1, 65))
    found = jpeg_tables(memoryview(compressed(qtables=[own, own[::-1]])))
    assert_array_equal(found.steps[:2].reshape(2, 64), [own, own[::-1]])


def test_grey_and_colours_without_luma():
    grey = jpeg_tables(memoryview(compressed("L", quality=90)))
    assert grey.steps.shape == (1, 8, 8)
    assert grey.luma_chroma
    plain = jpeg_tables(memoryview(compressed(quality=90, keep_rgb=True)))
    assert not plain.luma_chroma


def test_what_is_no_jpeg_or_cut_off_has_no_tables():
    data = compressed()
    assert jpeg_tables(memoryview(b"\x89PNG" + bytes(60))) is None
    frame = data.index(b"\xff\xc0")
    for length in (2, 5, 30, frame + 3, frame + 12):
        assert jpeg_tables(memoryview(data[:length])) is None

from __future__ import annotations

import numpy as np
import pytest
import rawpy
from numpy.testing import assert_allclose, assert_array_equal

from synthetic.sensing.dng import write_dng


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_libraw_reads_back_mosaic_levels_and_exposure(tmp_path, pattern):
    mosaic = np.random.default_rng(1).integers(0, 16384, (30, 44))
    path = tmp_path / "a.dng"
    black = (511, 512, 513, 514)
    write_dng(
        path,
        mosaic,
        black=black,
        white=15000,
        pattern=pattern,
        exposure_s=1 / 125,
        iso=400,
        f_number=5.6,
        neutral=(0.5, 1.0, 0.625),
    )
    with rawpy.imread(str(path)) as raw:
        assert_array_equal(raw.raw_image_visible, mosaic)
        assert raw.white_level == 15000
        names = raw.color_desc.decode()
        assert "".join(names[raw.raw_color(*cell)] for cell in np.ndindex(2, 2)) == pattern
        by_colour = [raw.black_level_per_channel[raw.raw_color(*cell)] for cell in np.ndindex(2, 2)]
        assert_array_equal(by_colour, black)
        gains = np.array(raw.camera_whitebalance[:3])
        assert_allclose(gains / gains[1], [2.0, 1.0, 1.6], rtol=1e-6)  # LibRaw's float32
        assert raw.other.shutter_speed == pytest.approx(1 / 125, rel=1e-6)
        assert raw.other.iso_speed == 400
        assert raw.other.aperture == pytest.approx(5.6, rel=1e-6)


def test_refuses_what_no_bayer_sensor_gives(tmp_path):
    with pytest.raises(ValueError, match=r"a\.dng: the mosaic is \(3, 4\); it must be \(h, w\), both even"):
        write_dng(tmp_path / "a.dng", np.zeros((3, 4), int))
    with pytest.raises(ValueError, match="codes run from 0 to 70000; 16 bits"):
        write_dng(tmp_path / "a.dng", np.array([[0, 70000], [0, 0]]))

"""Maps of radially symmetric lobes in single precision, against the plain transforms and against sums over pixels."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import latlong_directions, latlong_solid_angles
from invrender.prefilter.symmetric import symmetric_map
from invrender.theory.convolution import filtered
from invrender.theory.specialcases import phong_transfer
from recon.harmonics.latlong import project_latlong, synthesise_latlong


@pytest.mark.parametrize(
    ("rows", "height", "l_max", "channels"), [(128, 128, 8, 3), (41, 17, 8, 1), (9, 64, 0, 2)]
)
def test_products_find_what_plain_transforms_find(
    rows: int, height: int, l_max: int, channels: int, rng
) -> None:
    # Lamps a thousand times as bright as the rest, as in real light.
    light = rng.lognormal(sigma=2, size=(rows, 2 * rows, channels)).astype(np.float32)
    transfer = rng.normal(size=l_max + 1)
    plain = synthesise_latlong(filtered(project_latlong(light, l_max), transfer).real, height)
    found = symmetric_map(light, transfer, height)
    assert found.dtype == np.float32
    assert_allclose(found.transpose(1, 2, 0), plain, atol=2e-6 * np.abs(plain).max())


def test_phongs_lobe_is_the_sum_over_pixels(rng) -> None:
    rows, s = 48, 12.0
    light = rng.uniform(size=(6, 12, 3)).repeat(8, axis=0).repeat(8, axis=1)
    found = symmetric_map(light, phong_transfer(s, 23), rows)
    directions = latlong_directions(rows).reshape(-1, 3)
    lobe = (s + 1) / (2 * np.pi) * np.clip(directions[::37] @ directions.T, 0, 1) ** s
    weights = np.broadcast_to(latlong_solid_angles(rows), (rows, 2 * rows)).reshape(-1, 1)
    # Degrees above 23 hold 1e-5 of the lobe's energy; of the sum over pixels there is more.
    assert_allclose(found.reshape(3, -1).T[::37], lobe @ (weights * light.reshape(-1, 3)), rtol=3e-3)


def test_even_light_stays_as_it_is() -> None:
    # To second order in the pixel.
    assert_allclose(symmetric_map(np.full((96, 192, 3), 0.7), phong_transfer(5, 3), 10), 0.7, rtol=1e-3)


def test_what_is_wrong_is_named() -> None:
    light, transfer = np.ones((8, 16, 3)), np.ones(4)
    light[3, 4, 1] = np.nan
    with pytest.raises(ValueError, match="lat-long grid: 1 of 384 values are not finite"):
        symmetric_map(light, transfer, 8)
    with pytest.raises(ValueError, match="transfer: 1 of 4 values"):
        symmetric_map(np.ones((8, 16, 3)), [1, np.inf, 1, 1], 8)
    with pytest.raises(ValueError, match="overflow single precision"):
        symmetric_map(np.full((8, 16, 3), 3e38), 10 * transfer, 8)
    with pytest.raises(ValueError, match=r"\(H, 2H, channels\), not \(8, 15, 3\)"):
        symmetric_map(np.ones((8, 15, 3)), transfer, 8)
    with pytest.raises(ValueError, match=r"transfer is \(2, 2\)"):
        symmetric_map(np.ones((8, 16, 3)), np.ones((2, 2)), 8)
    with pytest.raises(ValueError, match=r"l_max is 4; a lat-long grid of 8 rows carries degrees up to 3"):
        symmetric_map(np.ones((16, 32, 3)), np.ones(5), 8)

"""Primaries against published matrices from linear sRGB."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.primaries import PRIMARIES, adaptation

# ITU-R BT.2087 for Rec. 2020; Display P3 and ACEScg (Bradford) as ColorSync and the ACES specification have them.
PUBLISHED = {
    "rec2020": [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]],
    "p3": [[0.8225, 0.1774, 0.0], [0.0332, 0.9669, 0.0], [0.0171, 0.0724, 0.9105]],
    "acescg": [[0.6131, 0.3395, 0.0474], [0.0702, 0.9164, 0.0134], [0.0206, 0.1096, 0.8698]],
    "srgb": np.eye(3),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_matrices_are_the_published_ones(name: str) -> None:
    # They are published to four digits.
    assert_allclose(PRIMARIES[name].of_srgb, PUBLISHED[name], atol=1.5e-4)


def test_white_stays_white_and_adaptation_has_a_way_back() -> None:
    for primaries in PRIMARIES.values():
        assert_allclose(primaries.of_srgb.sum(axis=1), 1, atol=1e-12)
    d50, d65 = np.array([0.9642, 1.0, 0.8251]), np.array([0.9505, 1.0, 1.0888])
    assert_allclose(adaptation(d50, d65) @ d50, d65, atol=1e-12)
    assert_allclose(adaptation(d65, d50) @ adaptation(d50, d65), np.eye(3), atol=1e-12)

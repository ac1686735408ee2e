"""Tables over half and difference angles: their coordinates, MERL's file format, and what interpolation costs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from synthetic.materials.facets import BeckmannSlopes
from synthetic.materials.smith import SmithMaterial
from synthetic.materials.tabulated import (
    RusinkiewiczAngles,
    Tabulated,
    bin_centres,
    directions,
    half_angles,
    of_merl,
)

ZERO, ONE = np.zeros(3), np.ones(3)


def hemisphere(rng: np.random.Generator, count: int) -> np.ndarray:
    w = rng.normal(size=(count, 3))
    w[:, 2] = np.abs(w[:, 2])
    return w / np.linalg.norm(w, axis=1, keepdims=True)


def rotation(axis: int, angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.eye(3)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turn[a, a] = turn[b, b] = cos
    turn[a, b], turn[b, a] = -sin, sin
    return turn


def test_coordinates_are_those_of_the_paper(rng: np.random.Generator) -> None:
    # Rusinkiewicz: turn by -phi_h about the normal, then by -theta_h about the bitangent; wi has become the difference.
    for wi, wo in zip(hemisphere(rng, 50), hemisphere(rng, 50), strict=True):
        half = (wi + wo) / np.linalg.norm(wi + wo)
        theta_h, phi_h = np.arccos(half[2]), np.arctan2(half[1], half[0])
        turned = rotation(1, -theta_h) @ rotation(2, -phi_h) @ wi
        expected = (theta_h, np.arccos(turned[2]), np.arctan2(turned[1], turned[0]) % np.pi)
        assert_allclose(half_angles(wi, wo), expected, rtol=1e-7)


def test_directions_have_their_coordinates(rng: np.random.Generator) -> None:
    angles = RusinkiewiczAngles(
        rng.uniform(0, 1.2, 100), rng.uniform(0, 1.5, 100), rng.uniform(0, np.pi, 100)
    )
    wi, wo = directions(angles)
    assert_allclose(np.linalg.norm([wi, wo], axis=-1), 1.0, rtol=1e-12)
    assert_allclose(half_angles(wi, wo), angles, atol=1e-9)
    assert_allclose(half_angles(wo, wi), angles, atol=1e-9)


def merl_bytes(table: np.ndarray) -> bytes:
    """A file of the format, value by value in the order that the database's own reader indexes."""
    n_h, n_d, n_p, _ = table.shape
    flat = np.empty(3 * n_h * n_d * n_p)
    for colour, scale in enumerate((1.0 / 1500, 1.15 / 1500, 1.66 / 1500)):
        for h in range(n_h):
            for d in range(n_d):
                start = n_p * (d + n_d * (h + n_h * colour))
                flat[start : start + n_p] = table[h, d, :, colour] / scale
    return np.array([n_h, n_d, n_p], "<i4").tobytes() + flat.astype("<f8").tobytes()


def test_a_known_material_survives_the_format_of_merl(tmp_path: Path, rng: np.random.Generator) -> None:
    known = SmithMaterial(ZERO, ONE, 1.5, BeckmannSlopes(0.15, 0.15))
    colour = np.array([0.3, 0.6, 0.9])
    wi, wo = directions(RusinkiewiczAngles(*np.broadcast_arrays(*bin_centres((90, 90, 45)))))
    table = (known.lobe(wi, wo) + 0.1) * colour
    table[(wi[..., 2] <= 0) | (wo[..., 2] <= 0)] = -1  # as the database marks what cannot be seen
    path = tmp_path / "known.binary"
    path.write_bytes(merl_bytes(table))
    material = of_merl(path)

    measured = (table > 0).all(axis=-1)
    assert_allclose(material.table[measured], table[measured], rtol=1e-6)  # float32
    assert (material.table[~measured] == 0).all()
    # At the centres of bins the values are the table's; float32 of the table, and rounding of the angles.
    centres = measured & (wi[..., 2] > 0.01) & (wo[..., 2] > 0.01)
    assert_allclose(material.lobe(wi[centres], wo[centres]), table[centres], rtol=1e-5, atol=1e-5)
    # Between them, linear interpolation: bins of 1 degree against a lobe of 8.6 degrees.
    wi, wo = hemisphere(rng, 5000), hemisphere(rng, 5000)
    # Pairs near the mirror direction, too.
    wi[2500:] = wo[2500:] * [-1, -1, 1] + 0.1 * rng.normal(size=(2500, 3))
    wi /= np.linalg.norm(wi, axis=1, keepdims=True)
    clear = np.minimum(wi[:, 2], wo[:, 2]) > 0.1  # further than a bin from the horizon
    wi, wo = wi[clear], wo[clear]
    expected = (known.lobe(wi, wo) + 0.1) * colour
    error = np.abs(material.lobe(wi, wo) / expected - 1)
    assert np.median(error) < 1e-3
    # Far out the bell falls by a factor e within two bins: their second difference, over 8.
    assert error.max() < 0.1


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"MERL", "known.binary: has 4 bytes"),
        (
            merl_bytes(np.ones((3, 3, 4, 3)))[:-8],
            r"names a table of 3 x 3 x 4 and has 868 bytes instead of 876",
        ),
        (np.array([-1, 90, 180], "<i4").tobytes(), "names a table of -1 x 90 x 180"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "known.binary"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=message):
        of_merl(path)


def test_impossible_tables_are_refused() -> None:
    with pytest.raises(ValueError, match=r"the shape \(2, 2, 3\)"):
        Tabulated(ZERO, ONE, np.ones((2, 2, 3)))
    table = np.ones((2, 2, 2, 3))
    table[1, 0, 1, 2] = -0.5
    with pytest.raises(ValueError, match=r"the table is -0\.5 at \(1, 0, 1, 2\)"):
        Tabulated(ZERO, ONE, table)


def test_a_black_table_still_has_samples(rng: np.random.Generator) -> None:
    black = Tabulated(ZERO, ONE, np.zeros((5, 5, 4, 3)))
    wo = hemisphere(rng, 20)
    wi = black.sample(wo, rng.uniform(size=(20, 2)))
    assert (black.density(wi, wo) > 0).all()
    assert (black.lobe(wi, wo) == 0).all()

"""Lattices: what they integrate exactly, how they are dealt out, and that shifting and folding leave no bias."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from synthetic.render.lattice import dealt, lattice, shifted

Floats = NDArray[np.float64]


@pytest.mark.parametrize("count", [2, 4, 8, 16, 64, 512, 4096])
def test_each_coordinate_is_cut_evenly_and_the_points_are_closed_under_addition(count: int) -> None:
    points = lattice(count)
    whole = np.round(points * count).astype(int)
    assert_array_equal(points * count, whole)
    for column in whole.T:
        assert_array_equal(np.sort(column), np.arange(count))
    codes = np.sort(whole @ [count, 1])
    for one in whole[:8]:
        assert_array_equal(np.sort((whole + one) % count @ [count, 1]), codes)


@pytest.mark.parametrize("count", [16, 64, 256, 1024, 4096])
def test_waves_slower_than_the_points_are_apart_integrate_to_zero(count: int) -> None:
    # The best lattices integrate all waves exactly of which the product of frequencies is below about N / 3
    # (Zaremba's index); here below N / 6.
    reach = count // 6
    first, second = np.meshgrid(np.arange(0, reach + 1), np.arange(-reach, reach + 1), indexing="ij")
    slow = np.maximum(first, 1) * np.maximum(np.abs(second), 1) < count / 6
    slow &= (first != 0) | (second != 0)
    waves = np.column_stack([first[slow], second[slow]])
    generator = round(float(lattice(count)[1, 1] * count))
    # Along the lattice's own steps, so that the phase is a whole number of 1 / N.
    assert ((waves @ [1, generator]) % count != 0).all()
    few = waves[:: max(1, len(waves) // 200)]
    assert_allclose(np.exp(2j * np.pi * lattice(count) @ few.T).mean(axis=0), 0, atol=1e-12)  # rounding


@pytest.mark.parametrize(("count", "hands"), [(512, 16), (64, 64), (128, 1), (256, 4)])
def test_hands_share_the_lattice_and_are_lattices_themselves(count: int, hands: int) -> None:
    parts = dealt(count, hands)
    assert parts.shape == (hands, count // hands, 2)
    together = np.round(parts.reshape(-1, 2) * count).astype(int) @ [count, 1]
    assert_array_equal(np.sort(together), np.sort(np.round(lattice(count) * count).astype(int) @ [count, 1]))
    # Moved back by its first point, every hand is the first hand, and that is closed under addition.
    moved = np.round((parts - parts[:, :1]) * count).astype(int) % count @ [count, 1]
    assert_array_equal(np.sort(moved, axis=1), np.tile(np.sort(moved[0]), (hands, 1)))
    first = np.round(parts[0] * count).astype(int)
    sums = (first + first[-1]) % count @ [count, 1]
    assert_array_equal(np.sort(sums), np.sort(moved[0]))


def test_shifted_points_stay_below_one_in_single_precision(rng: np.random.Generator) -> None:
    shifts = np.concatenate([rng.random((200, 2)), [[0, 0], [1 - 1e-17, 1 - 1e-12], [0.5, 1 - 2.0**-53]]])
    points = shifted(np.broadcast_to(lattice(64), (len(shifts), 64, 2)), shifts)
    assert points.dtype == np.float32
    assert points.min() >= 0
    assert points.max() < 1
    moved = (lattice(64) + shifts[:, None]) % 1
    # Single precision, around the circle that the second coordinate is.
    assert_allclose(points[..., 0], 1 - np.abs(2 * moved[..., 0] - 1), atol=3e-7)
    assert_allclose((points[..., 1] - moved[..., 1] + 0.5) % 1, 0.5, atol=3e-7)


def test_random_shifts_leave_no_bias_and_errors_fall_fast(rng: np.random.Generator) -> None:
    def smooth(u: Floats) -> Floats:
        """Integrates to (e - 1) I0(1): smooth, not periodic in u, periodic in v."""
        return np.exp(u[..., 0]) * np.exp(np.cos(2 * np.pi * u[..., 1] + 1))

    def edged(u: Floats) -> Floats:
        """A disk, which covers a quarter of the square."""
        return (np.hypot(u[..., 0] - 0.5, u[..., 1] - 0.5) < 0.5 / np.sqrt(np.pi)).astype(float)

    draws = 400
    for function, truth, steepness in ((smooth, (np.e - 1) * np.i0(1), 1.6), (edged, 0.25, 0.6)):
        errors = {}
        for count in (64, 1024):
            points = shifted(np.broadcast_to(lattice(count), (draws, count, 2)), rng.random((draws, 2)))
            found = function(points.astype(float)).mean(axis=1) - truth
            assert (
                abs(found.mean()) < 4 * found.std() / np.sqrt(draws) + 1e-7
            )  # four standard errors; float32
            errors[count] = np.sqrt((found**2).mean())
        # The documented rates, N^-2 and N^(-3/4), less some: a disk's scatter by a third from size to size.
        assert errors[1024] < errors[64] * 16**-steepness


@pytest.mark.parametrize("count", [0, 1, 3, 100])
def test_other_sizes_are_refused(count: int) -> None:
    with pytest.raises(ValueError, match=f"a lattice of {count} points: the number must be a power of two"):
        lattice(count)

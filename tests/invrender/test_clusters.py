"""What hangs together in residuals, told from what is noise."""

from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose

from invrender.solve.clusters import structured_rms, tile_of


def test_noise_has_no_structure_and_structure_is_measured(
    bench: SimpleNamespace, rng: np.random.Generator
) -> None:
    fields = [bench.sphere_field(angle, 600) for angle in (0.0, 60.0, 120.0)]
    # Brighter towards one side, and noisier by as much, as photographs are.
    deviation = [np.repeat(0.01 * (1.1 + field.sample_normals[:, :1]), 3, axis=1) for field in fields]
    noise = [[d * rng.standard_normal(d.shape) for d in deviation] for _ in range(40)]
    found = [structured_rms(fields, draw) for draw in noise]
    # Two standard deviations of chance are let pass: one in forty is beyond.
    assert np.count_nonzero(found) <= 4
    wave = [0.01 * np.sin(tile_of(field))[:, None] * np.ones(3) for field in fields]
    expected = float(np.sqrt(np.mean(np.concatenate(wave) ** 2)))
    with_wave = [structured_rms(fields, [w + n for w, n in zip(wave, draw, strict=True)]) for draw in noise]
    # The two standard deviations, of some hundred tiles, and tiles of one sample take away a little.
    assert_allclose(with_wave, expected, rtol=0.15)

"""What hangs together in residuals, told from what is noise."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose

from invrender.estimate.clusters import lobe_misfit, outstanding, structured_rms, tile_of


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
    # Some hundred tiles tell it to a few percent; tiles of one sample take away a little.
    assert_allclose(with_wave, expected, rtol=0.15)


def test_fewer_samples_show_no_less_structure(bench: SimpleNamespace, rng: np.random.Generator) -> None:
    whole = [bench.sphere_field(angle, 2400) for angle in (0.0, 60.0, 120.0)]
    found = []
    for every in (1, 2, 8):
        fields = [field.where(np.arange(len(field)) % every == 0) for field in whole]
        draws = [
            [0.01 * np.sin(tile_of(f))[:, None] + 0.01 * rng.standard_normal((len(f), 3)) for f in fields]
            for _ in range(20)
        ]
        found.append(float(np.mean([structured_rms(fields, draw) for draw in draws])))
    # What is left are tiles that have one sample of few, and which pixels of a tile they are.
    assert_allclose(found, found[0], rtol=0.1)


def test_what_highlights_leave_is_measured_and_noise_isnt(rng: np.random.Generator) -> None:
    across = rng.uniform(-0.4, 0.4, (4000, 2))

    def lobe(sigma: float) -> np.ndarray:
        return np.exp(-(across**2).sum(axis=1, keepdims=True) / sigma**2) / sigma**2 * np.ones(3)

    def misfit(true: np.ndarray, outliers: float = 0.0) -> float:
        predicted = lobe(0.1) + 0.5
        std = 0.02 * predicted
        noise = std * rng.standard_normal(std.shape)
        noise += 50 * std * (rng.random(std.shape) < outliers)
        return lobe_misfit(lobe(0.1), predicted, true + 0.5 + noise - predicted, np.ones_like(std), std**-2)

    clean = [misfit(lobe(0.1)) for _ in range(40)]
    # Two standard deviations of the median are let pass.
    assert np.count_nonzero(clean) <= 4
    assert max(clean) < 0.01
    # A lobe wider by a share is off by |2 u - 2| of it, u = (theta / sigma)^2 being spread as exp(-u): half of its
    # light by more than 1.27, where 2 sinh(1.27 / 2) / e = 1 / 2. The median of normal noise is 0.6745.
    expected = 0.05 * 1.27 / 0.6745
    assert_allclose(misfit(lobe(0.105)), expected, rtol=0.25)
    # Dust on a tenth of the samples counts for little.
    assert_allclose(misfit(lobe(0.105), outliers=0.1), expected, rtol=0.5)
    assert misfit(lobe(0.1), outliers=0.1) < 0.02
    assert lobe_misfit(*np.zeros((5, 5, 3))) == 0
    # What counts for nothing, and whose noise so isn't known, says nothing of highlights either.
    nothing, light = np.zeros((500, 3)), np.ones((500, 3))
    assert lobe_misfit(light, light, light, nothing, nothing) == 0


def test_small_highlights_stand_out_and_dust_does_not(
    bench: SimpleNamespace, rng: np.random.Generator
) -> None:
    field = bench.sphere_field(0.0, 4000)
    plain = np.repeat(1 + 0.5 * field.sample_normals[:, :1], 3, axis=1) * rng.normal(1, 0.02, (len(field), 3))
    assert not outstanding(replace(field, radiance=plain)).any()
    peak = field.sample_normals[len(field) // 2]
    within = field.sample_normals @ peak > np.cos(0.06)
    assert 4 <= np.count_nonzero(within) < 40
    dust = rng.random(len(field)) < 0.01
    shown = replace(field, radiance=np.where((within | dust)[:, None], 5 * plain, plain))
    found = outstanding(shown)
    # Pixels at the edge of a highlight may have mostly others for neighbours, and dust a grain beside it.
    assert np.mean(found[within]) > 0.6
    assert np.mean(found[dust & ~within]) < 0.1

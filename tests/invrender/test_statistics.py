"""Statistics add up, and hold all that least squares needs of the samples."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.estimate.search import LADDER, fit
from invrender.estimate.statistics import Statistics, by_lighting, photo_statistics
from invrender.transport.columns import PhotoColumns
from invrender.transport.predict import predict_columns
from recon.sampling.lightfield import LightField
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric


@pytest.fixture(scope="module")
def photos(bench):
    return bench.photograph(radiometric(RH01_MATERIALS["painted"]), [0.0, 60.0, 130.0], samples=80)


def random_weights(photo: PhotoColumns, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.5, 2.0, photo.radiance.shape)


def concatenated(photos: list[PhotoColumns]) -> PhotoColumns:
    fields_ = [photo.field for photo in photos]
    firsts = np.cumsum([0, *(len(field) for field in fields_)])
    joined = {
        name: np.concatenate([getattr(field, name) for field in fields_])
        for name in (entry.name for entry in fields(LightField))
        if getattr(fields_[0], name) is not None and name != "ray_sample"
    }
    rays = np.concatenate([field.ray_sample + first for field, first in zip(fields_, firsts, strict=False)])
    return replace(
        photos[0],
        columns=np.concatenate([photo.columns for photo in photos], axis=1),
        field=LightField(ray_sample=rays, **joined),
    )


def assert_same(one: Statistics, other: Statistics) -> None:
    for name in ("gram", "right", "energy"):
        mine, theirs = getattr(one, name), getattr(other, name)
        # Rounding of sums in another order.
        assert_allclose(mine, theirs, rtol=1e-10, atol=1e-12 * np.abs(theirs).max(), equal_nan=False)
    assert one.count == other.count


def test_statistics_are_the_plain_sums(photos, rng):
    for photo in photos:
        weights = random_weights(photo, rng)
        found = photo_statistics(photo, weights)
        columns = np.broadcast_to(photo.columns, (3, *photo.columns.shape[1:])).astype(float)
        gram = np.einsum("nc,cneq,cnfr->ceqfr", weights, columns, columns)
        right = np.einsum("nc,cneq,nc->ceq", weights, columns, photo.radiance)
        energy = (weights * photo.radiance**2).sum(axis=0)
        plain = Statistics(photo.lighting, photo.elements, gram, right, energy, photo.radiance.size)
        assert_same(found, plain)


def test_sum_over_photographs_is_the_statistics_of_all_samples(photos, rng):
    weights = [random_weights(photo, rng) for photo in photos]
    (total,) = by_lighting(photo_statistics(*pair) for pair in zip(photos, weights, strict=True))
    assert_same(total, photo_statistics(concatenated(photos), np.concatenate(weights)))
    assert total.count == 3 * sum(len(photo.field) for photo in photos)


def test_lightings_are_kept_apart_in_order_of_appearance(photos):
    named = [replace(photo, lighting=name) for photo, name in zip(photos, "bab", strict=True)]
    first, second = by_lighting(photo_statistics(photo, np.ones_like(photo.radiance)) for photo in named)
    assert (first.lighting, second.lighting) == ("b", "a")
    ones = [np.ones_like(photo.radiance) for photo in photos]
    assert_same(first, photo_statistics(photos[0], ones[0]) + photo_statistics(photos[2], ones[2]))
    assert_same(second, photo_statistics(photos[1], ones[1]))


def test_cost_of_a_fit_is_the_sum_of_squared_residuals(photos, bench, rng):
    # The search never sees a residual; its cost, from the statistics alone, must be what they sum to.
    noisy = bench.with_noise(photos, rng, relative=0.05)
    weights = [random_weights(photo, rng) for photo in noisy]
    statistics = by_lighting(photo_statistics(*pair) for pair in zip(noisy, weights, strict=True))
    for model in LADDER:
        estimate = fit(model, statistics)
        residuals = [
            photo.radiance - predict_columns(photo, estimate.brdf, estimate.strengths["light"])
            for photo in noisy
        ]
        cost = sum(float((w * r**2).sum()) for w, r in zip(weights, residuals, strict=True))
        # Differences of energies, 1e4 times the cost, and columns in float32.
        assert_allclose(estimate.cost, cost, rtol=1e-5)

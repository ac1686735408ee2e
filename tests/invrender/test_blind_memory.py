"""What a search in unknown light keeps of its samples."""

from __future__ import annotations

import tracemalloc
from dataclasses import fields, replace

import numpy as np
from numpy.testing import assert_allclose

from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.rows import rows_of
from invrender.estimate.unknown_light.start import NOTHING
from recon.sampling.lightfield import LightField

OF_RAYS = ("positions", "normals", "views", "reflected_visible", "sources_visible")


def with_rays(field: LightField, side: int) -> LightField:
    """The same samples, each ray as a square of so many times so many."""
    assert {entry.name for entry in fields(field)} > set(OF_RAYS)
    counts = np.bincount(field.ray_sample)
    grids = [np.arange(count).reshape(2 * (round(count**0.5),)) for count in counts]
    finer = [np.kron(grid, np.ones((side, side), int)).ravel() for grid in grids]
    which = np.concatenate(
        [first + own for first, own in zip(np.cumsum(counts) - counts, finer, strict=True)]
    )
    return replace(field, **{name: getattr(field, name)[which] for name in ("ray_sample", *OF_RAYS)})


def test_rows_take_no_more_memory_for_more_rays(bench) -> None:
    # A mesh's pixel has ten rays or more: rows of each took 3.4 GB for three views of a bunny.
    field, l_max = bench.sphere_field(40.0, samples=1500).thinned(1), 12
    state = replace(NOTHING, specular_share=np.full(3, 0.2), mu=1.6, sigma=0.1234)
    found, kept = [], []
    for side in (1, 4):
        fine = with_rays(field, side)
        tracemalloc.start()
        design = LightingDesign.of([fine], l_max)
        found.append(rows_of(design, state, l_max))
        kept.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    of_rays = sum(getattr(fine, name).nbytes for name in ("ray_sample", *OF_RAYS))
    # Single precision, and cubics between roughnesses 0.1 apart in the logarithm.
    assert_allclose(
        found[1].sky_specular, found[0].sky_specular, atol=1e-4 * np.abs(found[0].sky_specular).max()
    )
    assert kept[1] < kept[0] + 2 * of_rays

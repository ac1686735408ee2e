"""The known-light fit against the matrix products that it needs, in one run.

    python -m benchmarks.statistics [PHOTOGRAPHS]

The statistics pass beside a bare product of the same shapes, one step of the nonlinear search beside the pass, and the
whole fit to the information limit, coarse search to Gauss-Newton, beside it. They take turns; ratios of the medians
count, of processor time, so that other work on the machine doesn't.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from statistics import median

import numpy as np
from numpy.typing import NDArray

from capture.parallel import one_blas_thread
from invrender.brdf.fresnel import FresnelBasis
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import sigma_nodes
from invrender.estimate.models import bounds_of, coordinates, estimate_at
from invrender.estimate.newton import newton_steps
from invrender.estimate.search import LADDER, fit
from invrender.estimate.statistics import Subsets, by_lighting, weighted_statistics
from invrender.theory.specialcases import lobe
from invrender.transport.column_basis import whole_range
from invrender.transport.columns import PhotoColumns
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# 60 photographs of a thousand samples: what `process` takes by default.
_PHOTOS, _SAMPLES, _ROUNDS = 60, 1000, 9
_SIZE = 190


def main(count: int) -> None:
    """Print milliseconds and ratios."""
    with one_blas_thread():
        _table("sources", *_photographs(count, 1))
        _table("coloured map", *_photographs(count, 3))


def _table(light: str, photos: list[PhotoColumns], weights: list[Floats]) -> None:
    statistics = by_lighting(weighted_statistics(zip(photos, weights, strict=True)))
    model = LADDER[-1]
    best, subsets = fit(model, statistics), Subsets(statistics)
    seconds = _medians(
        {
            "product": lambda: _bare(photos, weights),
            "pass": lambda: by_lighting(weighted_statistics(zip(photos, weights, strict=True))),
            "cost": lambda: estimate_at(model, statistics, coordinates(best.model, best.brdf)),
            "step": lambda: newton_steps(
                model, subsets, coordinates(best.model, best.brdf)[None], *bounds_of(model)
            ),
            "fit": lambda: fit(model, statistics),
        }
    )
    print(f"{light}, {len(photos)} photographs, {len(photos) * _SAMPLES} samples, {_SIZE} columns")
    _line("statistics pass / bare product", seconds["pass"], seconds["product"], 2)
    _line("cost at one mu and sigma / pass", seconds["cost"], seconds["pass"], 0.01)
    _line("Gauss-Newton step / pass", seconds["step"], seconds["pass"], 0.01)
    _line("pass and whole fit / pass", seconds["pass"] + seconds["fit"], seconds["pass"], 3)


def _photographs(count: int, channels: int) -> tuple[list[PhotoColumns], list[Floats]]:
    """Columns as smooth in sigma and mu as real ones, radiance of a BRDF with 1% noise, and weights."""
    rng = np.random.default_rng(0)
    nodes, basis = sigma_nodes(), FresnelBasis()
    photos, weights = [], []
    for _ in range(count):
        cos, theta = rng.uniform(0.15, 1, _SAMPLES), rng.exponential(0.2, _SAMPLES)
        lobes = lobe(theta[:, None], nodes) / (4 * cos[:, None])
        specular = (basis.functions(cos)[:, :, None] * lobes[:, None]).reshape(_SAMPLES, -1)
        diffuse = rng.uniform(0.5, 3, (channels, _SAMPLES, 1))
        tint = rng.uniform(0.8, 1.2, (channels, 1, 1))
        columns = np.concatenate([diffuse, tint * specular], axis=2).astype(np.float32)
        lobe_weights = whole_range().weights(1.6, 0.12, RH01_FORM)
        radiance = columns @ np.concatenate([[0.2], 0.03 * lobe_weights]).astype(np.float32)
        clean = np.broadcast_to(radiance.T, (_SAMPLES, 3)).astype(float)
        deviation = 0.01 * clean + 1e-4
        noisy = clean + deviation * rng.standard_normal(clean.shape)
        photos.append(PhotoColumns("light", ("known",), columns[:, :, None], _field(noisy)))
        weights.append(deviation**-2)
    return photos, weights


def _field(radiance: Floats) -> LightField:
    count = len(radiance)
    index, vectors = np.arange(count), np.tile([0.0, 0.0, 1.0], (count, 1))
    seen, sources = np.ones(count, bool), np.zeros((count, 0), bool)
    return LightField(
        index, index, radiance, radiance, np.ones(count), index, vectors, vectors, vectors, seen, sources
    )


def _bare(photos: list[PhotoColumns], weights: list[Floats]) -> object:
    """Per photograph and channel the product of a matrix and its transpose, in double precision, ready made."""
    matrix = np.ones((_SAMPLES, _SIZE))
    return [matrix.T @ matrix for _ in photos for _ in range(weights[0].shape[1])]


def _medians(work: dict[str, Callable[[], object]]) -> dict[str, float]:
    times: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(_ROUNDS):
        for name, run in work.items():
            start = time.process_time()
            run()
            times[name].append(time.process_time() - start)
    return {name: median(values) for name, values in times.items()}


def _line(what: str, mine: float, theirs: float, goal: float) -> None:
    print(f"  {what:34} {1e3 * mine:9.2f}ms {1e3 * theirs:9.2f}ms  {mine / theirs:7.4f}  goal {goal}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else _PHOTOS)

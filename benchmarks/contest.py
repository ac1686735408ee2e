"""What methods are judged by: time, errors of the parameters, and error on photographs that they haven't seen."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.spherephotos import SpherePhotos
from capture.lighting import Lighting
from invrender.brdf.microfacet import Microfacet
from invrender.estimate import statistics as sums
from invrender.estimate.rh01 import published_brdf, published_factors
from invrender.estimate.solution import factorize
from invrender.estimate.unknown_light import ORDERS, factorize_blind, predict_blind
from invrender.transport.columns import PhotoColumns, all_columns
from invrender.transport.lobe_table import Transfer
from invrender.transport.predict import predict
from invrender.transport.transfer import light_elements
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# The share is the green channel's.
_GREEN = 1


@dataclass(frozen=True)
class Found:
    """A method's Ks share, mu and sigma, None where it has none, and how it predicts samples (n, 3)."""

    share: float
    mu: float | None
    sigma: float | None
    radiance: Callable[[LightField], Floats]


@dataclass(frozen=True)
class Outcome:
    """What a method found, and when.

    setting : samples or seconds allowed. seconds : from drawing samples on. errors : of Ks share, mu and sigma,
    absolute, None where the method has none. held_out : relative RMS on unseen photographs without noise.
    """

    method: str
    known_light: bool
    setting: str
    seconds: float
    errors: Mapping[str, float | None]
    held_out: float

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)


class Judge(Protocol):
    """What methods are judged by: true numbers, and photographs that no fit sees, without noise."""

    @property
    def truth(self) -> Mapping[str, float | None]: ...
    @property
    def held_out(self) -> tuple[LightField, ...]: ...


def judged(photos: Judge, method: str, known: bool, setting: str, run: Callable[[], Found]) -> Outcome:
    """Time a method, and compare what it finds with the truth."""
    begin = time.perf_counter()
    found = run()
    seconds = time.perf_counter() - begin
    values = {"Ks share": found.share, "mu": found.mu, "sigma": found.sigma}
    errors = {
        name: None if truth is None or values[name] is None else abs(float(values[name] or 0) - truth)
        for name, truth in photos.truth.items()
    }
    unseen = held_out_error(photos.held_out, [found.radiance(field) for field in photos.held_out])
    return Outcome(method, known, setting, seconds, errors, unseen)


def held_out_error(fields: Sequence[LightField], predictions: Sequence[Floats]) -> float:
    """Relative RMS of what is predicted, (n, 3) each, of samples without noise."""
    truth = np.concatenate([field.radiance for field in fields])
    off = np.concatenate(predictions) - truth
    return float(np.sqrt(np.mean(off**2) / np.mean(truth**2)))


def relative_error(outcome: Outcome, truths: Mapping[str, float | None]) -> float:
    """The largest relative error of Ks share, mu - 1 and sigma; 1 where the method lacks one."""
    worst = 0.0
    for name, truth in truths.items():
        if truth is not None:
            error = outcome.errors[name]
            worst = max(worst, 1.0 if error is None else error / (truth - 1 if name == "mu" else truth))
    return worst


def ours(photos: SpherePhotos, known: bool, samples: int | None) -> Found:
    """lightfactor: in known light the whole ladder, in unknown light RH01's model at order 10."""
    return statistics(photos, samples) if known else gauss_newton(photos, samples)


def statistics(photos: SpherePhotos, samples: int | None) -> Found:
    """Known light: sufficient statistics, then a simplex over them, with the ladder of models and error bars."""
    lighting = photos.stage.lighting
    elements = light_elements(lighting)
    fields = photos.samples(samples, lighting.directions)
    columns = all_columns([lighting.name] * len(fields), {lighting.name: elements}, fields)
    return brdf_in_known_light(factorize(columns, [lighting]).estimate.brdf, lighting)


def single_statistics(photos: SpherePhotos, samples: int | None) -> Found:
    """The same with sums of products in single precision, which columns are in anyway."""
    with patch.object(sums, "photo_statistics", _single_photo_statistics):
        return statistics(photos, samples)


def _single_photo_statistics(photo: PhotoColumns, weights: Floats) -> sums.Statistics:
    channels, count, elements, size = photo.columns.shape
    gram, right, energy = [], [], []
    for c in range(3):
        root = np.sqrt(weights[:, c, None]).astype(np.float32)
        columns = photo.columns[min(c, channels - 1)].reshape(count, -1)
        scaled = np.hstack([columns, photo.radiance[:, c, None].astype(np.float32)]) * root
        products = (scaled.T @ scaled).astype(float)
        gram.append(products[:-1, :-1].reshape(elements, size, elements, size))
        right.append(products[:-1, -1].reshape(elements, size))
        energy.append(products[-1, -1])
    found = map(np.array, (gram, right, energy))
    return sums.Statistics(photo.lighting, photo.elements, *found, 3 * count)


def published_known(photos: SpherePhotos, samples: int | None, transfer: Transfer) -> Found:
    """Known light: RH01's simplex over all pixels [RH01, section 6.1]."""
    lighting = photos.stage.lighting
    found = published_brdf(photos.samples(samples, lighting.directions), lighting, transfer)
    return brdf_in_known_light(found.brdf, lighting)


def brdf_in_known_light(brdf: Microfacet, lighting: Lighting) -> Found:
    """What a BRDF amounts to; photographs are predicted by the exact lobe, whatever it was found by."""
    elements = light_elements(lighting)
    strengths = np.ones((len(elements), 3))
    share = float(brdf.ks[_GREEN] / (brdf.kd[_GREEN] + brdf.ks[_GREEN]))
    return Found(share, brdf.mu, brdf.sigma, lambda field: predict(brdf, elements, strengths, field))


def gauss_newton(
    photos: SpherePhotos,
    samples: int | None,
    orders: Sequence[int] = (10,),
    transfer: Transfer = "exact",
    ladder: bool = False,
) -> Found:
    """Unknown light: variable projection."""
    solution = factorize_blind(photos.samples(samples), orders=orders, ladder=ladder, transfer=transfer)
    share = float(solution.brdf_share[_GREEN])
    return Found(share, solution.mu, solution.sigma, lambda field: predict_blind(solution, field))


def whole_ladder(photos: SpherePhotos, samples: int | None) -> Found:
    """Unknown light as `process` does it: every order of the light, and every model."""
    return gauss_newton(photos, samples, ORDERS, ladder=True)


def published_unknown(photos: SpherePhotos, samples: int | None) -> Found:
    """Unknown light: RH01's simplex and map in mirror directions [RH01, section 6.3]."""
    found = published_factors(photos.samples(samples))
    return Found(float(found.share[_GREEN]), found.mu, found.sigma, found.radiance)

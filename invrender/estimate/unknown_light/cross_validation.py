"""The ladder: models cross-validated over photographs, and the simplest that predicts as well as the best.

Fits that leave photographs out come from the joint normal equations by one Gauss-Newton step, which is exact for the
lighting and, a step away from the optimum, as good as exact for the rest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from capture import selection
from capture.parallel import parallel_map
from invrender.estimate.clusters import tile_of
from invrender.estimate.evidence import CLEARLY_WORSE, MAX_FOLDS, relative_rms
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import (
    Arrow,
    BlindFit,
    arrow_of,
    predicted,
    reduced,
    shared_rows,
)
from invrender.estimate.unknown_light.rows import LightingRows
from invrender.estimate.unknown_light.start import Search
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# From this many photographs of each lighting on they are left out whole; of fewer, tiles are, since the rest would not
# see the light.
_ENOUGH_PHOTOS = 8
_TILE_FOLDS = 10


@dataclass(frozen=True, eq=False)
class BlindCandidate:
    """A model of the ladder with its evidence.

    photo_errors : (photos,), relative RMS of each photograph as predicted by fits that have not seen it (with few
        photographs: that part of it). deviance : (groups,), mean squared error in units of the noise, of each
        photograph (with few photographs: of each set of tiles).
    """

    name: str
    fit: BlindFit
    photo_errors: Floats
    deviance: Floats

    @property
    def outcome(self) -> str:
        """What its trial found, in a few words."""
        return f"{self.name}: {self.error:.2%}"

    @property
    def parameters(self) -> int:
        return self.fit.parameters

    @property
    def error(self) -> float:
        """Mean over photographs of the cross-validated relative RMS."""
        return float(self.photo_errors.mean())


def simplest(candidates: Sequence[BlindCandidate]) -> int:
    """The index of the candidate with fewest parameters whose error is within one standard error of the best one's.

    One whose lobe has numbers of its own is only taken where it is needed (`needed`), or where all have.
    """
    plain = [candidate for candidate in candidates if not candidate.fit.state.form.numbers]
    richer = [candidate for candidate in candidates if candidate.fit.state.form.numbers]
    if not plain:
        plain, richer = richer, []
    place = selection.simplest([own.deviance for own in plain], [own.parameters for own in plain])
    return list(candidates).index(needed(plain[place], richer))


def needed(simple: BlindCandidate, richer: Iterable[BlindCandidate]) -> BlindCandidate:
    """The simple candidate, or of those whose lobes have more numbers the one that photographs speak clearly for.

    Of several, one is a little better by chance. It must be better by one standard error of its own mean, and by three
    of the paired difference.
    """
    for candidate in sorted(richer, key=lambda candidate: candidate.parameters):
        if not (
            as_good(simple, candidate, CLEARLY_WORSE)
            or selection.as_good(simple.deviance, candidate.deviance, paired=False)
        ):
            simple = candidate
    return simple


def as_good(candidate: BlindCandidate, best: BlindCandidate, errors: float = 1.0) -> bool:
    """Whether a candidate's error is within one standard error of another's, or so many, paired by group."""
    return selection.as_good(candidate.deviance, best.deviance, errors)


def cross_validate(name: str, search: Search, fit: BlindFit) -> BlindCandidate:
    """The evidence for a fitted model."""
    joint = joint_equations(search, fit)
    free = ~fit.state.stuck(reduced(joint.whole).right)
    steps = {}
    for fold, parts in joint.folds.items():
        rest = reduced({k: arrow - parts[k] if k in parts else arrow for k, arrow in joint.whole.items()})
        step = rest.step(free)
        light_steps = {k: rest.alone[k] - np.einsum("cpt,t->cp", rest.leverage[k], step) for k in joint.whole}
        steps[fold] = (light_steps, step)

    def foretold(item: tuple[LightingDesign, LightingRows, Floats, Ints]) -> Floats:
        design, rows, shared, of = item
        residual = design.radiance - predicted(design, fit, rows)
        for fold in np.unique(of):
            chosen, (light_steps, step) = of == fold, steps[int(fold)]
            change = rows.where(chosen).radiance(fit.state.specular_share, light_steps[design.lighting].T)
            residual[chosen] -= change + (shared[:, chosen] @ step).T
        return residual

    by_design = zip(search.designs, fit.rows, joint.shared, joint.fold_of, strict=True)
    residuals = list(parallel_map(foretold, by_design))
    errors = [
        relative_rms(*of_photo)
        for residual, design, trust in zip(residuals, search.designs, search.trust, strict=True)
        for of_photo in zip(*map(design.split, (residual, design.field.radiance, trust)), strict=True)
    ]
    squares = [weight * residual**2 for weight, residual in zip(search.weights, residuals, strict=True)]
    if left_out_whole(search.designs):
        by_photo = zip(search.designs, squares, strict=True)
        deviance = [square.mean() for design, of in by_photo for square in design.split(of)]
    else:
        deviance = [
            np.concatenate([s[of == fold] for s, of in zip(squares, joint.fold_of, strict=True)]).mean()
            for fold in joint.folds
        ]
    return BlindCandidate(name, fit, np.array(errors), np.array(deviance))


@dataclass(frozen=True, eq=False)
class Joint:
    """Joint normal equations at a fit by lighting: of all samples with the prior, and of each fold.

    fold_of : (n,) per design. shared : (3, n, t) per design, Jacobian over the shared parameters.
    """

    whole: dict[int, Arrow]
    folds: dict[int, dict[int, Arrow]]
    fold_of: tuple[Ints, ...]
    shared: tuple[Floats, ...]


def joint_equations(search: Search, fit: BlindFit) -> Joint:
    """Equations at a fit, fold by fold."""
    fold_of = _folds(search.designs)

    def of_design(item: tuple[LightingDesign, Floats, LightingRows, Ints]) -> tuple[dict[int, Arrow], Floats]:
        design, weight, rows, fold = item
        lit, shared = rows.of_channels(fit.state.specular_share), shared_rows(design, fit, rows)
        residual = design.radiance - predicted(design, fit, rows)
        arrows = {
            int(k): arrow_of(lit[:, fold == k], shared[:, fold == k], weight[fold == k], residual[fold == k])
            for k in np.unique(fold)
        }
        return arrows, shared

    folds: dict[int, dict[int, Arrow]] = {}
    sums: dict[int, Arrow] = {}
    found = parallel_map(of_design, zip(search.designs, search.weights, fit.rows, fold_of, strict=True))
    by_design, slopes = zip(*found, strict=True)
    for design, parts in zip(search.designs, by_design, strict=True):
        for fold, part in parts.items():
            _add(folds.setdefault(fold, {}), design.lighting, part)
            _add(sums, design.lighting, part)
    # The light is at its optimum, prior included: there its equations have nothing left to say.
    whole = {
        k: replace(arrow, gram=fit.grams[k], right=np.zeros_like(arrow.right)) for k, arrow in sums.items()
    }
    return Joint(whole, folds, fold_of, slopes)


def _add(arrows: dict[int, Arrow], lighting: int, part: Arrow) -> None:
    arrows[lighting] = arrows[lighting] + part if lighting in arrows else part


def left_out_whole(designs: Sequence[LightingDesign]) -> bool:
    """Whether photographs are left out whole: each lighting has enough of them."""
    return min(photo_counts(designs).values()) >= _ENOUGH_PHOTOS


def photo_counts(designs: Sequence[LightingDesign]) -> Counter[int]:
    """How many photographs were taken under each lighting, by its number."""
    return Counter(design.lighting for design in designs for _ in design.photos)


def _folds(designs: Sequence[LightingDesign]) -> tuple[Ints, ...]:
    if left_out_whole(designs):
        # Numbered within each lighting, so that no fold takes all that shows one of them.
        seen: Counter[int] = Counter()
        folds = []
        for design in designs:
            numbers = seen[design.lighting] + np.arange(len(design.photos))
            folds.append(np.repeat(numbers % MAX_FOLDS, [len(photo) for photo in design.photos]))
            seen[design.lighting] += len(design.photos)
        return tuple(folds)
    number = count()
    return tuple(
        np.concatenate([(_tiles(photo) + 3 * next(number)) % _TILE_FOLDS for photo in design.photos])
        for design in designs
    )


def _tiles(photo: LightField) -> Ints:
    return np.unique(tile_of(photo), return_inverse=True)[1]

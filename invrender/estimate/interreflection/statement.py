"""How much light bounces between an object's parts, how much of it photographs ask for, and what was done about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.estimate.evidence import Candidate, relative_rms
from invrender.estimate.unknown_light.cross_validation import BlindCandidate

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Candidates = TypeVar("Candidates", Candidate, BlindCandidate)

_LABELS = {"Kd": "kd", "Ks": "ks", "mu": "mu", "sigma": "sigma"}
# How many times the prediction there may be, before photographs were asked: 1, give or take this.
_BEFOREHAND = 0.2
# Share of the samples whose part of bounced light is smaller than what is called the highest.
_HIGHEST = 0.99


@dataclass(frozen=True, eq=False)
class Interreflection:
    """What bounced light amounts to, and what was done about it.

    relative, highest : its RMS over that of the radiance, and its largest share of a sample's but for one percent of
    them. taken_off : whether the result is without it. asked, asked_std : how many times the prediction the photographs
    ask for. error_with, error_without : relative RMS on unseen photographs with it taken off, and not.
    without : the BRDF that the same model has where it isn't taken off. corrected : that where it is. albedo : (3,), in
    unknown light, of which it would be so much; None where the fit determines the albedo.
    """

    relative: float
    highest: float
    taken_off: bool
    asked: float
    asked_std: float
    error_with: float
    error_without: float
    without: Microfacet
    corrected: Microfacet
    albedo: Floats | None = None

    @property
    def doubt(self) -> float:
        """Standard deviation of what was taken off, or wasn't though it may be there, as a share of the prediction.

        Of what was taken off the photographs' answer is weighed against what is known beforehand.
        """
        if not self.taken_off:
            return float(np.hypot(self.asked, self.asked_std))
        precision = 1 / max(self.asked_std, 1e-6) ** 2
        variance = 1 / (1 / _BEFOREHAND**2 + precision)
        return float(np.hypot(variance * precision * (self.asked - 1), np.sqrt(variance)))

    def moved(self, name: str) -> Floats:
        """By what share of itself taking it off changes a number of the BRDF, (3,) or (1,); NaN if there was none."""
        before, after = (
            np.atleast_1d(np.asarray(np.nan if getattr(brdf, name) is None else getattr(brdf, name), float))
            for brdf in (self.without, self.corrected)
        )
        if name in ("mu", "sigma") and not self.without.ks.any():
            before = np.full(1, np.nan)
        return np.asarray(after / np.where(before > 0, before, np.nan) - 1)

    def __str__(self) -> str:
        """The sentences that users read."""
        size = (
            f"Light that bounces between the object's parts should be {self.relative:.1%} of the radiance (RMS), up to"
            f" {self.highest:.0%} in its folds"
        )
        if self.albedo is not None:
            size += f", at an albedo of {', '.join(f'{each:.2f}' for each in self.albedo)}"
            size += ", the one that explains most" if self.taken_off else ""
        asked = f"{self.asked:.2f} ± {self.asked_std:.2f} times as much"
        errors = f"{self.error_with:.2%} with it taken off, {self.error_without:.2%} as they are"
        if not self.taken_off:
            return (
                f"{size}, but the photographs ask for {asked} (error on unseen photographs: {errors}), so none was"
                " taken off."
            )
        changes = [
            f"{label} {text}" for label, name in _LABELS.items() if (text := self._change(name)) is not None
        ]
        return (
            f"{size}. It was taken off: {', '.join(changes)}. The photographs ask for {asked}; error on unseen"
            f" photographs: {errors}."
        )

    def _change(self, name: str) -> str | None:
        """How much a number changed, in words; None if the model has none, or it is zero before and after."""
        moved = self.moved(name)
        if not np.isnan(moved).any():
            return f"{moved.mean():+.1%}"
        return "from nothing" if name == "ks" and self.corrected.ks.any() else None


def stated(
    shown: Sequence[Floats],
    less: Sequence[Floats],
    asked: tuple[float, float],
    errors: tuple[float, float],
    brdfs: tuple[Microfacet, Microfacet],
    albedo: Floats | None = None,
) -> Interreflection:
    """What photographs say of bounced light; it is taken off if unseen ones are then predicted better.

    shown, less : (n, 3) each, radiance as photographed, and what bounces of it. asked : as of `asked_for`. errors,
    brdfs : without it taken off, and with.
    """
    shares = [
        np.minimum(off.mean(axis=1) / np.maximum(whole.mean(axis=1), 1e-300), 1)
        for off, whole in zip(less, shown, strict=True)
    ]
    return Interreflection(
        relative=rms(less) / rms(shown),
        highest=float(np.quantile(np.concatenate(shares), _HIGHEST)),
        taken_off=errors[1] < errors[0],
        asked=asked[0],
        asked_std=asked[1],
        error_with=errors[1],
        error_without=errors[0],
        without=brdfs[0],
        corrected=brdfs[1],
        albedo=albedo,
    )


def asked_for(
    tiles: Sequence[Ints],
    weights: Sequence[Floats],
    without: Sequence[Floats],
    taken_off: Sequence[Floats],
) -> tuple[float, float]:
    """How many times the bounced light the photographs ask for, and its standard deviation, from residuals (n, 3).

    With s times the bounced light taken off and all else fitted, residuals are r(s) = r(0) + s (r(1) - r(0)); least
    squares give s. Errors may be correlated within tiles (n,) of a photograph. They are those that are left at the
    answer: where nothing bounces, what taking it off would leave is no error of the photographs.
    """
    changes = [r0 - r1 for r0, r1 in zip(without, taken_off, strict=True)]
    slope = max(sum(_product(*each) for each in zip(weights, changes, changes, strict=True)), 1e-300)
    asked = sum(_product(*each) for each in zip(weights, changes, without, strict=True)) / slope
    scores = [
        np.bincount(tile, (weight * change * (r0 - asked * change)).sum(axis=1))
        for tile, weight, change, r0 in zip(tiles, weights, changes, without, strict=True)
    ]
    return asked, float(np.linalg.norm(np.concatenate(scores))) / slope


def of_all(
    candidates: Sequence[Candidates], shown: Sequence[Floats], trust: Sequence[Floats], less: Sequence[Floats]
) -> tuple[Candidates, ...]:
    """Candidates fitted to what is left of photographs, with errors relative to all that they show.

    shown, trust, less : (n, 3) of each photograph, less what was taken off.
    """
    left = [relative_rms(whole - off, whole, own) for whole, own, off in zip(shown, trust, less, strict=True)]
    return tuple(replace(one, photo_errors=np.array(left) * one.photo_errors) for one in candidates)


def rms(values: Sequence[Floats]) -> float:
    """Root mean square of all arrays' numbers together."""
    return float(np.sqrt(np.mean(np.concatenate(values) ** 2)))


def _product(weight: Floats, one: Floats, other: Floats) -> float:
    return float((weight * one * other).sum())

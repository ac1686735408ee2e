"""The scale that references fix: as much light falls on them as makes them show what they reflect.

Photographs in unknown light show products of reflectance and light. A diffuse reference of reflectance rho sends
rho E / pi where E falls on it [RH01, eq. 15]. Where a fit in a scale of its own says E', Kd and Ks are E' / E times
what it says, and light is E / E' times.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.quantities import ReferenceScore
from recon.reference import Reference

Floats = NDArray[np.float64]
# Irradiance (n, 3) of a reference's pixels, if their normals (n, 3) were these.
Falls = Callable[[Reference, Floats], Floats]

# Turn of a normal, radians, that shows what its deviation does.
_TURN = 1e-3
# Of a reference's pixels, whose neighbours share photosites, as if so many were independent.
_INDEPENDENT = 0.25
# Share by which none is known better.
_EXACT = 1e-6
# References that are further apart than so many deviations are named.
_APART = 3.0
# Least irradiance of a reference, over what its photograph's light sends head-on, in which its angle can be trusted.
_GRAZING = 0.05


@dataclass(frozen=True, eq=False)
class ReferenceScale:
    """What references say of a scale, and how far off they may be by themselves.

    references : some. factors : (r, 3), of Kd and Ks by each. stds : of each, by what leaves these open, shares (3,).
    weights : (r,), of the factors' logarithms in the mean; they add up to 1. own_std : (3,), the mean's share, which
    holds by what they differ. remarks : sentences.
    """

    references: tuple[Reference, ...]
    factors: Floats
    stds: tuple[Mapping[str, Floats], ...]
    weights: Floats
    own_std: Floats
    remarks: tuple[str, ...]

    @staticmethod
    def of(references: Sequence[Reference], falls: Falls) -> ReferenceScale:
        """What references say; falls : the light on them, by a fit in its own scale.

        Raises ValueError where next to none falls on one.
        """
        stds, logs = [], []
        for reference in references:
            fallen = reference.mean(falls(reference, reference.normals))
            _check_lit(reference, fallen, falls)
            stds.append(_deviations(reference, fallen, falls))
            logs.append(np.log(reference.over_shown(fallen)))
        # What is exact in each way has a weight still.
        variance = np.array([_EXACT**2 + sum(own**2 for own in of.values()) for of in stds])
        log = np.array(logs)
        weights = 1 / variance.mean(axis=1)
        weights /= weights.sum()
        own = (weights[:, None] ** 2 * variance).sum(axis=0)
        mean = weights @ log
        apart = (log - mean) ** 2 / variance
        if len(references) > 1:
            own = own * np.maximum(1, apart.sum(axis=0) / (len(references) - 1))
        far = apart.max(axis=1)
        remarks = []
        if len(references) > 1 and far.max() > _APART**2:
            k = int(far.argmax())
            remarks.append(
                f"The references differ: by {references[k].name} Kd would be {np.exp(log[k] - mean).mean() - 1:+.0%},"
                f" {np.sqrt(far[k]):.0f} deviations from the mean of all. See which of them is shaded, glints, or"
                " reflects something else than is given."
            )
        return ReferenceScale(
            tuple(references), np.exp(log), tuple(stds), weights, np.sqrt(own), tuple(remarks)
        )

    @property
    def factor(self) -> Floats:
        """Kd and Ks over those of the fit, (3,)."""
        return self.mean_of(self.factors)

    def mean_of(self, factors: Floats) -> Floats:
        """The factor (3,) where the references give these, (r, 3)."""
        return np.asarray(np.exp(self.weights @ np.log(np.maximum(factors, 1e-300))))

    def scores(self, factor: Floats) -> tuple[ReferenceScore, ...]:
        """How well each reference is explained where Kd and Ks are factors (3,) times those of the fit."""
        return tuple(
            ReferenceScore(
                reference.name, reference.photo, reference.lighting, float(weight), of, own / factor
            )
            for reference, weight, of, own in zip(
                self.references, self.weights, self.stds, self.factors, strict=True
            )
        )

    @property
    def in_words(self) -> str:
        """The gauge that they fix."""
        return (
            f"absolute: {self.named} of known reflectance fixes the scale of Kd, Ks and light in each channel"
        )

    @property
    def named(self) -> str:
        """The references: by name, or how many."""
        names = list(dict.fromkeys(reference.name for reference in self.references))
        return names[0] if len(names) == 1 else f"the mean of {len(self.references)} references"


@dataclass(frozen=True, eq=False)
class ReferenceGauge:
    """A scale that hangs on strengths of lightings.

    reached : of each reference its factor, (3,), per unit of strengths by their names.
    """

    scale: ReferenceScale
    reached: tuple[Mapping[str, Floats], ...]

    def factor(self, strengths: Mapping[str, Floats]) -> Floats:
        """Kd and Ks over those of a fit with strengths (3,) by their names; (3,)."""
        factors = [sum(own * strengths[name] for name, own in of.items()) for of in self.reached]
        return self.scale.mean_of(np.array(factors))


def check_under(references: Sequence[Reference], lights: Mapping[str, object]) -> None:
    """ValueError where a reference is under a light that no fitted photograph is under."""
    for reference in references:
        if reference.lighting not in lights:
            raise ValueError(
                f"{reference.where}: its light {reference.lighting!r} is on no photograph that is fitted, so nothing"
                " relates it to the others: show the reference in a photograph under one of"
                f" {', '.join(map(repr, lights))}"
            )


def places_of(reference: Reference, sources: Floats) -> Floats:
    """Where a reference's pixels are, (n, 3) metres, as far as sources, (k, 3) or (k, 4), ask for it.

    ValueError where nothing says, and lamps are near.
    """
    if reference.positions is not None:
        return reference.positions
    if sources.shape[1] == 4 and sources[:, 3].any():
        raise ValueError(
            f"{reference.where}: the lamps are near, so that light falls off across the scene: give the reference's"
            " position, metres in the world, or the size of a card whose four corners region names"
        )
    return np.zeros_like(reference.normals)


def _check_lit(reference: Reference, fallen: Floats, falls: Falls) -> None:
    facing = np.eye(3)
    brightest = np.max(
        [
            reference.mean(falls(reference, np.tile(way, (len(reference.normals), 1))))
            for way in (*facing, *-facing)
        ],
        axis=0,
    )
    if (fallen <= _GRAZING * brightest).any():
        raise ValueError(
            f"{reference.where}: next to no light falls on it the way that it faces,"
            f" {np.round(reference.normals.mean(axis=0), 2).tolist()}: check its normal and its frame, the world's"
        )


def _deviations(reference: Reference, fallen: Floats, falls: Falls) -> dict[str, Floats]:
    """Shares (3,) of what the reference itself leaves open, by what does."""
    tilt = np.zeros(3)
    if reference.normal_std:
        normal = reference.normals[0]
        across = np.linalg.svd(normal[None])[2][1:]
        for way in across:
            turned = normal + _TURN * way
            turned = np.tile(turned / np.linalg.norm(turned), (len(reference.normals), 1))
            slope = (reference.mean(falls(reference, turned)) / fallen - 1) / _TURN
            tilt += (reference.normal_std * slope) ** 2
    shown = reference.white / reference.mean(reference.white)
    return {
        "reflectance": np.full(3, reference.reflectance_std),
        "tilt": np.sqrt(tilt),
        "evenness": _unevenness(shown - falls(reference, reference.normals) / fallen, reference.parts),
    }


def _unevenness(off: Floats, parts: NDArray[np.int64]) -> Floats:
    """Share (3,) by which a reference is lit otherwise than the fit says, as its pixels (n, 3) show; parts : (n,).

    What varies from part to part beyond noise varies between it and the object, too. Of noise the mean has less.
    """
    own = [off[parts == part] for part in np.unique(parts)]
    noise = np.mean([pixels.var(axis=0) / (len(pixels) * _INDEPENDENT) for pixels in own], axis=0)
    if len(own) == 1:
        return np.sqrt(noise)
    between = np.var([pixels.mean(axis=0) for pixels in own], axis=0, ddof=1)
    return np.asarray(np.sqrt(np.maximum(between - noise, 0) + noise / len(own)))

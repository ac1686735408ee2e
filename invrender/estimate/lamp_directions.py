"""Directions of lamps, found anew from where highlights lie, where measured ones leave much unexplained.

By turns each source goes where its photographs see it, and the BRDF follows. Sources of lightings that no photograph
was fitted under follow a linear map of directions, if it explains how the others turned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.selection import plausibility
from invrender.brdf.form import LobeForm
from invrender.estimate.evidence import of_rival, relative_rms
from invrender.estimate.explanation import Explanation
from invrender.estimate.models import Estimate
from invrender.estimate.noise import Weights
from invrender.estimate.pulled_sources import pulled_sources
from invrender.estimate.search import fit
from invrender.estimate.statistics import total_statistics
from invrender.estimate.weighing import lobe_reach, some_samples
from invrender.transport.columns import PhotoColumns, columns_under
from invrender.transport.predict import predict_photos
from invrender.transport.transfer import light_elements
from recon.mesh.tangents import tangents

Floats = NDArray[np.float64]

# Standard deviation of a measured direction of which none is stated, radians either way across: a degree.
_UNSTATED = np.radians(1.0)
# Samples that directions are sought on, of all photographs.
_SAMPLES = 15000
# Turns and fits by turns, and the share of the error that the first must take away for more: it gets nearly all.
_ROUNDS, _HOPEFUL = 3, 0.99
# Of a lobe's width, the largest turn of a round.
_MOST_OF_WIDTH = 1.0
# Of the error that is left with sources as given, what sources put elsewhere may leave at most to be believed.
FEWER = 0.98
# Turns (RMS, radians) that are worth a solve, and that are no chance: squares over variances, less 1, in deviations.
_NOTABLE, _NO_CHANCE = np.radians(0.05), 3.0
# Sources that tell of a map at least, and of their turns the share that it may leave of each left out (RMS).
_FEWEST, _EXPLAINED = 6, 0.7
# Times that a map and the scatter about it are found by turns.
_MAP_STEPS = 3


@dataclass(frozen=True, eq=False)
class FoundDirections:
    """Lightings whose sources were turned to where photographs see them.

    lightings : all of a set's, by name. names : of those that were fitted. covariance : (2 m, 2 m) of turns, radians,
    of the m sources of these, one lighting after the other, about `tangents` of their directions. apart : (2 m,), the
    part of it by which another form of the lobe puts sources elsewhere, one standard deviation.
    """

    lightings: Mapping[str, Lighting]
    names: tuple[str, ...]
    covariance: Floats
    apart: Floats


def find_directions(lightings: Mapping[str, Lighting], known: Explanation) -> FoundDirections | None:
    """Each source in the direction that suits photographs best, as far as its standard deviation allows.

    known : the photographs explained under the lightings as they are given. None where nothing is glossy, where turns
    may be chance, or where the error of all photographs falls by less than 2%. Another form of the lobe may explain the
    photographs as well with sources elsewhere: the best other one is given directions of its own. The better ones are
    taken, and the covariance holds by how much they differ.
    """
    given = _with_sources(lightings, known)
    if known.best.estimate.brdf.sigma is None or not given:
        return None
    known = _on_some(known)
    sighted = _Sighted.of(given, lightings, known)
    first = sighted.error
    for done in range(_ROUNDS):
        sighted = sighted.turned(given, known)
        if sighted.error > (FEWER if done else _HOPEFUL) * first:
            return None
    turns = _turns_between(given, lightings, sighted.lightings)
    beyond = (sighted.surprise - 1) * np.sqrt(len(turns) / 2)
    if np.sqrt(2 * (turns**2).mean()) < _NOTABLE or beyond < _NO_CHANCE:
        return None
    rival = _Sighted.of_rival(given, sighted.lightings, known)
    if rival is None:
        return sighted.found(lightings, given, np.zeros(len(turns)))
    for _ in range(_ROUNDS):
        rival = rival.turned(given, known)
    best, other = (sighted, rival) if sighted.error <= rival.error else (rival, sighted)
    weight = plausibility(other.photo_errors**2, best.photo_errors**2)
    return best.found(
        lightings, given, of_rival(weight) * _turns_between(given, best.lightings, other.lightings)
    )


def improve_directions(
    lightings: Mapping[str, Lighting], found: FoundDirections, known: Explanation
) -> FoundDirections | None:
    """Found directions once more, by the lobe that was found under them; None where that hardly turns sources.

    lightings : as given. known : the photographs explained under the found ones. It hardly does where they turn by less
    than their deviations (RMS).
    """
    given = _with_sources(lightings, known)
    if known.best.estimate.brdf.sigma is None:
        return None
    known = _on_some(known)
    sighted = _Sighted.of(given, found.lightings, known)
    for _ in range(_ROUNDS):
        sighted = sighted.turned(given, known)
    better = sighted.found(lightings, given, found.apart)
    turns = _turns_between(given, found.lightings, better.lightings)
    return None if (turns**2 / np.diag(better.covariance)).mean() < 1 else better


def _with_sources(lightings: Mapping[str, Lighting], known: Explanation) -> dict[str, Lighting]:
    """Those lightings that have sources, and photographs that were fitted."""
    seen = {photo.lighting for photo in known.photos}
    return {name: own for name, own in lightings.items() if name in seen and len(own.directions)}


def _on_some(known: Explanation) -> Explanation:
    """The same on some of the samples, more of them where the lobe is bright: highlights tell of directions."""
    lobes = lobe_reach(known.photos, known.best.estimate)
    telling = [(own.trust * lobe**2).sum(axis=1) for own, lobe in zip(known.weights, lobes, strict=True)]
    photos, weights = some_samples(known.photos, known.weights, telling, _SAMPLES)
    return replace(known, photos=tuple(photos), weights=tuple(weights))


@dataclass(frozen=True, eq=False)
class _Sighted:
    """Sources where photographs see them, as far as they have gone.

    lightings : all of them. estimate : the BRDF under them. photos : their columns. photo_errors : their relative RMS.
    covariance : as of `FoundDirections`. surprise : squares of turns from where sources are given, over variances that
    photographs leave, mean: 1 if all of it is chance.
    """

    lightings: Mapping[str, Lighting]
    estimate: Estimate
    photos: Sequence[PhotoColumns]
    photo_errors: Floats
    covariance: Floats
    surprise: float

    @property
    def error(self) -> float:
        """Mean over photographs of the relative RMS."""
        return float(self.photo_errors.mean())

    @classmethod
    def of(cls, given: Mapping[str, Lighting], here: Mapping[str, Lighting], known: Explanation) -> _Sighted:
        """As an explanation has them, with sources `here`, and all numbers that its form may have.

        Fresnel's factor moves highlights, too; directions that are off may have hidden it.
        """
        return cls._of(given, here, known, known.best.estimate.model.form, known.photos)

    @classmethod
    def of_rival(
        cls, given: Mapping[str, Lighting], here: Mapping[str, Lighting], known: Explanation
    ) -> _Sighted | None:
        """The same with the best form of a single lobe of another kind; None if no other was tried."""
        own = known.best.estimate.model.form
        models = [(candidate.error, candidate.estimate.model) for candidate in known.candidates]
        others = [
            (error, model.form)
            for error, model in models
            if model.specular and len(model.form.parts) == 1 and model.form.lobe is not own.lobe
        ]
        if not others:
            return None
        form = min(others, key=lambda other: other[0])[1]
        elements = {name: light_elements(lighting) for name, lighting in here.items()}
        return cls._of(given, here, known, form, columns_under(elements, known.photos, form))

    @classmethod
    def _of(
        cls,
        given: Mapping[str, Lighting],
        here: Mapping[str, Lighting],
        known: Explanation,
        form: LobeForm,
        photos: Sequence[PhotoColumns],
    ) -> _Sighted:
        estimate = next(
            candidate.estimate
            for candidate in reversed(known.candidates)
            if candidate.estimate.model.form is form
        )
        errors = _errors(photos, known.weights, estimate)
        size = 2 * sum(len(own.directions) for own in given.values())
        return cls(here, estimate, photos, errors, np.zeros((size, size)), 0.0)

    def turned(self, given: Mapping[str, Lighting], known: Explanation) -> _Sighted:
        """Sources a step nearer to where they are seen, and the BRDF that follows."""
        weights, estimate = known.weights, self.estimate
        here = {name: self.lightings[name] for name in given}
        pulled = pulled_sources(here, self.photos, weights, estimate)
        prior = np.concatenate([_prior(own) for own in given.values()])
        offset = -_turns_between(given, here, given)
        precision = pulled.information + np.diag(prior)
        turns = np.linalg.solve(precision, pulled.pull - prior * offset).reshape(-1, 2)
        assert estimate.brdf.sigma is not None
        lengths = np.linalg.norm(turns, axis=1, keepdims=True)
        turns *= np.minimum(1.0, _MOST_OF_WIDTH * estimate.brdf.sigma / np.maximum(lengths, 1e-300))
        total = offset + turns.ravel()
        lightings, start = dict(self.lightings), 0
        for name, own in here.items():
            own_turns = turns[start : start + len(own.directions)]
            start += len(own.directions)
            moved = np.einsum("ka,kaj->kj", own_turns, tangents(own.directions))
            lightings[name] = replace(own, directions=own.directions + moved)
        elements = {name: light_elements(own) for name, own in lightings.items()}
        photos = columns_under(elements, self.photos, estimate.model.form)
        statistics = total_statistics(photos, [own.weight for own in weights])
        followed = fit(estimate.model, statistics, estimate)
        return _Sighted(
            lightings,
            followed,
            photos,
            _errors(photos, weights, followed),
            np.asarray(np.linalg.inv(precision), float),
            float(total @ pulled.information @ total / len(total)),
        )

    def found(
        self, lightings: Mapping[str, Lighting], given: Mapping[str, Lighting], apart: Floats
    ) -> FoundDirections:
        """Where sources went, with deviations; those that no fitted photograph shows follow the others.

        lightings : as they are given. apart : as of `FoundDirections`.
        """
        covariance = self.covariance + np.outer(apart, apart)
        moved, start = dict(self.lightings), 0
        for name, own in given.items():
            stop = start + 2 * len(own.directions)
            blocks = [covariance[k : k + 2, k : k + 2] for k in range(start, stop, 2)]
            deviations = np.degrees([np.sqrt(np.linalg.eigvalsh(block)[1]) for block in blocks])
            moved[name] = replace(moved[name], direction_std_deg=deviations, directions_found=True)
            start = stop
        return FoundDirections({**moved, **_follow(given, moved, lightings)}, tuple(given), covariance, apart)


def _prior(given: Lighting) -> Floats:
    """What is known of a lighting's turns beforehand: one over the variance of each, (sources, 2)."""
    stated = given.direction_std_deg
    deviations = np.full(len(given.directions), _UNSTATED) if stated is None else np.radians(stated)
    return np.repeat(1 / np.maximum(deviations, 1e-9) ** 2, 2)


def _errors(photos: Sequence[PhotoColumns], weights: Sequence[Weights], estimate: Estimate) -> Floats:
    """Relative RMS (photos,) that an estimate leaves."""
    predictions = predict_photos(photos, estimate.brdf, estimate.strengths)
    errors = [
        relative_rms(photo.radiance - predicted, photo.radiance, own.trust * photo.field.shares[:, None])
        for photo, own, predicted in zip(photos, weights, predictions, strict=True)
    ]
    return np.array(errors)


def _follow(
    given: Mapping[str, Lighting], found: Mapping[str, Lighting], lightings: Mapping[str, Lighting]
) -> dict[str, Lighting]:
    """Lightings that no fitted photograph shows, turned as a linear map of directions turned the others.

    given, found : of those that were fitted. lightings : all as they are given. None where the map doesn't explain how
    these turned, each by a map of the rest.
    """
    rest = {name: own for name, own in lightings.items() if name not in given and len(own.directions)}
    measured = np.concatenate([own.directions for own in given.values()])
    seen = np.concatenate([found[name].directions for name in given])
    if not rest or len(measured) < _FEWEST:
        return {}
    turns = seen - measured
    turned = float(np.sqrt((turns**2).sum() / 2 / len(turns)))
    likely = float(np.mean([1 / precision for own in given.values() for precision in _prior(own)]))
    left = turned
    # How far turns scatter about the map weighs them against what is likely beforehand: that nothing turns. So lamps
    # away from all that were seen, which these say nothing of, stay where they are given.
    for _ in range(_MAP_STEPS):
        inverse = np.linalg.inv(measured.T @ measured + left**2 / likely * np.eye(3))
        change = inverse @ measured.T @ turns
        # Each source left out by the leverage of its direction.
        leverage = np.einsum("ki,ij,kj->k", measured, inverse, measured)
        unseen = (turns - measured @ change) / (1 - leverage)[:, None]
        left = float(np.sqrt((unseen**2).sum() / 2 / len(turns)))
    if left > _EXPLAINED * turned:
        return {}

    def deviations(directions: Floats) -> Floats:
        return np.degrees(left * np.sqrt(1 + np.einsum("ki,ij,kj->k", directions, inverse, directions)))

    return {
        name: replace(
            own,
            directions=own.directions + own.directions @ change,
            direction_std_deg=deviations(own.directions),
            directions_found=True,
        )
        for name, own in rest.items()
    }


def _turns_between(
    given: Mapping[str, Lighting], first: Mapping[str, Lighting], second: Mapping[str, Lighting]
) -> Floats:
    """Turns (2 m,), radians, from one to another of the sources of lightings `given`, as of `FoundDirections`."""
    turns = [
        np.einsum("kaj,kj->ka", tangents(first[name].directions), second[name].directions).ravel()
        for name in given
    ]
    return np.concatenate(turns)


def direction_sentence(lightings: Mapping[str, Lighting], found: FoundDirections, error: float) -> str:
    """What was found of sources in other directions. error : on unseen photographs with directions as given."""
    own = {name: lightings[name] for name in found.names}
    turns = np.degrees(np.linalg.norm(_turns_between(own, lightings, found.lightings).reshape(-1, 2), axis=1))
    by = f"{np.median(turns):.2g} degrees"
    if len(turns) > 1:
        by += f" (median of {len(turns)}), {turns.max():.2g} at most"
    return (
        f"Highlights don't lie where the given light directions put them: taken as given, {error:.1%} of the radiance"
        f" would be left on unseen photographs. Sources were turned by {by}. result.json has their directions with"
        " deviations: check these, and give them."
    )

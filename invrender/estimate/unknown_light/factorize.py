"""BRDF and lighting of a homogeneous body, both unknown, from photographs of it [RH01, sections 6.3 and 6.4]."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from capture.parallel import one_blas_thread
from capture.progress import OnStep, unwatched
from capture.source_region import SourceRegion
from invrender.brdf.lobes import GGX_FORM, RH01_FORM
from invrender.brdf.richer import COATED_HAZY
from invrender.estimate.noise import NoiseModel, Weights
from invrender.estimate.unknown_light.alternatives import alternatives_of, with_alternatives
from invrender.estimate.unknown_light.cross_validation import BlindCandidate, cross_validate, simplest
from invrender.estimate.unknown_light.forms import MOST_FORMS, Formed, choose_form
from invrender.estimate.unknown_light.identifiability import doubt_of, quantities_of
from invrender.estimate.unknown_light.ladder import (
    climb,
    climb_again,
    confirm,
    model_name,
    neighbours,
    without_rows,
)
from invrender.estimate.unknown_light.lighting_design import LightingDesign, pooled
from invrender.estimate.unknown_light.projection import BlindFit, light_scale, predicted
from invrender.estimate.unknown_light.robust_start import judged, noise_and_weights, robust_start
from invrender.estimate.unknown_light.solution import GAUGE, BlindLight, BlindSolution, sources_of
from invrender.estimate.unknown_light.source_ambiguity import SourceAmbiguity, likelier_sides
from invrender.estimate.unknown_light.source_count import needed_sources
from invrender.estimate.unknown_light.sources import with_seconds
from invrender.estimate.unknown_light.start import Search, forget_rows, of_degree, thinned
from invrender.estimate.unknown_light.state import BlindState
from invrender.estimate.unknown_light.uncertainty import BlindUncertainty, blind_uncertainty
from invrender.estimate.unknown_light.warnings import remarks
from invrender.transport.lobe_table import TRANSFERS, Transfer
from invrender.transport.visibility import Shadows
from recon.harmonics.basis import check_degree
from recon.sampling.lightfield import LightField, clear_of_terminators

Floats = NDArray[np.float64]

# What the lighting is called where all photographs are under one.
ONLY_LIGHT = "light"
ORDERS = (0, 4, 6, 8, 10, 12, 16)
# Sources are looked for under light of up to this degree, in a part of the samples.
_SEARCH_DEGREE, _SEARCH_SAMPLES, _SEARCH_PER_LIGHTING = 10, 3000, 600
# Samples that the ladder of models is climbed with.
_LADDER_SAMPLES, _LADDER_PER_LIGHTING = 15_000, 2000
# Noise that is assumed until residuals show it.
_FIRST_RELATIVE, _FIRST_FLOOR, _BRIGHT = 0.01, 0.002, 0.6
_SAME_ANGLE = 1e-3
# Weight of samples of a mesh whose lobe an edge cuts. They would pull at mu, but may be all that there are.
_AT_EDGES = 0.1


def factorize_blind(
    photos: Sequence[LightField],
    lighting_of: Sequence[str] | None = None,
    orders: Sequence[int] = ORDERS,
    source_regions: Mapping[str, SourceRegion] = MappingProxyType({}),
    ladder: bool = True,
    on_step: OnStep = unwatched,
    transfer: Transfer = "exact",
    shadows: Shadows | None = None,
    near: BlindSolution | None = None,
) -> BlindSolution:
    """Lightings and BRDF from light-field samples of a homogeneous body under unknown light.

    photos : two or more, normals and views in one frame. lighting_of : which lighting each is under, by name; all under
    one if None. orders : degrees of the lightings that are tried, one for all of them; those above 10 as long as it
    takes the one before. source_regions : where sources may be, by the lighting's name; anywhere in others. ladder :
    whether other forms of the lobe and simpler models are tried; False fits RH01's microfacet model at the highest
    order up to 10. `on_step` is called after each model. transfer : what the lobe makes of the light, of RH01's form
    alone unless `exact`; sources have closed forms in any case [eq. 23]. shadows : of a mesh on itself; None of a
    convex body. near : a solution of the same samples with nearly the same radiance, whose candidates are fitted and
    compared again instead of a new search. Raises ValueError for photographs that can't determine anything: a single
    one, too few samples, all at one angle, radiance that is not finite or mostly negative.
    """
    orders = sorted(set(orders))
    lighting_of = [ONLY_LIGHT] * len(photos) if lighting_of is None else list(lighting_of)
    names = tuple(dict.fromkeys(lighting_of))
    _check(photos, lighting_of, orders, transfer)
    numbers = [names.index(name) for name in lighting_of]
    with one_blas_thread():
        # Prepared for uniform light as yet: parts of the samples are, for more.
        together, designs = pooled(photos, numbers, transfer, shadows)
        regions = {names.index(name): region for name, region in source_regions.items() if name in names}
        search, assumed = _first_weights(designs, regions), _assumed(photos)
        if near is None:
            climbed = _ladder(search, assumed, orders, ladder, transfer, on_step)
        else:
            climbed = _ladder_again(search, assumed, near, on_step)
        few, thin, candidates = climbed.search, climbed.thin, climbed.candidates
        noise, weights = climbed.noise, climbed.weights
        chosen = simplest(candidates)
        error = candidates[chosen].error
        pair = [chosen] if few.numbers == search.numbers else neighbours(candidates, chosen)
        own, degree = candidates[chosen].fit, max(candidates[index].fit.l_max for index in pair)
        if few.numbers == search.numbers:
            search = of_degree(few, degree)
        else:
            # What all samples take up shall not come on top of what parts of them did.
            del few, climbed
            forget_rows(thin)
            search = of_degree(search, degree, settled=True)
            search, noise, weights = _weighed(search, search.at(own.state, own.l_max))
        chosen = confirm(search, candidates, pair)
        on_step()
        sides = likelier_sides(search, candidates[chosen].fit)
        if sides is not None and sides.fit is not candidates[chosen].fit:
            candidates[chosen] = cross_validate(model_name(sides.fit), search, sides.fit)
        split = with_seconds(thin, candidates[chosen].fit)
        certainty = blind_uncertainty(search, candidates[chosen].fit, split, sides)
        rivals = alternatives_of(search, candidates[chosen], candidates, error)
        certainty = with_alternatives(certainty, candidates[chosen].fit, rivals)
    # As they were given.
    back = np.argsort(np.concatenate(together))
    candidates = [replace(candidate, photo_errors=candidate.photo_errors[back]) for candidate in candidates]
    by_photo = [of for design, own in zip(search.designs, weights, strict=True) for of in _split(design, own)]
    weights = tuple(by_photo[k] for k in back)
    return _solution(search, candidates, chosen, certainty, noise, weights, split, sides, names, transfer)


@dataclass(frozen=True, eq=False)
class _Climbed:
    """The ladder of models: some samples, weighed by the noise that a fit leaves, and the evidence there.

    thin : fewer samples, on which sources are looked for.
    """

    search: Search
    thin: Search
    noise: NoiseModel
    weights: tuple[Weights, ...]
    candidates: list[BlindCandidate]


def _ladder(
    search: Search,
    assumed: NoiseModel,
    orders: Sequence[int],
    ladder: bool,
    transfer: Transfer,
    on_step: OnStep,
) -> _Climbed:
    """The ladder from nothing."""
    degree = max([order for order in orders if order <= _SEARCH_DEGREE] or orders[:1])
    dark = degree == 0 or (ladder and orders[0] == 0)
    thin = thinned(search, _SEARCH_DEGREE if dark else degree, _SEARCH_SAMPLES, _SEARCH_PER_LIGHTING)
    any_form = ladder and transfer == "exact"
    form = COATED_HAZY[GGX_FORM] if any_form else RH01_FORM
    kept, found, lamps = robust_start(thin, degree, dark, assumed, form)
    outliers, thin = kept is not thin, kept
    formed = Formed(found, ())
    if any_form:
        formed = choose_form(thin if degree else of_degree(thin, 0), found, degree)
    # Which model it takes shows in part of the samples; all of them have the last word between neighbours.
    few = thinned(search, degree, _LADDER_SAMPLES, _LADDER_PER_LIGHTING)
    if outliers:
        few = judged(few, formed.found, assumed)
    fit = few.fit(formed.found.state, degree)
    few, noise, weights = _weighed(few, fit)
    # What a lamp in the dark explains is judged again by the noise that was found.
    state = fit.state if degree else needed_sources(few, fit)
    fit = few.fit(state, degree)
    candidates = [cross_validate(model_name(fit), few, fit)]
    on_step(candidates[0].outcome)
    if ladder:
        candidates = climb(few, thin, lamps, candidates[0], orders, formed.others, on_step)
    candidates[0] = without_rows(candidates[0])
    return _Climbed(few, thin, noise, weights, candidates)


def _ladder_again(search: Search, assumed: NoiseModel, near: BlindSolution, on_step: OnStep) -> _Climbed:
    """The ladder of nearly the same photographs: each candidate from where it was."""
    chosen, degree = near.candidates[near.chosen].fit, max(each.fit.l_max for each in near.candidates)
    few = thinned(search, degree, _LADDER_SAMPLES, _LADDER_PER_LIGHTING)
    few = judged(few, few.at(chosen.state, chosen.l_max), assumed)
    few, noise, weights = _weighed(few, few.fit(chosen.state, chosen.l_max))
    on_step()
    candidates = climb_again(few, near.candidates, on_step)
    thin = thinned(few, degree, _SEARCH_SAMPLES, _SEARCH_PER_LIGHTING)
    return _Climbed(few, thin, noise, weights, candidates)


def blind_steps(orders: Sequence[int] = ORDERS) -> int:
    """How often `factorize_blind` reports progress at most."""
    # Each order with a lobe and without, and of degree 2; lamps; other forms; the first fit, what may be left out, the
    # last.
    return 2 * len(orders) + 6 + MOST_FORMS


def _check(
    photos: Sequence[LightField], lighting_of: Sequence[str], orders: Sequence[int], transfer: Transfer
) -> None:
    if transfer not in TRANSFERS:
        raise ValueError(f"transfer is {transfer!r}; it must be one of {', '.join(TRANSFERS)}")
    if len(photos) < 2:
        raise ValueError(
            f"there are {len(photos)} photographs; one can't separate light from reflectance (a mirror"
            " ball under some light explains any image): add photographs from other sides"
        )
    if len(lighting_of) != len(photos):
        raise ValueError(
            f"lighting_of names the lightings of {len(lighting_of)} photographs; there are {len(photos)}"
        )
    if not orders:
        raise ValueError("orders is empty; name at least one degree of the lighting to try")
    check_degree(orders[0], "the lowest of orders")
    for index, photo in enumerate(photos):
        wrong = photo.radiance.size - int(np.isfinite(photo.radiance).sum())
        if wrong:
            raise ValueError(
                f"photograph {index}: {wrong} of {photo.radiance.size} radiances are not finite; leave out those"
                " samples"
            )
    # Lamps alone are an answer to a dark room only: elsewhere it takes the next order.
    unknowns = (next((order for order in orders if order), 0) + 1) ** 2 + 6
    counts: Counter[str] = Counter()
    for photo, name in zip(photos, lighting_of, strict=True):
        counts[name] += len(photo)
    for name, samples in counts.items():
        if samples < unknowns:
            where = "" if len(counts) == 1 else f" under lighting {name!r}"
            raise ValueError(
                f"there are {samples} samples{where} for {unknowns} unknowns; take more samples or lower the order"
            )
    radiance = np.concatenate([photo.radiance for photo in photos])
    dark = float((radiance <= 0).mean())
    if dark > 0.5:
        raise ValueError(
            f"{dark:.0%} of the radiances are zero or negative; check the black level and the masks"
        )
    cos = np.concatenate([photo.cos_exitant for photo in photos])
    if np.ptp(np.arccos(np.clip(cos, -1, 1))) < _SAME_ANGLE:
        raise ValueError(
            f"all samples are seen at one exitant angle, {np.degrees(np.arccos(min(cos[0], 1))):.1f} degrees; add"
            " pixels nearer the outline"
        )


def _first_weights(designs: Sequence[LightingDesign], regions: Mapping[int, SourceRegion]) -> Search:
    assumed = _assumed([photo for design in designs for photo in design.photos])
    fields = [design.field for design in designs]
    weights = [(field.weight * field.shares)[:, None] / assumed.variance(field.radiance) for field in fields]
    trust = [np.ones_like(field.radiance) for field in fields]
    return Search(designs, weights, trust, light_scale(designs), regions)


def _assumed(photos: Sequence[LightField]) -> NoiseModel:
    level = float(np.mean([np.quantile(np.abs(photo.radiance), _BRIGHT) for photo in photos]))
    return NoiseModel(_FIRST_FLOOR * level, _FIRST_RELATIVE)


def _split(design: LightingDesign, weights: Weights) -> list[Weights]:
    """Weights of a design's samples, photograph by photograph."""
    parts = zip(design.split(weights.trust), design.split(weights.weight), strict=True)
    return [Weights(*pair) for pair in parts]


def _weighed(search: Search, fit: BlindFit) -> tuple[Search, NoiseModel, tuple[Weights, ...]]:
    """The same search with weights from the noise that a fit's residuals show."""
    predictions = [
        predicted(design, fit, rows) for design, rows in zip(search.designs, fit.rows, strict=True)
    ]
    residuals = [s.radiance - p for s, p in zip(search.designs, predictions, strict=True)]
    brightness = [s.brightness(p) for s, p in zip(search.designs, predictions, strict=True)]
    weights, counted_trust = [], []
    noise, judged_by = noise_and_weights(search, fit, brightness, residuals)
    for design, found in zip(search.designs, judged_by, strict=True):
        sources = fit.state.under(design.lighting).sources
        counted = (design.field.weight * design.field.shares * _off_terminators(design, sources))[:, None]
        if fit.state.sigma is not None:
            counted = counted * np.where(design.off_edges(fit.state.sigma), 1, _AT_EDGES)[:, None]
        weights.append(Weights(found.trust, found.weight * counted))
        counted_trust.append(found.trust * counted)
    return (
        replace(search, weights=[w.weight for w in weights], trust=counted_trust),
        noise,
        tuple(weights),
    )


def _off_terminators(design: LightingDesign, sources: Floats) -> NDArray[np.bool_]:
    """Which samples (n,) are clear of the sources' horizons and of the borders of the shadows that they cast."""
    seen = replace(design.field, sources_visible=design.free(sources))
    clear = clear_of_terminators(seen, design.frame.world(sources))
    return clear & design.off_borders(sources)


def _solution(
    search: Search,
    candidates: Sequence[BlindCandidate],
    chosen: int,
    certainty: BlindUncertainty,
    noise: NoiseModel,
    weights: tuple[Weights, ...],
    split: BlindFit | None,
    sides: SourceAmbiguity | None,
    names: Sequence[str],
    transfer: Transfer,
) -> BlindSolution:
    fit = candidates[chosen].fit
    return BlindSolution(
        model=candidates[chosen].name,
        brdf_share=fit.state.specular_share,
        mu=fit.state.mu,
        sigma=fit.state.sigma,
        form=fit.state.form,
        lights={
            name: _light(search.only(number), fit, certainty, number) for number, name in enumerate(names)
        },
        quantities=quantities_of(fit, certainty, search.designs),
        covariance=certainty.covariance,
        covariance_names=_covariance_names(fit.state, names),
        candidates=tuple(candidates),
        chosen=chosen,
        noise=noise,
        weights=weights,
        gauge=GAUGE,
        warnings=remarks(search, fit, split, certainty, sides, names),
        certainty=certainty,
        transfer=transfer,
    )


def _light(search: Search, fit: BlindFit, certainty: BlindUncertainty, number: int) -> BlindLight:
    size, light, std = (fit.l_max + 1) ** 2, fit.light[number], certainty.light_std[number]
    sources = sources_of(fit, certainty, number, search.designs[0].frame)
    shares = certainty.degree_shares[number]
    degree, doubt = doubt_of(fit, shares, [design.field for design in search.designs])
    return BlindLight(light[:size], std[:size], sources, shares, degree, doubt)


def _covariance_names(state: BlindState, names: Sequence[str]) -> tuple[str, ...]:
    """The state's names, sources by their lighting where there are several, each counted on its own."""
    if len(names) == 1:
        return state.names
    seen: Counter[int] = Counter()
    own, numbered = [], []
    for owner in state.owners.tolist():
        seen[owner] += 1
        own += [f"{names[owner]}/source {seen[owner]} {way}" for way in "ab"]
        numbered.append(f"{names[owner]}/closeness {seen[owner]}")
    own += [numbered[k] for k in state.near]
    return (*state.names[: len(state.names) - len(own)], *own)

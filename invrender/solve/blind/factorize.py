"""BRDF and lighting of a homogeneous convex body, both unknown, from photographs of it [RH01, section 6.3]."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture.parallel import one_blas_thread
from invrender.model.lobetable import TRANSFERS, Transfer
from invrender.solve.blind.certainty import Certainty, certainty_of
from invrender.solve.blind.forms import Formed, choose_form
from invrender.solve.blind.projection import Fit, light_scale, predicted
from invrender.solve.blind.rungs import BlindRung, cross_validate, simplest
from invrender.solve.blind.sight import Sight
from invrender.solve.blind.solution import GAUGE, BlindSolution, BlindSources
from invrender.solve.blind.start import Found, Region, Search, find_sources, first_state, thinned
from invrender.solve.blind.state import State
from invrender.solve.blind.verdicts import determined_degree, quantities_of
from invrender.solve.noise import NoiseModel, Weights, fit_noise, photo_weights
from recon.harmonics import check_degree
from recon.lightfield import LightField, off_terminators

Floats = NDArray[np.float64]

ORDERS = (4, 6, 8, 10, 12)
# Sources are looked for under light of up to this degree, in a part of the samples.
_SEARCH_DEGREE, _SEARCH_SAMPLES = 10, 3000
# Noise that is assumed until residuals show it.
# Samples that the ladder of models is climbed with.
_LADDER_SAMPLES = 15_000
_FIRST_RELATIVE, _FIRST_FLOOR = 0.01, 0.002
_FIRST_MU = 1.5
_SAME_ANGLE = 1e-3


def factorize_blind(
    photos: Sequence[LightField],
    orders: Sequence[int] = ORDERS,
    source_region: Region | None = None,
    ladder: bool = True,
    on_step: Callable[[], None] = lambda: None,
    transfer: Transfer = "exact",
) -> BlindSolution:
    """Lighting and BRDF from light-field samples of a homogeneous convex body under one unknown lighting.

    photos : two or more, under the same light, normals and views in one frame. orders : degrees of the lighting that
    are tried. source_region : where sources may be; None for anywhere. ladder : whether other forms of the lobe and
    simpler models are tried; False fits RH01's microfacet model at the highest order up to 10. `on_step` is called
    after each model. transfer : what the lobe makes of the light, of RH01's form alone unless `exact`; sources have
    closed forms in any case [eq. 23]. Raises ValueError for photographs that can't determine anything: a single one,
    too few samples, all at one angle, radiance that is not finite or mostly negative.
    """
    orders = sorted(set(orders))
    _check(photos, orders, transfer)
    with one_blas_thread():
        degree = max([order for order in orders if order <= _SEARCH_DEGREE] or orders[:1])
        search = _first_weights(photos, orders[-1] if ladder else degree, source_region, transfer)
        thin = thinned(search, degree, _SEARCH_SAMPLES)
        formed = Formed(find_sources(thin, first_state(thin, degree), degree), ())
        if ladder and transfer == "exact":
            formed = choose_form(thin, formed.found, degree)
        found = formed.found
        fit = search.fit(found.fit.state, degree)
        search, noise, weights = _weighed(search, fit)
        fit = search.fit(fit.state, degree)
        on_step()
        chosen, rungs = 0, [cross_validate(_name(fit), search, fit)]
        if ladder:
            # Which model it takes shows in part of the samples; all of them have the last word between neighbours.
            few = thinned(search, orders[-1], _LADDER_SAMPLES)
            tried = few.fit(fit.state, degree)
            rungs = [cross_validate(_name(tried), few, tried)]
            rungs = _climb(few, thin, tried, orders, formed.others, on_step, rungs)
            chosen = simplest(rungs)
            if few is not search:
                chosen = _confirm(search, rungs, chosen)
            on_step()
        certainty = _with_split(certainty_of(search, rungs[chosen].fit), rungs[chosen].fit, found.split)
    return _solution(search, rungs, chosen, certainty, noise, weights, found, transfer)


def _check(photos: Sequence[LightField], orders: Sequence[int], transfer: Transfer) -> None:
    if transfer not in TRANSFERS:
        raise ValueError(f"transfer is {transfer!r}; it must be one of {', '.join(TRANSFERS)}")
    if len(photos) < 2:
        raise ValueError(
            f"there are {len(photos)} photographs; one can't tell light from reflectance (any image is explained by a"
            " mirror ball under some light): add photographs from other sides"
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
    samples, unknowns = sum(len(photo) for photo in photos), (orders[0] + 1) ** 2 + 6
    if samples < unknowns:
        raise ValueError(
            f"there are {samples} samples for {unknowns} unknowns; take more samples or lower the order"
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


def _first_weights(
    photos: Sequence[LightField], l_max: int, region: Region | None, transfer: Transfer
) -> Search:
    sights = [Sight.of(photo, l_max, transfer) for photo in photos]
    level = float(np.mean([np.abs(photo.radiance).mean() for photo in photos]))
    assumed = NoiseModel(_FIRST_FLOOR * level, _FIRST_RELATIVE)
    weights = [photo.weight[:, None] / assumed.variance(photo.radiance) for photo in photos]
    trust = [np.ones_like(photo.radiance) for photo in photos]
    return Search(sights, weights, trust, light_scale(sights), region)


def _weighed(search: Search, fit: Fit) -> tuple[Search, NoiseModel, tuple[Weights, ...]]:
    """The same search with weights from the noise that a fit's residuals show."""
    predictions = [predicted(fit, rows) for rows in fit.rows]
    residuals = [s.field.radiance - p for s, p in zip(search.sights, predictions, strict=True)]
    noise = fit_noise(predictions, residuals)
    weights, counted_trust = [], []
    for sight, prediction, residual in zip(search.sights, predictions, residuals, strict=True):
        found = photo_weights(noise, prediction, residual)
        counted = (sight.field.weight * _off_terminators(sight.field, fit.state.directions))[:, None]
        weights.append(Weights(found.trust, found.weight * counted))
        counted_trust.append(found.trust * counted)
    return (
        replace(search, weights=[w.weight for w in weights], trust=counted_trust),
        noise,
        tuple(weights),
    )


def _off_terminators(field: LightField, directions: Floats) -> NDArray[np.bool_]:
    """Which samples (n,) are clear of the sources' horizons."""
    visible = np.ones((len(field.ray_sample), len(directions)), bool)
    numbered = replace(field, rows=np.arange(len(field)), sources_visible=visible)
    return np.isin(numbered.rows, off_terminators(numbered, directions).rows)


def _climb(
    search: Search,
    thin: Search,
    fit: Fit,
    orders: Sequence[int],
    others: Sequence[State],
    on_step: Callable[[], None],
    rungs: Sequence[BlindRung],
) -> list[BlindRung]:
    """The ladder: orders of the lighting; then, at the best of them, what else may be left out or be needed.

    others : states with lobes of other forms, as good as their best.
    """
    rungs = list(rungs)

    def add(state: State, l_max: int, fitted: bool = False) -> None:
        tried = search.at(state, l_max) if fitted else search.fit(state, l_max)
        rungs.append(cross_validate(_name(tried), search, tried))
        on_step()

    for order in orders:
        if order != fit.l_max:
            add(fit.state, order)
    best = rungs[simplest(rungs)].fit
    if best.state.form.has_fresnel:
        add(replace(best.state, mu=_FIRST_MU if best.state.mu is None else None), best.l_max)
    for other in others:
        add(other, best.l_max, fitted=True)
    if len(best.state.directions):
        weakest = int(best.light[(best.l_max + 1) ** 2 :].sum(axis=1).argmin())
        add(best.state.without_source(weakest), best.l_max)
    # What a purely diffuse body would need of light is another matter: its sources are looked for anew.
    none = State(np.zeros(3), None, None, np.zeros((0, 3)))
    diffuse = find_sources(thin, none, fit.l_max).fit.state
    for order in dict.fromkeys([min(2, orders[0]), *orders]):
        add(diffuse, order)
    return rungs


def _confirm(search: Search, rungs: list[BlindRung], chosen: int) -> int:
    """Fit to all samples the chosen rung and the next richer lighting, in place; the simpler of both that suffices."""
    own = rungs[chosen].fit
    richer = [
        index
        for index, rung in enumerate(rungs)
        if rung.fit.l_max > own.l_max
        and rung.fit.state.names == own.state.names
        and rung.fit.state.form is own.state.form
    ]
    pair = [chosen, *sorted(richer, key=lambda index: rungs[index].fit.l_max)[:1]]
    for index in pair:
        fit = search.fit(rungs[index].fit.state, rungs[index].fit.l_max)
        rungs[index] = cross_validate(_name(fit), search, fit)
    return pair[simplest([rungs[index] for index in pair])]


def _with_split(certainty: Certainty, fit: Fit, split: Fit | None) -> Certainty:
    """Standard deviations that hold by how much two sources instead of one put the BRDF elsewhere."""
    if split is None or split.state.names[: len(fit.state.names)] != fit.state.names:
        return certainty
    count = len(fit.state.names) - 2 * len(fit.state.directions)
    ends = [
        np.array([*state.kappa, *(x for x in (state.mu, state.sigma) if x is not None)])
        for state in (fit.state, split.state)
    ]
    covariance = certainty.covariance.copy()
    covariance[np.arange(count), np.arange(count)] += (ends[1] - ends[0]) ** 2
    return replace(certainty, covariance=covariance)


def _name(fit: Fit) -> str:
    state = fit.state
    kind = "lambertian" if state.sigma is None else state.form.name
    bare = state.sigma is not None and state.mu is None and state.form.has_fresnel
    count = len(state.directions)
    sources = f"{count} source{'' if count == 1 else 's'}"
    return f"{kind}{' without Fresnel' if bare else ''}, lighting of degree {fit.l_max}, {sources}"


def _solution(
    search: Search,
    rungs: Sequence[BlindRung],
    chosen: int,
    certainty: Certainty,
    noise: NoiseModel,
    weights: tuple[Weights, ...],
    found: Found,
    transfer: Transfer,
) -> BlindSolution:
    fit = rungs[chosen].fit
    size, count = (fit.l_max + 1) ** 2, len(fit.state.directions)
    turns = np.sqrt(np.diag(certainty.covariance))[len(fit.state.names) - 2 * count :].reshape(count, 2)
    sources = BlindSources(
        fit.state.directions,
        fit.light[size:],
        certainty.light_std[size:],
        np.degrees(turns.max(axis=1)) if count else np.zeros(0),
    )
    warnings = []
    if found.split is not None:
        near = ", ".join(f"{x:.2f}" for x in found.split.state.directions[-1])
        warnings.append(
            f"light near ({near}) looks like a second source, but is nearer to another than the lobe is wide"
            f" ({np.degrees(found.split.state.sigma or 0):.1f} degrees): the two are treated as one"
        )
    return BlindSolution(
        model=rungs[chosen].name,
        brdf_share=fit.state.kappa,
        mu=fit.state.mu,
        sigma=fit.state.sigma,
        form=fit.state.form,
        coefficients=fit.light[:size],
        coefficients_std=certainty.light_std[:size],
        sources=sources,
        determined_degree=determined_degree(certainty.degree_shares),
        degree_shares=certainty.degree_shares,
        quantities=quantities_of(fit, certainty, search.sights),
        covariance=certainty.covariance,
        covariance_names=fit.state.names,
        rungs=tuple(rungs),
        chosen=chosen,
        noise=noise,
        weights=weights,
        gauge=GAUGE,
        warnings=tuple(warnings),
        transfer=transfer,
    )

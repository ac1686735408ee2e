"""The boards of the sphere: BRDF in known light, and light and BRDF at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial

from benchmarks.atlas.stage import Stage
from benchmarks.contest import (
    Found,
    Outcome,
    gauss_newton,
    judged,
    published_known,
    published_unknown,
    relative_error,
    statistics,
    whole_ladder,
)
from benchmarks.pareto.boards import Board, Contestant
from benchmarks.spherephotos import SpherePhotos, sphere_photos
from invrender.model.lobetable import TRANSFERS
from invrender.pipeline import DEFAULT_SAMPLES

PARAMETERS = "largest relative error of Ks share, mu - 1, sigma"
DRAWS = 2
_BUDGETS: tuple[int | None, ...] = (500, 2000, 8000, 32000, None)
_ORDERS, _ORDER_BUDGET = (4, 6, 8, 12), 8000
# RH01's map of the light takes so many samples.
_FEWEST_OF_MAP = 2000
# Of a coarse version; the last is what the default of `process` is in it.
_QUICK_BUDGET, _QUICK_ORDERS, _QUICK_DEFAULT = 2000, (8,), 500

Method = Callable[[SpherePhotos], Found]


@cache
def photographed(quick: bool) -> SpherePhotos:
    """Twelve photographs, or six small ones, all pixels of them."""
    return sphere_photos(Stage(views=6 if quick else 12, radius_px=30 if quick else 45), 0)


def sphere_boards(quick: bool) -> list[Board]:
    """In known light, and in unknown light."""
    found = []
    for known, title in ((True, "sphere, known light"), (False, "sphere, unknown light")):
        entries = _known(quick) if known else _unknown(quick)
        found.append(
            Board(
                title,
                PARAMETERS,
                lambda outcome: relative_error(outcome, photographed(quick).truth),
                [_contestant(quick, known, *entry) for entry in entries],
                1 if quick else DRAWS,
                partial(_warm_up, quick, statistics if known else gauss_newton),
            )
        )
    return found


def _known(quick: bool) -> Iterator[tuple[str, str, Method, bool]]:
    default = _QUICK_DEFAULT if quick else DEFAULT_SAMPLES
    yield "statistics (lightfactor)", f"default, {default}", partial(statistics, samples=default), True
    for budget in (_QUICK_BUDGET,) if quick else _BUDGETS:
        count = str(budget or "all")
        if not quick:
            yield "statistics (lightfactor)", count, partial(statistics, samples=budget), False
        for transfer in TRANSFERS:
            simplex = partial(published_known, samples=budget, transfer=transfer)
            yield f"simplex, {transfer} [RH01]", count, simplex, False


def _unknown(quick: bool) -> Iterator[tuple[str, str, Method, bool]]:
    default = _QUICK_DEFAULT if quick else DEFAULT_SAMPLES
    yield "whole ladder (lightfactor)", f"default, {default}", partial(whole_ladder, samples=default), True
    for budget in (_QUICK_BUDGET,) if quick else _BUDGETS:
        count = str(budget or "all")
        for transfer in TRANSFERS:
            newton = partial(gauss_newton, samples=budget, transfer=transfer)
            yield f"Gauss-Newton, {transfer}, l* = 10", count, newton, False
        if budget is None or budget >= _FEWEST_OF_MAP:
            yield "simplex and map [RH01]", count, partial(published_unknown, samples=budget), False
            if not quick:
                yield "whole ladder (lightfactor)", count, partial(whole_ladder, samples=budget), False
    budget = _QUICK_BUDGET if quick else _ORDER_BUDGET
    for order in _QUICK_ORDERS if quick else _ORDERS:
        newton = partial(gauss_newton, samples=budget, orders=(order,))
        yield f"Gauss-Newton, exact, {budget} samples", f"l* = {order}", newton, False


def _contestant(
    quick: bool, known: bool, family: str, setting: str, run: Method, is_default: bool
) -> Contestant:
    def judge(seed: int) -> Outcome:
        photos = photographed(quick).with_noise(seed)
        return judged(photos, family, known, setting, partial(run, photos))

    return Contestant(family, setting, judge, is_default, family.startswith("Gauss-Newton"))


def _warm_up(quick: bool, run: Callable[[SpherePhotos, int], Found]) -> None:
    """What a first run builds for all, such as tables of lobes, isn't timed; a coarse version times nothing."""
    if not quick:
        run(photographed(quick), 500)

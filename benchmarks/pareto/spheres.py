"""The boards of the sphere: BRDF in known light, and light and BRDF at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import product

from benchmarks.atlas.stage import Stage
from benchmarks.contest import (
    Found,
    Outcome,
    gauss_newton,
    judged,
    published_known,
    published_unknown,
    relative_error,
    single_statistics,
    statistics,
    whole_ladder,
)
from benchmarks.pareto.boards import Board, Contestant
from benchmarks.spherephotos import SpherePhotos, sphere_photos
from invrender.process.pipeline import DEFAULT_SAMPLES
from invrender.transport.lobe_table import TRANSFERS

PARAMETERS = "largest relative error of Ks share, mu - 1, sigma"
DRAWS = 2
_BUDGETS: tuple[int | None, ...] = (500, 2000, 8000, 32000, None)
# As far as approximations and published procedures gain by more; RH01's map of the light takes two thousand.
_LEVEL = (500, 2000, 8000)
_ORDERS, _ORDER_BUDGET = (6, 8, 12), 8000
# Of a coarse version; the last is what the default of `process` is in it.
_QUICK_BUDGET, _QUICK_ORDERS, _QUICK_DEFAULT, _QUICK_TRANSFERS = 1200, (8,), 500, TRANSFERS[1:2]

Method = Callable[[SpherePhotos], Found]


@cache
def photographed(quick: bool) -> SpherePhotos:
    """Twelve photographs, or six small ones, all pixels of them."""
    return sphere_photos(Stage(views=4 if quick else 12, radius_px=24 if quick else 45), 0)


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
    for budget in () if quick else _BUDGETS:
        yield "statistics (lightfactor)", _label(budget), partial(statistics, samples=budget), False
    for budget in (_QUICK_BUDGET,) if quick else (*_LEVEL[-1:], default):
        single = partial(single_statistics, samples=budget)
        yield "the same in single precision", _label(budget), single, False
    for level, transfer in product(*(((_QUICK_BUDGET,), _QUICK_TRANSFERS) if quick else (_LEVEL, TRANSFERS))):
        simplex = partial(published_known, samples=level, transfer=transfer)
        yield f"simplex, {transfer} [RH01]", _label(level), simplex, False


def _unknown(quick: bool) -> Iterator[tuple[str, str, Method, bool]]:
    default = _QUICK_DEFAULT if quick else DEFAULT_SAMPLES
    yield "whole ladder (lightfactor)", f"default, {default}", partial(whole_ladder, samples=default), True
    for transfer in _QUICK_TRANSFERS if quick else TRANSFERS:
        levels = _BUDGETS if transfer == "exact" else _LEVEL
        for budget in (_QUICK_BUDGET,) if quick else levels:
            newton = partial(gauss_newton, samples=budget, transfer=transfer)
            yield f"Gauss-Newton, {transfer}, l* = 10", _label(budget), newton, False
    for level in (_QUICK_BUDGET,) if quick else _LEVEL[1:]:
        yield "simplex and map [RH01]", _label(level), partial(published_unknown, samples=level), False
    if not quick:
        middle = partial(whole_ladder, samples=_LEVEL[1])
        yield "whole ladder (lightfactor)", _label(_LEVEL[1]), middle, False
    level = _QUICK_BUDGET if quick else _ORDER_BUDGET
    for order in _QUICK_ORDERS if quick else _ORDERS:
        newton = partial(gauss_newton, samples=level, orders=(order,))
        yield f"Gauss-Newton, exact, {level} samples", f"l* = {order}", newton, False


def _label(budget: int | None) -> str:
    return str(budget or "all")


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

"""The table of accuracy: truth beside estimate, beside the budget, beside what RH01 printed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.kept import Kept
from benchmarks.spheres.bench import LIGHT_DEGREE, MATERIALS, noisy, photographs, true_coefficients
from benchmarks.spheres.methods import KNOWN, UNKNOWN
from recon.harmonics.basis import degrees

# Budgets of errors: relative of Kd and Ks; else absolute. view, light : residual of unseen photographs over the noise.
_UNSEEN = {"view": 1.1, "light": 1.1}
BUDGETS = {
    ("known", 60): {"kd": 0.003, "ks": 0.003, "mu": 0.01, "sigma": 0.0003} | _UNSEEN,
    ("unknown", 60): {"share": 0.001, "mu": 0.015, "sigma": 0.0003, "source": 0.05, "nine": 0.003} | _UNSEEN,
    ("unknown", 3): {"share": 0.002, "mu": 0.03, "sigma": 0.0006, "source": 0.05, "nine": 0.003} | _UNSEEN,
}
BUDGETS["known", 3] = BUDGETS["known", 60]
# What RH01 found of real spheres whose truth nobody knows, [Fig. 11]: Ks over Kd + Ks (green), mu, sigma.
RH01_FORM = {
    "known": {
        "teflon": (0.11, 1.78, 0.12), "delrin": (0.13, 1.44, 0.10), "neoprene": (0.08, 1.49, 0.10),
        "steel": (0.80, None, 0.20), "bronze": (0.895, None, 0.12), "painted": (0.29, 1.38, 0.15),
    },
    "unknown": {
        "teflon": (0.13, 1.48, 0.14), "delrin": (0.12, 1.35, 0.11), "neoprene": (0.07, 1.34, 0.10),
        "steel": (0.86, None, 0.19), "bronze": (0.908, None, 0.10), "painted": (0.25, 1.15, 0.15),
    },
}  # fmt: skip
_GREEN = 1


@dataclass(frozen=True)
class Case:
    """A row of the table: how the light is told, how many views, of what, by which method."""

    light: str
    views: int
    material: str
    method: str

    @property
    def key(self) -> str:
        return f"{self.light}/{self.views}/{self.material}/{self.method}"


def cases(
    lights: Sequence[str], views: Sequence[int], materials: Sequence[str], rungs: Sequence[str]
) -> Iterator[Case]:
    """All rows, in the order in which they are measured."""
    for light in lights:
        methods = KNOWN if light == "known" else UNKNOWN
        for count in views:
            for material in materials:
                for method in methods:
                    if any(method == rung or method.startswith(f"{rung},") for rung in rungs):
                        yield Case(light, count, material, method)


def measure(case: Case, kept: Kept, samples: int) -> dict[str, Any]:
    """A row's entry, from what is kept or measured now."""
    if case.key not in kept:
        photos = noisy(photographs(case.material, case.light == "known", case.views, samples), 0)
        method = (KNOWN if case.light == "known" else UNKNOWN)[case.method]
        kept[case.key] = method(case.material, photos)
    return dict(kept[case.key])


def errors(case: Case, entry: Mapping[str, Any]) -> dict[str, float | None]:
    """What the budget is about; None where the method gives no such number although there is one, NaN without one."""
    truth = MATERIALS[case.material]
    found: dict[str, float | None] = {}
    for name in BUDGETS[case.light, case.views]:
        if name in ("mu", "sigma"):
            true, value = getattr(truth, name), entry[f"found {name}"]
            found[name] = float("nan") if true is None and value is None else None
            if true is not None and value is not None:
                found[name] = abs(value - true)
        else:
            found[name] = entry[name]
    return found


def print_table(rows: Sequence[tuple[Case, Mapping[str, Any]]]) -> None:
    """Each light and number of views in a table of its own."""
    for light, views in dict.fromkeys((case.light, case.views) for case, _ in rows):
        own = [(case, entry) for case, entry in rows if (case.light, case.views) == (light, views)]
        budget = BUDGETS[light, views]
        print(f"\n{light} light, {views} views; errors beside budgets: + within, ! beyond")
        head = f"{'':10}{'':20}{'share':>17}{'mu':>14}{'sigma':>17}"
        print(head + "".join(f"{name:>11}" for name in budget) + f"{'seconds':>9}")
        blank = f"{'':10}{'':20}{'truth  found':>17}{'truth  found':>14}{'truth  found':>17}"
        print(blank + "".join(f"{limit:>10g} " for limit in budget.values()))
        for case, entry in own:
            print(_line(case, entry, budget))
        for name, (share, mu, sigma) in RH01_FORM[light].items():
            if any(case.material == name for case, _ in own):
                print(f"{name:10}{'RH01 printed':20}{share:17.3f}{_text(mu, 2):>14}{sigma:17.2f}")
    _print_verdict(rows)


def _line(case: Case, entry: Mapping[str, Any], budget: Mapping[str, float]) -> str:
    truth = MATERIALS[case.material]
    share = truth.ks[_GREEN] / (truth.kd[_GREEN] + truth.ks[_GREEN])
    line = f"{case.material:10}{case.method:20}{share:8.4f}{entry['found share'][_GREEN]:9.4f}"
    line += f"{_text(truth.mu, 2):>6}{_text(entry['found mu'], 3):>8}"
    line += f"{truth.sigma:7.2f}{_text(entry['found sigma'], 5):>10}"
    for name, error in errors(case, entry).items():
        line += f"{'none !':>11}" if error is None else f"{_text(error, 5):>10}{_mark(error, budget[name])}"
    return line + f"{entry['seconds']:9.1f}"


def _mark(error: float, limit: float) -> str:
    return " " if np.isnan(error) else "+" if error <= limit else "!"


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None or np.isnan(value) else f"{value:.{digits}f}"


def _print_verdict(rows: Sequence[tuple[Case, Mapping[str, Any]]]) -> None:
    """Which lines of the budget our default method holds for all materials."""
    print("\nBudget lines, default method (exact), worst material:")
    for (light, views), budget in BUDGETS.items():
        own = [(c, e) for c, e in rows if (c.light, c.views, c.method) == (light, views, "exact")]
        for name, limit in budget.items():
            found = [(errors(case, entry)[name], case.material) for case, entry in own]
            if not found:
                continue
            worst, material = max(
                ((np.inf if e is None else -1.0 if np.isnan(e) else e), m) for e, m in found
            )
            holds = "holds" if worst <= limit else "FAILS"
            print(f"  {light:8}{views:3} views  {name:8}{worst:10.5f} of {limit:g}  {holds}  ({material})")


def print_consistency(rows: Sequence[tuple[Case, Mapping[str, Any]]]) -> None:
    """Fig. 12: by how much the light recovered from one sphere differs from that of another, by degree."""
    l = degrees(LIGHT_DEGREE)
    print(
        "\nFig. 12, the light of all materials, over the coefficient of degree 0: RMS per coefficient and channel"
    )
    print(f"{'':28}{'':12}" + "".join(f"{f'l = {k}':>9}" for k in range(1, LIGHT_DEGREE + 1)))
    truth = true_coefficients()
    print(f"{'the light itself':28}{'':12}" + _by_degree(truth**2, l))
    recovered = [(c, e) for c, e in rows if "coefficients" in e]
    for views, method in dict.fromkeys((c.views, c.method) for c, _ in recovered):
        own = [e["coefficients"] for c, e in recovered if (c.views, c.method) == (views, method)]
        if len(own) < 2:
            continue
        light = np.array(own, float)
        label = f"{method}, {views} views"
        print(f"{label:28}{'spread':12}" + _by_degree(light.var(axis=0, ddof=1), l))
        print(f"{'':28}{'off truth':12}" + _by_degree(((light - truth) ** 2).mean(axis=0), l))


def _by_degree(squares: np.ndarray, l: np.ndarray) -> str:
    return "".join(f"{np.sqrt(squares[l == k].mean()):9.4f}" for k in range(1, LIGHT_DEGREE + 1))

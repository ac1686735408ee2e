"""Time against error: each method on ever more samples of the same photographs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.ink import save
from benchmarks.kept import Kept
from benchmarks.spheres.bench import MATERIALS, noisy, photographs
from benchmarks.spheres.methods import KNOWN, UNKNOWN

SAMPLES = (500, 1000, 2000, 4000, 8000, 16_000, 32_000, 64_000)
_MATERIAL, _VIEWS = "teflon", 30
_COLOURS = ("#0b6bcb", "#7db8ee", "#1a7f37", "#c2410c", "#24292f")
_DRAWS = 3


def measure(kept: Kept, largest: int) -> None:
    """Every method, unknown light and known, at every number of samples, for three draws of the noise."""
    for light, methods in (("unknown", UNKNOWN), ("known", KNOWN)):
        for name, method in methods.items():
            warm = False
            for samples in [count for count in SAMPLES if count <= largest]:
                clean = None
                for seed in range(_DRAWS):
                    key = f"{light}/{name}/{samples}/{seed}"
                    if key in kept:
                        continue
                    if clean is None:
                        clean = photographs(_MATERIAL, light == "known", _VIEWS, samples)
                    try:
                        if not warm:
                            # Tables that a process makes once are no cost of a fit.
                            method(_MATERIAL, noisy(clean, 99))
                            warm = True
                        entry = method(_MATERIAL, noisy(clean, seed))
                    except ValueError as error:
                        entry = {"refused": str(error)}
                    kept[key] = {k: v for k, v in entry.items() if k != "coefficients"}


def print_timing(kept: Kept) -> None:
    """Seconds, and RMS errors of share, mu and sigma over the draws."""
    print(f"\n{_MATERIAL}, {_VIEWS} views: {'seconds':>29} {'share':>9} {'mu':>9} {'sigma':>9}")
    for light, name, samples in _points(kept):
        point = _point(kept, light, name, samples)
        if point is not None:
            label = f"{light}, {name}"
            print(f"{label:32}{samples:8} {point['seconds']:10.2f} " + " ".join(
                f"{point[k]:9.5f}" for k in ("share", "mu", "sigma")
            ))  # fmt: skip


def draw_timing(kept: Kept, path: Path) -> None:
    """Errors of share and mu over seconds, one line per method."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    panels = figure.subplots(2, 2, sharex="row")
    for row, (light, methods) in zip(panels, (("unknown", UNKNOWN), ("known", KNOWN)), strict=True):
        for axes, quantity, label in zip(row, ("share", "mu"), ("Ks / (Kd + Ks)", "μ"), strict=True):
            for (name, _), colour in zip(methods.items(), _COLOURS, strict=False):
                counts = [s for l, n, s in _points(kept) if (l, n) == (light, name)]
                points = [(s, _point(kept, light, name, s)) for s in counts]
                drawn = [(s, p) for s, p in points if p is not None and np.isfinite(p[quantity])]
                seconds, error = [p["seconds"] for _, p in drawn], [p[quantity] for _, p in drawn]
                axes.loglog(seconds, error, "o-", color=colour, ms=4, label=name)
                for k in (0, len(drawn) - 1) if drawn else ():
                    axes.annotate(
                        f"{drawn[k][0]}",
                        (seconds[k], error[k]),
                        fontsize=7,
                        xytext=(4, 4),
                        textcoords="offset points",
                    )
            axes.set(
                xlabel="seconds", ylabel=f"error of {label}, RMS of {_DRAWS} draws", title=f"{light} light"
            )
            axes.grid(which="both", color="#eaeef2")
        row[0].legend(frameon=False, fontsize=8)
    figure.suptitle(f"{_MATERIAL}, {_VIEWS} photographs, 1% noise; numbers at the lines' ends: samples")
    save(figure, path, kept.caption)


def _points(kept: Kept) -> list[tuple[str, str, int]]:
    found = []
    for key in kept:
        light, name, samples, _ = key.split("/")
        found.append((light, name, int(samples)))
    return sorted(dict.fromkeys(found), key=lambda point: (point[0] == "known", *point[1:]))


def _point(kept: Kept, light: str, name: str, samples: int) -> Mapping[str, Any] | None:
    entries = [kept.get(f"{light}/{name}/{samples}/{seed}") for seed in range(_DRAWS)]
    own = [entry for entry in entries if entry is not None and "seconds" in entry]
    if not own:
        return None
    truth = MATERIALS[_MATERIAL]
    share = truth.ks / (truth.kd + truth.ks)

    def rms(values: list[float]) -> float:
        return float(np.sqrt(np.mean(np.square(values)))) if len(values) == len(own) else float("nan")

    return {
        "seconds": float(np.median([entry["seconds"] for entry in own])),
        "share": rms([float(np.abs(np.array(entry["found share"]) - share).max()) for entry in own]),
        "mu": rms([entry["found mu"] - truth.mu for entry in own if entry["found mu"] is not None]),
        "sigma": rms(
            [entry["found sigma"] - truth.sigma for entry in own if entry["found sigma"] is not None]
        ),
    }

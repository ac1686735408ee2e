"""R02's fig. 5.7: how much of measured BRDFs few orders hold.

R02 took CURET's 61 samples. Here they are two paints that Cornell measured, between whose samples `synthetic`
interpolates, and published fits to MERL's 100 materials: Bagher's and Low's (2012). Each BRDF is expanded about the
mirrored view, degrees up to F = 30 of the light's direction, orders up to P = 0 to 5 of the view's, energies of the
three channels added. `evened` is the same without what depends on the view alone, as `lightfactor prefilter` has it.
The fits are functions beyond what was measured, at grazing views above all.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.papers.entry import Outcome, Workplace
from capture.reflectance.cornell import read_cornell
from invrender.brdf.bagher2012 import ShiftedGammaBrdf
from invrender.brdf.form import Lobe
from invrender.brdf.low2012 import AbcBrdf
from invrender.prefilter.centred import specular_lobe
from invrender.prefilter.energy import isotropic_fraction
from invrender.prefilter.reflectionmap import lobe_coefficients
from synthetic.materials.interpolated import interpolated
from synthetic.materials.tabulated import Tabulated

Floats = NDArray[np.float64]

_F, _P = 30, 5
_COLOURS = ("#cccccc", "#a8c8e0", "#7aaed0", "#4a90bf", "#1f6fa8", "#000000")
# Where coarse versions do: every so many-th material of MERL, and how fine the quadrature is.
_QUICK_STRIDE, _QUICK_FINENESS = 50, 0.5


def orders_of_measured(place: Workplace) -> Outcome:
    """R02's fig. 5.7: shares of the energy for P = 0 to 5, a row per material."""
    table = [["set", "", "of", "", *(f"P = {p}" for p in range(_P + 1))]]
    shares: dict[str, Floats] = {}
    for name, materials in _measured_sets(place.real("brdf"), place.quick).items():
        chosen = list(materials.values())[:: _QUICK_STRIDE if place.quick else 1]
        for kind, of in (("whole", _whole_shares), ("evened", _evened_shares)):
            found = np.array([of(lobes, _QUICK_FINENESS if place.quick else 1.0) for lobes in chosen])
            shares[f"{name}, {kind}"] = found
            for word, values in (("median", np.median(found, axis=0)), ("least", found.min(axis=0))):
                table.append([name, kind, str(len(found)), word, *(f"{value:.1%}" for value in values)])
            above = (found > 0.9).sum(axis=0)
            table.append([name, kind, str(len(found)), "above 90%", *map(str, above)])
    whole, evened = (
        {name: found for name, found in shares.items() if kind in name} for kind in ("whole", "evened")
    )
    return Outcome(
        "P = 5, F = 30 hold more than 90% of 56 of 61 materials",
        f"whole: {_counts(whole)}; without what depends on the view alone: {_counts(evened)}",
        "CURET isn't available; its samples are rough. Many of MERL's materials are glossy: their highlights are"
        " narrower than F = 30, whatever P. As whole BRDFs most of their energy is at grazing views, where fits"
        " divide by a cosine. Without what depends on the view alone, which a picture is multiplied by, P = 1 to 2"
        " hold more than 90% of every second material and of both paints. So R02's claim holds for rough materials,"
        " and for others with the view factor kept out.",
        place.save(_figure(shares), "r02-fig5.7"),
        table,
    )


def bagher_lobes(folder: Path) -> dict[str, list[Lobe]]:
    """Bagher's fits to MERL's materials: lobes of the three channels, by name."""
    tables = json.loads((folder / "merl_sgd_bagher2012.json").read_text())
    return {name: [_bagher(table, c) for c in range(3)] for name, table in tables.items()}


def cornell_lobes(folder: Path, name: str) -> list[Lobe]:
    """A paint that Cornell measured: lobes of the three channels."""
    return _tabulated(interpolated(read_cornell(folder / f"{name}.brdf")))


def _measured_sets(folder: Path, quick: bool) -> dict[str, dict[str, Sequence[Lobe]]]:
    abc = json.loads((folder / "merl_abc_low2012.json").read_text())
    # To interpolate between a paint's samples takes seconds.
    paints = () if quick else ("krylon_blue", "garnet_red")
    return {
        **({"Cornell": {name: cornell_lobes(folder, name) for name in paints}} if paints else {}),
        "MERL, Bagher": dict(bagher_lobes(folder)),
        "MERL, Low": {name: [_low(table, c) for c in range(3)] for name, table in abc.items()},
    }


def _counts(shares: dict[str, Floats]) -> str:
    """How many of each set P = 5 holds 90% of."""
    return ", ".join(
        f"{int((found[:, -1] > 0.9).sum())} of {len(found)} ({name.rpartition(', ')[0]})"
        for name, found in shares.items()
    )


def _whole_shares(lobes: Sequence[Lobe], fineness: float) -> Floats:
    """Shares (_P + 1,) of the energy up to F = 30 and each order, about the mirrored view."""
    held, total = np.zeros(_P + 1), 0.0
    for lobe in lobes:
        rho, energy = lobe_coefficients(lobe, _F, _P, fineness)
        held, total = held + energy * isotropic_fraction(rho, energy)[-1], total + energy
    return held / total


def _evened_shares(lobes: Sequence[Lobe], fineness: float) -> Floats:
    """The same without the view factor."""
    return _whole_shares(specular_lobe("whole", lobes, np.ones(3)).lobes, fineness)


def _figure(shares: dict[str, Floats]) -> Figure:
    """A panel per set, a row per material, a mark per order, as R02's fig. 5.7."""
    figure = Figure(figsize=(3.2 * len(shares) / 2, 9), layout="constrained")
    panels = figure.subplots(2, len(shares) // 2, sharex=True)
    for axes, (name, found) in zip(panels.T.flat, shares.items(), strict=True):
        ordered = found[np.argsort(found[:, -1])]
        for p in range(_P + 1):
            axes.plot(
                100 * ordered[:, p],
                np.arange(len(ordered)),
                "o" if p == _P else "D",
                markersize=3,
                color=_COLOURS[p],
                label=f"P = {p}",
            )
        axes.axvline(90, color="#D55E00", linewidth=0.8)
        axes.set(title=name, xlim=(0, 101), yticks=[])
    for axes in panels[-1]:
        axes.set_xlabel("share of the energy [%], F = 30")
    for axes in panels[:, 0]:
        axes.set_ylabel("materials, by P = 5")
    panels[0, -1].legend(loc="upper left", fontsize="small")
    return figure


def _bagher(table: dict, channel: int) -> Lobe:
    keys = ("rhoD", "rhoS", "alpha", "p", "f0", "f1", "kap", "lambda", "c", "k", "theta0")
    return ShiftedGammaBrdf(*(table[key][channel] for key in keys))


def _low(table: dict, channel: int) -> Lobe:
    return AbcBrdf(table["kD"][channel], table["A"][channel], table["B"], table["C"], table["ior"])


def _tabulated(material: Tabulated) -> list[Lobe]:
    return [_channel_lobe(material.lobe, channel) for channel in range(3)]


def _channel_lobe(brdf: Callable[[Floats, Floats], Floats], channel: int) -> Lobe:
    def lobe(normal: Floats, wi: Floats, wo: Floats) -> Floats:
        # Normal (3,) in the xz plane, as of `mirrored_coefficients`.
        tangent = np.array([normal[2], 0, -normal[0]])
        frame = np.stack([tangent, np.cross(normal, tangent), normal])
        incident, exitant = wi @ frame.T, frame @ wo
        lit = (incident[..., 2] > 0) & (exitant[2] > 0)
        return np.where(lit, brdf(incident, exitant)[..., channel] * incident[..., 2], 0)

    return lobe

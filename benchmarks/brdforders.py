"""How much of measured BRDFs few orders hold: our R02, fig. 5.7, of other materials.

    python -m benchmarks.brdforders [FIGURE [STRIDE]]

R02 took CURET's 61 samples. Here they are two paints that Cornell measured, between whose samples `synthetic`
interpolates, and published fits to MERL's 100 materials: Bagher's and Low's (2012). Each BRDF is expanded about the
mirrored view, degrees up to F = 30 of the light's direction, orders up to P = 0 to 5 of the view's, energies of the
three channels added. `evened` is the same without what depends on the view alone, as `lightfactor prefilter` has it.
The fits are functions beyond what was measured, at grazing views above all. STRIDE takes every so many-th material.
Needs LIGHTFACTOR_DATA, the folder of real data.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

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


def main(figure: str | None, stride: int) -> None:
    """Print quantiles per set, and draw all materials."""
    data = os.environ.get("LIGHTFACTOR_DATA")
    if data is None:
        print("LIGHTFACTOR_DATA isn't set: there are no measured BRDFs")
        return
    sets = measured_sets(Path(data) / "brdf")
    titles = [f"P = {p}" for p in range(_P + 1)]
    print(f"{'set':12} {'':7} {'of':>4} {'':7} " + " ".join(f"{title:>7}" for title in titles))
    shares: dict[str, Floats] = {}
    for name, materials in sets.items():
        chosen = list(materials.values())[:: stride if len(materials) > 2 else 1]
        for kind, of in (("whole", whole_shares), ("evened", evened_shares)):
            found = np.array([of(lobes) for lobes in chosen])
            shares[f"{name}, {kind}"] = found
            for word, values in (("median", np.median(found, axis=0)), ("least", found.min(axis=0))):
                cells = " ".join(f"{value:7.1%}" for value in values)
                print(f"{name:12} {kind:7} {len(found):4d} {word:7} {cells}", flush=True)
            above = " ".join(f"{int((found[:, p] > 0.9).sum()):7d}" for p in range(_P + 1))
            print(f"{name:12} {kind:7} {len(found):4d} {'> 90%':7} {above}", flush=True)
    if figure is not None:
        orders_figure(shares).savefig(figure, dpi=90)


def measured_sets(folder: Path) -> dict[str, dict[str, Sequence[Lobe]]]:
    """Lobes of the three channels of each material, by set and name."""
    sgd, abc = (
        json.loads((folder / name).read_text())
        for name in ("merl_sgd_bagher2012.json", "merl_abc_low2012.json")
    )
    return {
        "Cornell": {
            name: _tabulated(interpolated(read_cornell(folder / f"{name}.brdf")))
            for name in ("krylon_blue", "garnet_red")
        },
        "MERL, Bagher": {name: [_bagher(table, c) for c in range(3)] for name, table in sgd.items()},
        "MERL, Low": {name: [_low(table, c) for c in range(3)] for name, table in abc.items()},
    }


def whole_shares(lobes: Sequence[Lobe]) -> Floats:
    """Shares (_P + 1,) of the energy up to F = 30 and each order, about the mirrored view."""
    held, total = np.zeros(_P + 1), 0.0
    for lobe in lobes:
        rho, energy = lobe_coefficients(lobe, _F, _P)
        held, total = held + energy * isotropic_fraction(rho, energy)[-1], total + energy
    return held / total


def evened_shares(lobes: Sequence[Lobe]) -> Floats:
    """The same without the view factor."""
    return whole_shares(specular_lobe("whole", lobes, np.ones(3)).lobes)


def orders_figure(shares: dict[str, Floats]) -> Figure:
    """A panel per set, a row per material, a mark per order, as R02's fig. 5.7."""
    drawn = {name: found for name, found in shares.items() if len(found) > 2}
    figure = Figure(figsize=(3.4 * len(drawn), 8), layout="constrained")
    for axes, (name, found) in zip(
        figure.subplots(1, len(drawn), squeeze=False)[0], drawn.items(), strict=True
    ):
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
        axes.set(title=name, xlabel="share of the energy [%], F = 30", xlim=(0, 101), yticks=[])
    figure.axes[0].set_ylabel("materials, by P = 5")
    figure.axes[0].legend(loc="upper left", fontsize="small")
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


if __name__ == "__main__":
    main(sys.argv[1] if sys.argv[1:] else None, int(sys.argv[2]) if sys.argv[2:] else 1)

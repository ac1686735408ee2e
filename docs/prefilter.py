"""Our figs. 5.6, 5.8 and 5.9 of R02, docs/prefilter.png: reflection maps beside sums over directions.

python docs/prefilter.py [FOLDER]

Each row is a BRDF: the sum over all directions, spherical harmonic maps of P = 0, 2 and that of 97% of the energy, then
the maps of earlier work made of the last ones. Below each picture is its difference from the sum, as dark as it is.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from capture.lighting import latlong_directions, latlong_solid_angles
from invrender.brdf.form import Lobe
from invrender.brdf.kajiya_kay import kajiya_kay
from invrender.brdf.lafortune import SKIN
from invrender.brdf.rh01 import simplified_microfacet
from invrender.output.prefilter.figure import ball_axes, draw_picture
from invrender.prefilter.centred import CentredBrdf, CentredLobe
from invrender.prefilter.explicit_maps import icosahedral_maps, view_angle_texture
from invrender.prefilter.prefiltered import PrefilteredLobe, prefilter

Floats = NDArray[np.float64]
# Radiance (n, 3) of centres and views (n, 3).
Seen = Callable[[Floats, Floats], Floats]

_SIDE, _PARTS, _F = 56, 3, 30
_VIEWER = np.array([0.8, -0.36, 0.48])


def room() -> Floats:
    """Light (24, 48, 3) of a room: grey walls, a bluish window, an orange and a white lamp."""
    light = np.full((24, 48, 3), 0.15)
    light[:4] += 0.2
    light[6:12, 4:9] = [2.0, 2.6, 3.4]
    light[9:11, 20:22] = [14, 8, 3]
    light[4:6, 33:35] = 9.0
    return light


def skin(channel: int) -> Lobe:
    """All of skin, its cosine included."""
    gloss, albedo = SKIN.specular(channel), SKIN.albedo[channel]
    return lambda normals, wi, wo: (
        gloss(normals, wi, wo) + albedo / np.pi * np.maximum((normals * wi).sum(axis=-1), 0)
    )


BRDFS = {
    "microfacets, σ = 0.2": CentredBrdf(
        "microfacets", (CentredLobe("whole", (simplified_microfacet(0.2),), np.ones(3), True),)
    ),
    "skin": CentredBrdf("skin", (CentredLobe("whole", [skin(c) for c in range(3)], np.ones(3), True),)),
    "fibres, s = 32": CentredBrdf(
        "fibres", (CentredLobe("whole", (kajiya_kay(32.0),), 0.35 * np.ones(3), False),), "tangent"
    ),
}
# The orders P that hold 97% of each one's energy.
ORDERS = {"microfacets, σ = 0.2": 2, "skin": 4, "fibres, s = 32": 8}


def summed(lobe: CentredLobe, light: Floats, axes: Floats) -> Floats:
    """Radiance (n, 3) of axes (n, 3) by the sum over small parts of the light's pixels."""
    height = _PARTS * len(light)
    fine = light.repeat(_PARTS, axis=0).repeat(_PARTS, axis=1) * latlong_solid_angles(height)[:, :, None]
    wi, fine = latlong_directions(height).reshape(-1, 3), fine.reshape(-1, 3)
    lobes = list(lobe.lobes) if len(lobe.lobes) == 3 else list(lobe.lobes) * 3
    result = np.empty((len(axes), 3))
    for row, axis in enumerate(axes):
        values = [of(axis, wi, _VIEWER) for of in dict.fromkeys(lobes)]
        result[row] = [
            (values[c] if len(values) == 3 else values[0]) @ fine[:, c] * lobe.strength[c] for c in range(3)
        ]
    return result


def forms(few: PrefilteredLobe, p: int) -> dict[str, Seen]:
    """Cabral's and Kautz and McCool's maps of a reflection map of order P."""
    return {
        "Cabral": icosahedral_maps(few.world).radiance,
        "Kautz and McCool": view_angle_texture(few.local, 10 * p).radiance,
    }


def comparison() -> Figure:
    """Pictures and differences of all BRDFs; their relative RMS is printed."""
    figure = Figure(figsize=(13, 4.5 * len(BRDFS)), layout="constrained")
    panels = figure.subplots(2 * len(BRDFS), 6)
    light = room()
    for row, (name, brdf) in enumerate(BRDFS.items()):
        lobe, p = brdf.lobes[0], ORDERS[name]
        axes, inside = ball_axes(_VIEWER, _SIDE, brdf.axis == "tangent")
        views = np.broadcast_to(_VIEWER, axes.shape)
        centres = lobe.centres(axes, views)
        truth = summed(lobe, light, axes)
        found = {}
        for order in (0, 2 if p > 2 else 1, p):
            of_order = prefilter(light, brdf, orders=(_F, order)).lobes[0]
            found[f"P = {order}"] = of_order.radiance(axes, views)
        found |= {form: seen(centres, views) for form, seen in forms(of_order, p).items()}
        white = float(np.percentile(truth, 99.5))
        _draw(panels[2 * row, 0], truth, inside, white, name)
        panels[2 * row + 1, 0].set_axis_off()
        for column, (form, values) in enumerate(found.items(), start=1):
            off = np.sqrt(np.mean((values - truth) ** 2) / np.mean(truth**2))
            print(f"{name:22} {form:18} off by {off:6.1%} (RMS)")
            _draw(panels[2 * row, column], values, inside, white, form)
            _draw(panels[2 * row + 1, column], np.abs(values - truth), inside, white, f"off by {off:.1%}")
    return figure


def _draw(axes, values: Floats, inside: NDArray[np.bool_], white: float, title: str) -> None:
    picture = np.full((*inside.shape, 3), np.nan)
    picture[inside] = values
    draw_picture(axes, picture, white, title)


def main() -> None:
    """Draw into the folder of this file, or another."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    comparison().savefig(out / "prefilter.png", dpi=80)


if __name__ == "__main__":
    main()

"""R02's fig. 5.4: the highest degree that matters in reflected light, and in light and lobe."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from benchmarks.ink import YELLOW
from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.probes import probe
from invrender.output.prefilter.figure import ball_axes, draw_picture
from invrender.prefilter.energy import degree_reaching, energy_fraction, power_per_degree, symmetric_power
from invrender.prefilter.globalmap import interpolated
from invrender.theory.specialcases import phong_transfer
from recon.harmonics.basis import degrees
from recon.harmonics.latlong import integrate_latlong, synthesise_latlong

Floats = NDArray[np.float64]

_EPSILON, _DEGREE = 0.03, 60
_VIEWER = np.array([0.8, -0.36, 0.48])
# Half widths of the blurred light and of Phong's lobes, as degrees at which they let exp(-1/2) pass.
_LIGHT_DEGREES, _EXPONENTS = (2, 4, 8, 16), (256, 64, 16, 4)


def falling_frequencies(place: Workplace) -> Outcome:
    """R02's fig. 5.4: Grace Cathedral blurred to several degrees, on balls of several Phong exponents."""
    side, rows = (32, 64) if place.quick else (120, 128)
    coefficients = integrate_latlong(probe(place, "Grace Cathedral", rows), _DEGREE)
    figure = Figure(figsize=(9.5, 9.6), layout="constrained")
    panels = figure.subplots(len(_LIGHT_DEGREES), len(_EXPONENTS))
    normals, inside = ball_axes(_VIEWER, side, False)
    mirrored = 2 * (normals @ _VIEWER)[:, None] * normals - _VIEWER
    l = np.arange(_DEGREE + 1)
    table = [
        ["light blurred to degree", "F of the light", "Phong exponent", "F of the lobe", "F of the image"]
    ]
    found, expected = [], []
    for row, blur in zip(panels, _LIGHT_DEGREES, strict=True):
        light = coefficients * np.exp(-l * (l + 1) / (2 * blur**2))[degrees(_DEGREE), None]
        of_light = _order(power_per_degree(light).sum(axis=1))
        for axes, exponent in zip(row, _EXPONENTS, strict=True):
            transfer = phong_transfer(float(exponent), _DEGREE)
            of_lobe = _order(symmetric_power(transfer))
            reflected = light * transfer[degrees(_DEGREE), None]
            of_image = _order(power_per_degree(reflected).sum(axis=1))
            found.append(of_image)
            expected.append(min(of_light, of_lobe))
            table.append([str(each) for each in (blur, of_light, exponent, of_lobe, of_image)])
            values = interpolated(
                synthesise_latlong(reflected, 128).transpose(2, 0, 1).astype(np.float32), mirrored
            )
            picture = np.full((*inside.shape, 3), np.nan)
            picture[inside] = values
            white = float(np.percentile(values, 99.5))
            draw_picture(axes, picture, white, f"light {of_light}, lobe {of_lobe}: image {of_image}")
            axes.title.set_fontsize(10)
            if of_light == expected[-1]:
                frame = {"fill": False, "edgecolor": YELLOW, "linewidth": 2, "clip_on": False}
                axes.add_patch(Rectangle((0, 0), 1, 1, transform=axes.transAxes, **frame))
    figure.supxlabel(
        "Phong exponent "
        + ", ".join(map(str, _EXPONENTS))
        + " →\nabove each: the degree that holds 97% of the"
        " energy; framed: the light has the lower one"
    )
    figure.supylabel("softer light →")
    off = np.array(found) - np.array(expected)
    return Outcome(
        "highest frequency of the image ≈ minimum of light's and BRDF's",
        f"degree of 97% of the energy: minimum of both, minus {-off.max()} to {-off.min()}, {-off.mean():.1f} in the"
        " mean",
        f"It never exceeds the minimum, and is equal to it in {int((off == 0).sum())} of {len(off)} pictures. Where"
        " light and lobe fall off at about the same degree, their product falls off earlier.",
        place.save(figure, "r02-fig5.4"),
        table,
    )


def _order(power: Floats) -> int:
    return degree_reaching(energy_fraction(power, power.sum()), _EPSILON)

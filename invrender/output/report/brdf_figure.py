"""A BRDF as curves over the plane of incidence, with what is uncertain about it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from capture.figures import printable
from capture.radiance import CHANNELS
from invrender.brdf.form import Angles, Axis
from invrender.brdf.microfacet import Microfacet
from invrender.output.export.mapping import reflectance_cosine
from invrender.result.reflectance import Reflectance

Floats = NDArray[np.float64]

_VIEWS_DEG = (0.0, 30.0, 60.0)
_COLOURS = ("#c92a2a", "#2b8a3e", "#1864ab")
# Relative steps of mu and sigma for slopes.
_STEP = 1e-4


def brdf_figure(name: str, found: Reflectance) -> Figure:
    """BRDF times cosine, 1/sr, over the angle of incidence, for three angles of view; bands of one standard deviation.

    name : of the object. Of textures the means are drawn, without bands. Of a brushed lobe there are two planes of
    incidence, along the brushing and across it; the second is dashed.
    """
    figure = Figure(figsize=(12, 3.8), layout="constrained")
    figure.suptitle(printable(f"{name}: BRDF in the plane of incidence"))
    degrees = np.linspace(-89.0, 89.0, 357)
    # Axes about which the xz plane goes along the brushing, and across it.
    planes: dict[str, Axis | None] = {"-": None}
    if found.brdf.form.axis is not None:
        planes = {"-": (0.0, 1.0, 0.0), "--": (1.0, 0.0, 0.0)}
    panels = figure.subplots(1, len(_VIEWS_DEG), sharey=True)
    for axes, view_deg in zip(panels, _VIEWS_DEG, strict=True):
        for line, axis in planes.items():
            pair = _in_plane(degrees), _in_plane(np.array([-view_deg]))
            angles = Angles.between(np.array([0.0, 0, 1]), *pair, axis)
            values = reflectance_cosine(found.brdf, angles)
            slopes = _slopes(found.brdf, angles)
            variance = np.einsum("nkc,ckl,nlc->nc", slopes, found.covariance, slopes)
            std = np.sqrt(np.maximum(variance, 0))
            for channel, (label, colour) in enumerate(zip(CHANNELS, _COLOURS, strict=True)):
                value, band = values[:, channel], std[:, channel]
                axes.plot(degrees, value, line, color=colour, lw=1.2, label=label if line == "-" else None)
                axes.fill_between(degrees, value - band, value + band, color=colour, alpha=0.25)
        axes.axvline(-view_deg, color="0.6", ls=":", lw=1)
        axes.set(title=f"seen at {view_deg:.0f} degrees", xlabel="angle of incidence (degrees)")
    # After all is drawn: the panels share the axis.
    panels[0].set_ylim(0, None)
    panels[0].set_ylabel("BRDF times cosine (1/sr)")
    if len(planes) > 1:
        for line, plane in zip(planes, ("along the brushing", "across it"), strict=True):
            panels[-1].plot([], [], line, color="0.3", lw=1.2, label=plane)
    panels[-1].legend(frameon=False, fontsize=8)
    return figure


def _in_plane(degrees: Floats) -> Floats:
    """Directions (n, 3) in the xz plane at angles to +Z."""
    angle = np.radians(degrees)
    return np.column_stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)])


def _slopes(brdf: Microfacet, angles: Angles) -> Floats:
    """Derivatives (n, 4, 3) by Kd, Ks, mu and sigma; zero where the model lacks one."""
    none, one = np.zeros(3), np.ones(3)
    slopes = np.zeros((len(angles.cos_i), 4, 3))
    slopes[:, 0] = reflectance_cosine(replace(brdf, kd=one, ks=none), angles)
    if brdf.sigma is not None:
        slopes[:, 1] = reflectance_cosine(replace(brdf, kd=none, ks=one), angles)
    for place, (name, value) in enumerate((("mu", brdf.mu), ("sigma", brdf.sigma)), start=2):
        if value is not None:
            above, below = (
                reflectance_cosine(brdf.moved_to(name, value * (1 + step)), angles)
                for step in (_STEP, -_STEP)
            )
            slopes[:, place] = (above - below) / (2 * _STEP * value)
    return slopes

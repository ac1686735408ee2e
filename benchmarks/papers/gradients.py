"""RMB07's fig. 3 to 5: gradients of light fields after each step of shading, and what they are made of."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.tabletop import PARTS, seen_by_camera, shaded
from capture.srgb import linear_to_srgb
from invrender.gradients.flatland import PlaneField, blurred, gradient_terms, mirrored, rotated

Floats = NDArray[np.float64]

_CURVATURE, _LOBE = 0.8, 12.0
_STEP = 1e-4


def steps(place: Workplace) -> Outcome:
    """Fig. 3: a Gaussian light field and its gradients, original, rotated, mirrored, reflected."""
    light = _gaussian(0.6, 0.5)
    local = rotated(light, lambda x: _CURVATURE * x, lambda x: np.full_like(x, _CURVATURE))
    turned = mirrored(local)
    fields = {
        "light": light,
        "in the surface's frame": local,
        "mirrored": turned,
        "reflected": blurred(turned, _lobe),
    }
    side = 31 if place.quick else 121
    x, theta = np.meshgrid(np.linspace(-2, 2, side), np.linspace(-np.pi / 2, np.pi / 2, side))
    figure = Figure(figsize=(9, 11), layout="constrained")
    worst = 0.0
    for row, (name, field) in zip(figure.subplots(4, 3), fields.items(), strict=True):
        by_place, by_angle = field.by_place(x, theta), field.by_angle(x, theta)
        for axes, title, values in zip(
            row, (name, "by place", "by angle"), (field.value(x, theta), by_place, by_angle), strict=True
        ):
            _draw_signed(axes, values, title)
        differences = [
            (field.value(x + _STEP * a, theta + _STEP * b) - field.value(x - _STEP * a, theta - _STEP * b))
            / 2
            / _STEP
            for a, b in ((1, 0), (0, 1))
        ]
        off = max(
            np.abs(found - true).max() for found, true in zip((by_place, by_angle), differences, strict=True)
        )
        worst = max(worst, float(off / np.abs(differences).max()))
    return Outcome(
        "gradients shear, turn over and blur like the field",
        f"off central differences by at most {worst:.0e} of the largest",
        "Green is positive, red negative. Gradients follow the rule of each step (RMB07, fig. 2), not differences.",
        place.save(figure, "rmb07-fig3"),
    )


def situations(place: Workplace) -> Outcome:
    """Fig. 4: the sizes of the terms in common situations, in the plane."""
    near, distant, overcast = _gaussian(0.6, 0.5), _gaussian(np.inf, 0.5), _gaussian(np.inf, 3.0)
    narrow, wide = 60.0, 1.5
    cases = {
        "distant light": (distant, 0.8, _LOBE),
        "overcast sky": (overcast, 0.8, _LOBE),
        "near light": (near, 0.8, _LOBE),
        "bump map": (near, 6.0, _LOBE),
        "flat surface": (near, 0.0, _LOBE),
        "flat, distant light": (distant, 0.0, _LOBE),
        "Lambertian": (near, 0.8, wide),
        "mirror": (near, 0.8, narrow),
    }
    x, theta = np.random.default_rng(0).uniform(-1, 1, (2, 400))
    rows = [["situation", "SV", "DV", "CV", "CDV", "whole, by place"]]
    sizes = {}
    for name, (light, curvature, exponent) in cases.items():

        def lobe(_: Floats, apart: Floats, exponent: float = exponent) -> Floats:
            weight = np.exp(exponent * (np.cos(apart) - 1))
            return weight / (2 * np.pi * np.exp(-exponent) * np.i0(exponent))

        def normal(x: Floats, k: float = curvature) -> Floats:
            return k * x

        def slope(x: Floats, k: float = curvature) -> Floats:
            return np.full_like(x, k)

        terms = gradient_terms(light, normal, slope, lobe, x, theta)
        sizes[name] = [
            float(np.sqrt(np.mean(part**2)))
            for part in (terms.spatial, terms.directional, terms.curvature, terms.curved, terms.by_place)
        ]
        rows.append([name, *(f"{size:.3f}" for size in sizes[name])])
    return Outcome(
        "which terms are low, high or 0",
        "RMS of each term in each situation: the zeros are exact",
        "Distant light has no SV, a flat surface no CV and no CDV; under distant light it is evenly shaded. An overcast"
        " sky has a low DV. A bump map's CV is high. A matte lobe lowers DV, a mirror keeps it all.",
        table=rows,
    )


def scene(place: Workplace) -> Outcome:
    """Fig. 5: a table and three spheres under a near lamp: shading, its terms, and where the lamp counts as near."""
    seen = seen_by_camera(24 if place.quick else 150)
    terms = shaded(seen, 800 if place.quick else 3000)
    spatial, curved = (np.linalg.norm(part, axis=1) for part in (terms.spatial, terms.curvature))
    largest = float(np.quantile(np.maximum(spatial, curved), 0.999))
    figure = Figure(figsize=(15, 2.9), layout="constrained")
    panels = figure.subplots(1, 4)

    def draw(axes: Axes, title: str, values: Floats, **shown: Any) -> AxesImage:
        picture = np.full(seen.inside.shape, np.nan)
        picture[seen.inside] = values
        axes.set(xticks=[], yticks=[], title=title)
        return axes.imshow(picture, **shown)

    bright = np.clip(terms.radiance / np.quantile(terms.radiance, 0.995), 0, 1)
    draw(panels[0], "radiance", linear_to_srgb(bright), cmap="gray")
    for axes, title, values in zip(
        panels[1:3], ("SV: a near lamp", "CDV: curvature"), (spatial, curved), strict=True
    ):
        image = draw(
            axes, title, np.log10(np.maximum(values / largest, 1e-6)), cmap="viridis", vmin=-3, vmax=0
        )
    figure.colorbar(image, ax=panels[1:3], label="log10 of the gradient\nover the largest", shrink=0.9)
    ratio = np.log10(np.maximum(spatial, 1e-12) / np.maximum(curved, 1e-12))
    image = draw(panels[3], "SV over CDV", ratio, cmap="RdBu_r", vmin=-2, vmax=2)
    figure.colorbar(image, ax=panels[3], label="log10; red: the lamp\ncounts as near", shrink=0.9)
    told = ", ".join(
        f"{np.mean((spatial > curved)[seen.part == part]):.0%} of the {name}"
        for part, name in enumerate(PARTS)
    )
    return Outcome(
        "SV makes the table's highlight, CDV is largest on the bumpy sphere",
        f"SV is the larger on {told}",
        "The lamp is 3 radii of a sphere above the table, whose curvature is 0.02 per radius. By the criterion, 1 / d"
        " against 2 k, it is near for the table and far for the bumps; for the spheres it is in between.",
        place.save(figure, "rmb07-fig5"),
    )


def _gaussian(width: float, spread: float) -> PlaneField:
    """Light that is Gaussian in place and angle; of any place where the width is infinite."""

    def value(x: Floats, theta: Floats) -> Floats:
        return np.asarray(np.exp(-((x / width) ** 2) / 2 + (np.cos(theta) - 1) / spread**2))

    return PlaneField(
        value,
        lambda x, theta: -x / width**2 * value(x, theta),
        lambda x, theta: -np.sin(theta) / spread**2 * value(x, theta),
    )


def _lobe(_: Floats, apart: Floats) -> Floats:
    return np.asarray(np.exp(_LOBE * (np.cos(apart) - 1)))


def _draw_signed(axes: Axes, values: Floats, title: str) -> None:
    colours = LinearSegmentedColormap.from_list("signed", ["red", "black", "lime"])
    top = float(np.abs(values).max())
    axes.imshow(
        values, origin="lower", extent=(-2, 2, -90, 90), aspect="auto", cmap=colours, vmin=-top, vmax=top
    )
    axes.set(xlabel="place x", ylabel="angle θ [degrees]", title=title)

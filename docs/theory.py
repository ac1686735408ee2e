"""The figures of the theory's pages, docs/theory-*.png: what reflection does to light.

python docs/theory.py [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from capture.lighting import latlong_directions
from capture.srgb import linear_to_srgb
from invrender.prefilter.energy import power_per_degree
from invrender.theory.convolution import filtered
from invrender.theory.flatland import fourier_coefficients, reflect, synthesise, transfer_at
from invrender.theory.specialcases import microfacet_gaussian
from recon.harmonics.basis import clamped_cosine_transfer
from recon.harmonics.latlong import analyse_latlong, highest_degree, synthesise_latlong

Floats = NDArray[np.float64]

# Okabe and Ito's colours, told apart by all eyes.
COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7"]
GREY = "#666666"


def sky(height: int) -> Floats:
    """A made-up surrounding (height, 2 height, 3): blue sky with a sun, a lit window, a brick wall, dark ground."""
    directions = latlong_directions(height)
    azimuth, elevation = np.arctan2(directions[..., 1], directions[..., 0]), np.arcsin(directions[..., 2])
    radiance = np.where(
        (elevation > 0)[..., None],
        np.array([0.35, 0.55, 1.0]) * (1 - 0.5 * np.sin(elevation.clip(0)))[..., None],
        np.array([0.16, 0.13, 0.09]),
    )
    wall = (np.abs(azimuth + 1.6) < 0.9) & (np.abs(elevation - 0.1) < 0.45)
    course = np.floor((elevation + 0.35) / 0.15)
    mortar = (np.mod(azimuth + 0.15 * np.mod(course, 2), 0.3) < 0.04) | (
        np.mod(elevation + 0.35, 0.15) < 0.03
    )
    radiance[wall] = [0.42, 0.16, 0.10]
    radiance[wall & mortar] = [0.6, 0.55, 0.5]
    window = (np.abs(azimuth + 1.7) < 0.3) & (np.abs(elevation - 0.12) < 0.26)
    bars = (np.abs(azimuth + 1.7) < 0.025) | (np.abs(elevation - 0.12) < 0.025)
    radiance[window & ~bars] = [3.0, 2.4, 1.5]
    sun = np.array([np.cos(0.8) * np.cos(0.9), np.cos(0.8) * np.sin(0.9), np.sin(0.8)])
    distance = np.arccos(np.clip(directions @ sun, -1, 1))
    return np.asarray(radiance + np.exp(-((distance / 0.04) ** 2))[..., None] * np.array([60.0, 55.0, 45.0]))


def convolution() -> Figure:
    """One surrounding seen in four materials: pictures of the filtered map, clipped at 1, and power per degree."""
    height = 257
    l_max = highest_degree(height)
    lighting = analyse_latlong(sky(height), l_max)
    filters = [
        ("mirror", "reflected view", np.ones(l_max + 1)),
        ("gloss, σ = 0.05 rad", "reflected view", microfacet_gaussian(0.05, l_max)),
        ("gloss, σ = 0.2 rad", "reflected view", microfacet_gaussian(0.2, l_max)),
        ("matte, albedo 1", "normal", clamped_cosine_transfer(l_max) / np.pi),
    ]
    figure = Figure(figsize=(11, 4.3), layout="constrained")
    pictures, spectra = figure.subplots(2, 4, height_ratios=[1, 1.1])
    before = power_per_degree(lighting).mean(axis=1)
    for (name, direction, transfer), picture, spectrum in zip(filters, pictures, spectra, strict=True):
        reflected = np.asarray(filtered(lighting, transfer), float)
        radiance = synthesise_latlong(reflected, height)
        picture.imshow(linear_to_srgb(np.clip(radiance, 0, 1)), extent=(0, 360, 180, 0))
        picture.set_title(name)
        picture.set(xticks=range(0, 361, 90), yticks=range(0, 181, 90), xlabel=f"φ of the {direction} [°]")
        power = power_per_degree(reflected).mean(axis=1)
        spectrum.semilogy(before, color=COLOURS[1], label="light")
        # Odd degrees above 1 of a matte surface have none.
        spectrum.semilogy(np.where(power > 0, power, np.nan), ".", color=COLOURS[0], label="reflected")
        spectrum.set(xlabel="degree l", xlim=(-2, l_max + 2), ylim=(1e-7, 100))
    pictures[0].set_ylabel("θ [°]")
    spectra[0].set_ylabel("power per degree\n[radiance² sr, mean of RGB]")
    spectra[0].legend(loc="lower left")
    return figure


def flatland() -> Figure:
    """Reflection on a circle: light, lobe, and the reflected light by direct integration and by Fourier's product."""
    l_max, theta_o = 40, np.radians(40.0)
    circle = 2 * np.pi * np.arange(512) / 512

    def light(theta: Floats) -> Floats:
        return (
            0.3 + 3.0 * np.exp(60 * (np.cos(theta - 0.6) - 1)) + 1.2 * np.exp(12 * (np.cos(theta + 1.9) - 1))
        )

    def lobe(theta_i: Floats, theta_o: Floats) -> Floats:
        """rho^ of a glossy surface that is a little matte as well."""
        gloss = np.exp(-(((theta_i + theta_o) / 0.3) ** 2)) / (0.3 * np.sqrt(np.pi))
        return 0.7 * gloss + 0.15 * np.cos(theta_i)

    figure = Figure(figsize=(12, 3.8), layout="constrained")
    first, second, third = figure.subplots(1, 3)
    angles = np.linspace(-np.pi, np.pi, 361)
    first.plot(np.degrees(angles), light(angles), color=COLOURS[0])
    first.set(xlabel="direction θ [degrees]", ylabel="radiance L(θ)", title="The light", ylim=(0, None))
    above = np.linspace(-np.pi / 2, np.pi / 2, 181)
    transfer = lobe(above, np.array(theta_o))
    # Below the surface it is 0.
    second.plot([-180, -90, *np.degrees(above), 90, 180], [0, 0, *transfer, 0, 0], color=COLOURS[1])
    second.axvline(-40, color=GREY, linestyle=":", label="mirrored view")
    second.set(xlabel="θᵢ from the normal [degrees]", ylabel="$\\hat{ρ}$(θᵢ; θₒ = 40°)", title="The filter")
    second.legend(loc="upper right")

    coefficients = reflect(fourier_coefficients(light(circle), l_max), transfer_at(lobe, l_max, [theta_o]))
    product = synthesise(coefficients, angles)[:, 0]
    normals = angles[::15]
    integral = reflected_in_flatland(light, lobe, normals, theta_o)
    third.plot(np.degrees(angles), product, color=COLOURS[2], label="Fourier: √2π $L_l$ $\\hat{ρ}_l$(θₒ)")
    third.plot(np.degrees(normals), integral, "o", color="black", markersize=4, label="integral, eq. 2.6")
    third.set(xlabel="normal α [degrees]", ylabel="radiance B(α; θₒ = 40°)", title="The reflected light")
    third.set_ylim(0, None)
    third.legend()
    for axes in (first, second, third):
        axes.set_xticks(range(-180, 181, 90))
    return figure


def reflected_in_flatland(
    light: Callable[[Floats], Floats],
    lobe: Callable[[Floats, Floats], Floats],
    normals: Floats,
    theta_o: float,
) -> Floats:
    """[R02, eq. 2.6] by the midpoint rule."""
    theta_i = ((np.arange(2000) + 0.5) / 2000 - 0.5) * np.pi
    values = light(normals[:, None] + theta_i) * lobe(theta_i, np.array(theta_o))
    return np.asarray(values.mean(axis=1) * np.pi)


FIGURES = {
    "convolution": convolution,
    "flatland": flatland,
}


def main(folder: Path) -> None:
    """Draw them all."""
    for name, draw in FIGURES.items():
        figure = draw()
        for axes in figure.get_axes():
            _tidy(axes)
        figure.savefig(
            folder / f"theory-{name}.png", dpi=150, metadata={"Software": None}, pil_kwargs={"optimize": True}
        )


def _tidy(axes: Axes) -> None:
    """Only the lines that carry a scale; pictures keep their frame."""
    axes.spines["top"].set_visible(bool(axes.images))
    axes.spines["right"].set_visible(bool(axes.images) or axes.yaxis.get_label_position() == "right")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

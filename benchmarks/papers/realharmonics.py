"""R02's fig. 2.3: the first nine real spherical harmonics."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.papers.entry import Outcome, Workplace
from invrender.output.prefilter.figure import ball_axes
from recon.harmonics.basis import evaluate_harmonics

Floats = NDArray[np.float64]

# A view in which no harmonic shows its zero alone.
_VIEWER = np.array([0.72, -0.52, 0.46]) / np.linalg.norm([0.72, -0.52, 0.46])
# By place l (l + 1) + m: what R02's eq. 2.27 makes of real harmonics without the phase (-1)^m.
_WRITTEN = ("1", "y", "z", "x", "xy", "yz", "3z² − 1", "xz", "x² − y²")


def nine_harmonics(place: Workplace) -> Outcome:
    """R02's fig. 2.3, green above zero and blue below, and how orthonormal they are."""
    side = 90 if place.quick else 220
    figure = Figure(figsize=(9.5, 5.9), layout="constrained")
    panels = figure.subplots(3, 5)
    normals, inside = ball_axes(_VIEWER, side, False)
    values = evaluate_harmonics(normals, 2)
    largest = np.abs(values).max()
    for axes in panels.flat:
        axes.set_axis_off()
    for l in range(3):
        for m in range(-l, l + 1):
            index = l * (l + 1) + m
            _draw(panels[l, m + 2], values[:, index] / largest, inside)
            panels[l, m + 2].set_title(f"l = {l}, m = {m}\n∝ {_WRITTEN[index]}", fontsize=10)
    _draw_axes(panels[0, 0])
    panels[0, 4].text(
        0.5, 0.5, f"green: above 0\nblue: below 0\nbrightest: ±{largest:.2f}", ha="center", va="center"
    )
    off, polynomial = orthonormality_error(), _polynomial_error()
    return Outcome(
        "orthonormal; polynomials of degree l in x, y, z",
        f"orthonormal to {off:.0e}, equal to eq. 2.27's polynomials to {polynomial:.0e}",
        "The largest entry by which the 9 x 9 matrix of integrals of products differs from the unit matrix, by"
        " Gauss-Legendre quadrature in z and equal steps in azimuth. Ours are real and without the phase (-1)^m, so"
        " that Y₁₁ is positive along +x; R02's complex ones have it.",
        place.save(figure, "r02-fig2.3"),
    )


def orthonormality_error() -> float:
    """Largest difference between integrals of products of two harmonics and 0 or 1."""
    z, weight = np.polynomial.legendre.leggauss(8)
    phi = (np.arange(16) + 0.3) * np.pi / 8
    level = np.sqrt(1 - z[:, None] ** 2)
    around = np.stack([level * np.cos(phi), level * np.sin(phi), np.broadcast_to(z[:, None], (8, 16))], -1)
    values = evaluate_harmonics(around.reshape(-1, 3), 2)
    gram = (values * np.repeat(weight, 16)[:, None] * np.pi / 8).T @ values
    return float(np.abs(gram - np.eye(9)).max())


def _polynomial_error() -> float:
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, z = directions.T
    of_degree_2 = (x * y, y * z, (3 * z**2 - 1) / np.sqrt(12), x * z, (x**2 - y**2) / 2)
    written = [np.full(200, np.sqrt(1 / (4 * np.pi)))]
    written += [np.sqrt(3 / (4 * np.pi)) * each for each in (y, z, x)]
    written += [np.sqrt(15 / (4 * np.pi)) * each for each in of_degree_2]
    return float(np.abs(evaluate_harmonics(directions, 2) - np.stack(written, axis=1)).max())


def _draw(axes, values: Floats, inside: NDArray[np.bool_]) -> None:
    picture = np.ones((*inside.shape, 4))
    picture[..., 3] = inside
    # Square roots show small values.
    shade = np.sqrt(np.abs(values))[:, None]
    colour = np.where(values[:, None] > 0, [0.0, 0.85, 0.2], [0.1, 0.25, 1.0])
    picture[inside, :3] = shade * colour
    axes.imshow(picture, interpolation="nearest")


def _draw_axes(axes) -> None:
    """Where x, y and z point in these views."""
    right = np.cross([0.0, 0, 1], _VIEWER)
    right /= np.linalg.norm(right)
    up = np.cross(_VIEWER, right)
    for name, direction in zip("xyz", np.eye(3), strict=True):
        tip = np.array([direction @ right, direction @ up])
        axes.annotate("", tip, (0, 0), arrowprops={"arrowstyle": "->"})
        axes.text(*(1.2 * tip), name, ha="center", va="center")
    axes.set(xlim=(-1.4, 1.4), ylim=(-1.4, 1.4), aspect="equal")

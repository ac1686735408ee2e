"""At which roughnesses and indices columns hold transfers, and how these add up to those of any mu and sigma.

A brushed form has two widths, too many for the whole range of both: its columns hold a window of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.brushed import Brushed, Window
from invrender.brdf.form import LobeForm, Numbers, part_width
from invrender.brdf.fresnel import FresnelBasis, normalised_fresnel
from invrender.brdf.microfacet import chebyshev_nodes, chebyshev_weights, sigma_nodes, sigma_weights
from invrender.transport.form_transfer import FresnelFunctions, OneIndex

Floats = NDArray[np.float64]

# Relative step of central differences in mu and sigma.
_STEP = 1e-3
# Widths of a window, in the logarithms of sigma and of a brushed form's stretch, that take one node more than two: 1e-4
# of the lobe's peak.
_PER_NODE = (0.25, 0.4)


@dataclass(frozen=True, eq=False)
class ColumnBasis:
    """Nodes in sigma, functions for Fresnel's factor, and the weights with which both add up.

    sigmas : (j,), radians. sigma_weights : of sigma (...,), radians, to (..., j). fresnel : k functions whose sum
    Fresnel's factor is. fresnel_weights : of mu to (k,), of several mu (f,) to (f, k). splits : whether of a form that
    is a sum of lobes the single lobe is tabulated, whose widths then add up. stretches, stretch_weights : of a brushed
    form, nodes (s,), and weights of a stretch (...,) to (..., s).
    """

    sigmas: Floats
    sigma_weights: Callable[[float | Floats], Floats]
    fresnel: FresnelFunctions
    fresnel_weights: Callable[[float | Floats | None], Floats]
    splits: bool = True
    stretches: Floats | None = None
    stretch_weights: Callable[[float | Floats], Floats] | None = None

    def tabulated(self, form: LobeForm) -> tuple[LobeForm, ...]:
        """What columns hold of a form's specular part: its single lobe, at several stretches if it has any, or all."""
        if not self.splits:
            return (form,)
        if self.stretches is None:
            return (form.lobe,)
        return tuple(form.lobe.with_numbers({"stretch": stretch}) for stretch in self.stretches.tolist())

    def functions(self, form: LobeForm) -> FresnelFunctions:
        """The functions in place of Fresnel's factor that a form's columns hold."""
        return self.fresnel if form.has_fresnel else OneIndex(None)

    def weights(
        self,
        mu: float | Floats | None,
        sigma: float | Floats,
        form: LobeForm,
        numbers: Numbers | None = None,
    ) -> Floats:
        """a_k(mu) c_j(sigma), j fastest, (k * j,); of several mu and sigma (f,), (f, k * j).

        Slower than both go the stretches, if there are any.
        numbers : the form's own, one or (f,) each; those that it has if None, as columns hold them without `splits`.
        """
        parts = form.parts if numbers is None else form.parts_at(numbers)
        if not self.splits:
            parts = [(1.0, 1.0)]
        sigma = np.asarray(sigma, float)
        nodes = sum(
            np.asarray(share)[..., None] * self.sigma_weights(part_width(factor, sigma))
            for share, factor in parts
        )
        nodes = np.asarray(nodes)
        outer = self.fresnel_weights(mu) if form.has_fresnel else np.ones(1)
        if self.stretch_weights is not None:
            stretch = (form.numbers if numbers is None else numbers)["stretch"]
            outer = self.stretch_weights(stretch)[..., :, None] * outer[..., None, :]
            outer = outer.reshape(*outer.shape[:-2], -1)
        products = outer[..., :, None] * nodes[..., None, :]
        return np.asarray(products.reshape(*nodes.shape[:-1], -1))


def basis_of(form: LobeForm) -> ColumnBasis:
    """The basis that fits of a form search with: for all mu and sigma, or a brushed form's window of them."""
    if not isinstance(form, Brushed):
        return whole_range()
    if form.window is None:
        raise ValueError(f"{form.name} has no window that columns could be tabulated for")
    return _of_window(form.window)


@lru_cache(maxsize=8)
def _of_window(window: Window) -> ColumnBasis:
    """The basis for all mu, and sigma and stretch in a window."""
    sigma, stretch = window
    sigma_count, stretch_count = (
        2 + int(np.ceil(np.log(high / low) / width - 1e-6))
        for (low, high), width in zip(window, _PER_NODE, strict=True)
    )

    return ColumnBasis(
        chebyshev_nodes(sigma, sigma_count),
        partial(_share_of_sigma, sigma, sigma_count),
        whole_range().fresnel,
        whole_range().fresnel_weights,
        stretches=chebyshev_nodes(stretch, stretch_count),
        stretch_weights=partial(chebyshev_weights, stretch, stretch_count),
    )


def _share_of_sigma(window: tuple[float, float], count: int, value: float | Floats) -> Floats:
    # As over the whole range, sigma^2 times the lobe is interpolated.
    scaled = chebyshev_weights(window, count, value) * chebyshev_nodes(window, count) ** 2
    return np.asarray(scaled / np.asarray(value)[..., None] ** 2)


@lru_cache(maxsize=1)
def whole_range() -> ColumnBasis:
    """The basis for all mu and sigma between which a fit searches."""
    fresnel = FresnelBasis()
    return ColumnBasis(sigma_nodes(), sigma_weights, fresnel.functions, fresnel.coefficients)


def around(mu: float | None, sigma: float | None) -> ColumnBasis:
    """The basis for values and slopes at one mu and sigma, at a twentieth of the size of `whole_range`.

    Interpolation is quadratic, through the ends of the steps that slopes are taken over (`step_ends`). sigma : None for
    columns of the base alone.
    """
    if sigma is None:
        return ColumnBasis(np.zeros(0), partial(_always, 0), OneIndex(None), partial(_always, 1))
    low, high = step_ends(sigma)
    sigmas = np.array([low, sigma, high])
    if mu is None:
        return ColumnBasis(sigmas, _quadratic(sigmas), OneIndex(None), partial(_always, 1), splits=False)
    low, high = step_ends(mu)
    mus = (low, mu, high)
    return ColumnBasis(sigmas, _quadratic(sigmas), _Indices(mus), _quadratic(np.array(mus)), splits=False)


def _always(count: int, _: float | Floats | None) -> Floats:
    """So many weights of 1, whatever the place."""
    return np.ones(count)


def step_ends(value: float) -> tuple[float, float]:
    """Mu or sigma a small step less and a small step more."""
    step = _STEP * max(value, 0.01)
    return value - step, value + step


@dataclass(frozen=True)
class _Indices:
    """Fresnel's factors of several refractive indices."""

    mus: tuple[float, ...]

    def __call__(self, cos: Floats) -> Floats:
        """F (..., k), each relative to normal incidence, at cosines (...,)."""
        return np.stack([normalised_fresnel(mu, np.clip(cos, 0, 1)) for mu in self.mus], axis=-1)


def _quadratic(nodes: Floats) -> Callable[[float | Floats | None], Floats]:
    """Lagrange's weights (..., 3) of three nodes at any place (...,)."""
    return partial(_lagrange, nodes)


def _lagrange(nodes: Floats, place: float | Floats | None) -> Floats:
    low, middle, high = nodes
    scale = np.array(
        [(low - middle) * (low - high), (middle - low) * (middle - high), (high - low) * (high - middle)]
    )
    off = np.asarray(place, float)[..., None] - nodes
    return off[..., [1, 0, 0]] * off[..., [2, 2, 1]] / scale

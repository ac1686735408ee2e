"""The diffuse base below the lobe: Lambertian, under a smooth interface, as of plastic and varnish, or coated.

    rho = Kd t(mu, theta_i) t(mu, theta_o) + Ks F W      t = (1 - F) over its mean

The interface reflects, on either side, the more the more grazing light comes [Wolff 1994, "Diffuse-reflectance model
for smooth dielectric surfaces", eq. 4; what bounces between base and interface is in Kd]. Means are per projected solid
angle, so that pi Kd is the albedo of any base under light from all sides. One mu is the interface's and the lobe's. A
coated base has t = (1 - coat (1 - cos)^5) over its mean (`richer`), without mu.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import eval_legendre

from invrender.brdf.form import LobeForm
from invrender.brdf.fresnel import MU_RANGE, fresnel_reflectance
from invrender.theory.refinement import interval_rule
from invrender.transport.transfer import LightElement, diffuse_transfer
from invrender.transport.visibility import RayVisibility, seen_diffuse
from recon.harmonics.basis import clamped_cosine_transfer, degree_of, degrees, evaluate_harmonics

Floats = NDArray[np.float64]
# Cosines (...,) to values (..., k) of functions whose sum t is; hashable.
Passing = Callable[[Floats], Floats]

# Enough for 0.05% over the whole range of mu.
_RANK = 4
_NODES = 64


def passed(mu: float | Floats, cos: Floats) -> Floats:
    """t, what a smooth interface of relative index mu > 1 transmits at a cosine to the normal, over its mean."""
    nodes, weights = interval_rule(_NODES, 0, 1)
    mean = 2 * (1 - fresnel_reflectance(np.asarray(mu)[..., None], nodes)) @ (weights * nodes)
    return np.asarray((1 - fresnel_reflectance(mu, cos)) / mean)


def interface_transmittance(form: LobeForm, mu: float | None, cos: Floats) -> Floats:
    """What counts of light above the base at cosines to the normal: 1 above a Lambertian one, else t."""
    one = _one(form, mu)
    return np.ones(np.shape(cos)) if one is None else np.asarray(one(cos)[..., 0])


def base_share(form: LobeForm, mu: float | None, cos_i: Floats, cos_o: Floats) -> Floats:
    """The base's reflectance over Kd at cosines of incidence and exitance, which broadcast."""
    return interface_transmittance(form, mu, cos_i) * interface_transmittance(form, mu, cos_o)


@dataclass(frozen=True)
class OneInterface:
    """t of one refractive index: one function."""

    mu: float

    def __call__(self, cos: Floats) -> Floats:
        """(..., 1)."""
        return passed(self.mu, cos)[..., None]


@dataclass(frozen=True)
class OneCoat:
    """t of a coat of one strength: one function."""

    coat: float

    def __call__(self, cos: Floats) -> Floats:
        """(..., 1)."""
        even, grazing = coat_coefficients(self.coat)
        return (even + grazing * (1 - np.clip(cos, 0, 1)) ** 5)[..., None]


def coat_functions(cos: Floats) -> Floats:
    """The two functions that t of any coat is a sum of, (..., 2), at cosines to the normal."""
    return np.stack([np.ones_like(cos), (1 - np.clip(cos, 0, 1)) ** 5], axis=-1)


def coat_coefficients(coat: float | Floats) -> Floats:
    """What these count for at a strength, (2,); at several (f,), (f, 2). The mean of (1 - cos)^5 is 1/21."""
    strength = np.asarray(coat, float)
    return np.stack([np.ones_like(strength), -strength], axis=-1) / (1 - strength[..., None] / 21)


def _one(form: LobeForm, mu: float | None) -> Passing | None:
    """t of a form's base at mu; None of a Lambertian one."""
    if form.coat is not None:
        return OneCoat(form.coat)
    if not form.interface:
        return None
    assert mu is not None
    return OneInterface(mu)


class InterfaceBasis:
    """t(mu, theta) as a short sum a_k(mu) g_k(theta), so that mu leaves the sums over samples.

    The g_k are the leading singular functions of the whole family.
    """

    def __init__(self) -> None:
        self._cos = np.linspace(0, 1, 1000)
        mus = 1 + np.geomspace(MU_RANGE[0] - 1, MU_RANGE[1] - 1, 200)
        family = np.array([passed(mu, self._cos) for mu in mus])
        self._functions = np.linalg.svd(family, full_matrices=False)[2][:_RANK]

    def __call__(self, cos: Floats) -> Floats:
        """g_k, (..., k)."""
        return np.stack([np.interp(cos, self._cos, g) for g in self._functions], axis=-1)

    def coefficients(self, mu: float | Floats) -> Floats:
        """a_k(mu), (k,); of several (f,), (f, k)."""
        return passed(np.asarray(mu)[..., None], self._cos) @ self._functions.T


@lru_cache(maxsize=1)
def interface_basis() -> InterfaceBasis:
    """The one basis that columns and weights share."""
    return InterfaceBasis()


def base_size(form: LobeForm) -> int:
    """How many columns the base below a lobe takes."""
    rank = _RANK if form.interface else 1 if form.coat is None else 2
    return rank * (rank + 1) // 2


def base_columns(
    form: LobeForm, element: LightElement, normals: Floats, views: Floats, visible: RayVisibility | None
) -> Floats:
    """Radiance (m, size, channels) per unit of Kd and of the element's strength, in parts that hold no mu.

    normals, views : (m, 3) unit. visible : None where nothing is hidden.
    """
    if not form.interface and form.coat is None:
        return seen_diffuse(element, normals, visible)[:, None]
    passing: Passing = interface_basis() if form.interface else coat_functions
    return _through(passing, element, normals, views, visible)


def base_weights(form: LobeForm, mu: float | Floats | None, coat: float | Floats | None = None) -> Floats:
    """What the columns count for at mu and a coat, which is the form's own if None, (size,); at several (f,), (f,
    size).
    """
    coat = form.coat if coat is None else coat
    if coat is not None:
        found = coat_coefficients(coat)
    elif form.interface:
        assert mu is not None
        found = interface_basis().coefficients(mu)
    else:
        return np.ones((*np.shape(mu), 1)) if mu is not None else np.ones(1)
    one, other = np.triu_indices(found.shape[-1])
    return np.asarray(found[..., one] * found[..., other])


def base_irradiance(
    form: LobeForm, mu: float | None, element: LightElement, normals: Floats, visible: RayVisibility | None
) -> Floats:
    """Irradiance (m, channels), as far as it counts for the base, from a unit strength of the element."""
    one = _one(form, mu)
    return (
        seen_diffuse(element, normals, visible)
        if one is None
        else entering(one, element, normals, visible)[:, 0]
    )


def base_transfer(
    form: LobeForm,
    mu: float | None,
    element: LightElement,
    normals: Floats,
    views: Floats,
    visible: RayVisibility | None,
) -> Floats:
    """Radiance (m, channels) per unit of Kd and of the element's strength; arguments as of `base_columns`."""
    received = base_irradiance(form, mu, element, normals, visible)
    return received * interface_transmittance(form, mu, np.clip((normals * views).sum(axis=1), 0, 1))[:, None]


def base_rows(form: LobeForm, mu: float | None, normals: Floats, views: Floats, l_max: int) -> Floats:
    """Rows (m, (l_max + 1)^2) that yield the radiance per unit of Kd from unoccluded harmonic light.

    normals, views : (m, 3) unit.
    """
    out = interface_transmittance(form, mu, np.clip((normals * views).sum(axis=1), 0, 1))
    return evaluate_harmonics(normals, l_max) * sky_factors(form, mu, l_max) * out[:, None]


def sky_factors(form: LobeForm, mu: float | None, l_max: int) -> Floats:
    """By what each harmonic of unoccluded light, ((l_max + 1)^2,), counts for the base, of its value at the normal."""
    one = _one(form, mu)
    if one is None:
        return clamped_cosine_transfer(l_max)[degrees(l_max)]
    return np.asarray(_convolved(one, l_max)[degrees(l_max), 0])


def _through(
    passing: Passing, element: LightElement, normals: Floats, views: Floats, visible: RayVisibility | None
) -> Floats:
    """In through the interface and out again: (m, k (k + 1) / 2, channels), of each pair of functions."""
    inside = entering(passing, element, normals, visible)
    out = passing(np.clip((normals * views).sum(axis=1), 0, 1))[:, :, None]
    one, other = np.triu_indices(out.shape[1])
    result = inside[:, one] * out[:, other]
    mixed = one != other
    result[:, mixed] += inside[:, other[mixed]] * out[:, one[mixed]]
    return np.asarray(result)


def entering(
    passing: Passing, element: LightElement, normals: Floats, visible: RayVisibility | None
) -> Floats:
    """Irradiance (m, k, channels) by light that counts for what passes, from a unit strength of the element.

    What a mesh hides of the sky is taken to pass as the rest does: exact where it hides all or nothing.
    """
    cos = element.cosines(normals)
    falling = cos if visible is None else cos * visible.sources
    of_sources = "sc" if element.irradiances.ndim == 2 else "msc"
    result = np.einsum(f"msk,ms,{of_sources}->mkc", passing(cos), falling, element.irradiances)
    if element.diffuse_coefficients is None and not element.uniform:
        return result
    sky = _clear_sky(passing, element, normals)
    if visible is not None and visible.hidden is not None:
        clear = diffuse_transfer(element.without_sources, normals)
        sky *= np.clip(1 - visible.hidden / np.maximum(clear, 1e-12 * clear.max() + 1e-300), 0, 1)[:, None]
    return np.asarray(result + sky)


def _clear_sky(passing: Passing, element: LightElement, normals: Floats) -> Floats:
    """`entering` of all of an element's light but its sources, nothing hidden."""
    coefficients = np.zeros((1, element.channels))
    if element.diffuse_coefficients is not None:
        coefficients = element.diffuse_coefficients.copy()
    coefficients[0] += np.sqrt(4 * np.pi) * element.uniform
    l_max = degree_of(len(coefficients))
    per_degree = _convolved(passing, l_max)[degrees(l_max)]
    rows = per_degree[:, :, None] * coefficients[:, None]
    flat = evaluate_harmonics(normals, l_max) @ rows.reshape(len(rows), -1)
    return flat.reshape(len(normals), *rows.shape[1:])


@lru_cache(maxsize=8)
def _convolved(passing: Passing, l_max: int) -> Floats:
    """By how much each degree of light comes through (l_max + 1, k): clamped cosine times what passes, as a kernel."""
    nodes, weights = interval_rule(_NODES, 0, 1)
    zonal = eval_legendre(np.arange(l_max + 1)[:, None], nodes)
    return np.asarray(2 * np.pi * (zonal * (weights * nodes)) @ passing(nodes))

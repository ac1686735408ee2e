"""Prediction of radiance from a BRDF and lighting, directly and through prepared columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LobeForm
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.microfacet import SIGMA_RANGE, Microfacet
from invrender.brdf.richer import NUMBER_RANGE
from invrender.transport.column_basis import ColumnBasis, step_ends
from invrender.transport.columns import PhotoColumns, column_weights, together
from invrender.transport.diffuse_base import base_transfer
from invrender.transport.form_transfer import OneIndex, form_transfer
from invrender.transport.interpolated import InterpolatedLobe
from invrender.transport.reflected import ReflectedMap
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Rays, RayVisibility, Shadows, seen_specular
from recon.sampling.lightfield import LightField, pools

Floats = NDArray[np.float64]


def predict(
    brdf: Microfacet,
    elements: Sequence[LightElement],
    strengths: Floats,
    field: LightField,
    shadows: Shadows | None = None,
) -> Floats:
    """Radiance (n, 3) of samples, without tables or interpolation [RH01, eq. 24; its form any].

    strengths : (elements, 3). shadows : of a mesh, if it has any.
    """
    diffuse, specular = reflected(brdf, elements, strengths, field, shadows)
    return np.asarray(field.mean_over_rays(brdf.kd * diffuse + brdf.ks * specular))


def reflected(
    brdf: Microfacet,
    elements: Sequence[LightElement],
    strengths: Floats,
    field: LightField,
    shadows: Shadows | None = None,
    prepared: ReflectedMap | InterpolatedLobe | None = None,
) -> tuple[Floats, Floats]:
    """What rays (m, 3) reflect per unit of Kd, and of Ks, through filters: zero where `brdf` has no specular part.

    prepared : of the elements' map, in place of an integral for each ray.
    """
    diffuse, specular = np.zeros((2, len(field.normals), 3))
    for element, strength in zip(elements, strengths, strict=True):
        visible = None if shadows is None else shadows.visible(element, field)
        by_base, by_lobe = reflected_of(brdf, element, field, visible, prepared)
        diffuse += strength * by_base
        specular += strength * by_lobe
    return diffuse, specular


def reflected_of(
    brdf: Microfacet,
    element: LightElement,
    field: LightField,
    visible: RayVisibility | None,
    prepared: ReflectedMap | InterpolatedLobe | None = None,
) -> tuple[Floats, NDArray[np.floating]]:
    """What rays (m, channels) reflect of a unit of one element, per unit of Kd, and of Ks: `reflected` adds them up.

    visible : what the rays see of it; None where nothing is hidden.
    """
    sigma, fresnel = np.array([brdf.sigma or np.nan]), OneIndex(brdf.mu)

    def integrated(light: LightElement, normals: Floats, views: Floats) -> Floats:
        return np.asarray(form_transfer(brdf.form, light, normals, views, sigma, fresnel)[:, 0, 0])

    def gather(light: LightElement, rays: Rays) -> Floats:
        normals, views, places = field.normals[rays], field.views[rays], field.positions[rays]
        if prepared is None or light.slow_map is None:
            return integrated(light.at(places), normals, views)
        rest = integrated(replace(light, slow_map=None).at(places), normals, views)
        steep = (normals * views).sum(axis=1) < prepared.least_cos
        rest[~steep] += prepared.towards(normals[~steep], views[~steep])
        rest[steep] = integrated(light.at(places[steep]), normals[steep], views[steep])
        return rest

    here = element.at(field.positions)
    base = base_transfer(brdf.form, brdf.mu, here, field.normals, field.views, visible)
    if brdf.sigma is None or not brdf.ks.any():
        return base, np.zeros_like(base)
    return base, field.filtered(seen_specular(element, visible, gather))


def transfers(photo: PhotoColumns, brdf: Microfacet) -> tuple[Floats, Floats]:
    """Diffuse and specular transfers of a photograph's samples, (channels, n, elements) each.

    brdf : whose mu, sigma and form are taken; its form must be of the columns' family. ValueError otherwise.
    """
    if brdf.sigma is None and not photo.form.interface and photo.form.coat is None:
        diffuse = photo.columns[..., 0].astype(float)
        return diffuse, np.zeros_like(diffuse)
    if brdf.form.family is not photo.form.family or brdf.sigma is None:
        raise ValueError(f"columns of the form {photo.form.name!r} can't predict {brdf.form.name!r}")
    return _combined(photo, _weights(photo, brdf))


def transfer_slope(photo: PhotoColumns, brdf: Microfacet, name: str) -> tuple[Floats, Floats]:
    """Derivatives of `transfers` in mu, sigma or a number of the form, by central differences of the columns' weights.

    Within the search's bounds, and beyond them where the value is.
    """
    value = brdf.form.numbers[name] if name in brdf.form.numbers else getattr(brdf, name)
    low, high = {"mu": MU_RANGE, "sigma": SIGMA_RANGE, **NUMBER_RANGE}[name]
    before, after = np.clip(step_ends(value), min(low, value), max(high, value)).tolist()
    less, more = (_weights(photo, brdf.moved_to(name, end)) for end in (before, after))
    return _combined(photo, (more - less) / (after - before))


def _weights(photo: PhotoColumns, brdf: Microfacet) -> Floats:
    assert brdf.sigma is not None, "without a lobe nothing is interpolated"
    return _weights_of(brdf.mu, brdf.sigma, brdf.form, photo.basis)


# All photographs ask for those of one BRDF, and of a step away from it in each number.
@lru_cache(maxsize=64)
def _weights_of(mu: float | None, sigma: float, form: LobeForm, basis: ColumnBasis) -> Floats:
    return column_weights(mu, sigma, form, basis=basis)


def _combined(photo: PhotoColumns, weights: Floats) -> tuple[Floats, Floats]:
    """Diffuse and specular combinations (channels, n, elements) of a photograph's columns; weights : (q, 2)."""
    columns = photo.columns
    # As one matrix: of many axes numpy makes a product for each sample.
    both = (columns.reshape(-1, columns.shape[-1]) @ weights.astype(np.float32)).reshape(
        *columns.shape[:-1], 2
    )
    return both[..., 0].astype(float), both[..., 1].astype(float)


def predict_columns(photo: PhotoColumns, brdf: Microfacet, strengths: Floats) -> Floats:
    """Radiance (n, 3) of a photograph's samples through its columns, which must be of the BRDF's form."""
    diffuse, specular = transfers(photo, brdf)
    shading = brdf.kd[:, None, None] * diffuse + brdf.ks[:, None, None] * specular
    return np.einsum("cne,ec->nc", shading, strengths)


def predict_photos(
    photos: Sequence[PhotoColumns], brdf: Microfacet, strengths: Mapping[str, Floats]
) -> list[Floats]:
    """`predict_columns` of each photograph, those with few samples made together; strengths by the lighting's name."""
    found: dict[int, Floats] = {}
    for pool in pools([photo.field for photo in photos], [photo.lighting for photo in photos]):
        whole = together([photos[k] for k in pool])
        radiance = predict_columns(whole, brdf, strengths[whole.lighting])
        ends = np.cumsum([len(photos[k].field) for k in pool])
        found |= zip(pool, np.split(radiance, ends[:-1]), strict=True)
    return [found[k] for k in range(len(photos))]

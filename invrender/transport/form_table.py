"""Lobes of any form as filters of harmonic lighting.

What a lobe sends to a viewer at theta_o, per unit of Ks, is the integral over incident directions

    F W(wi, wo) cos theta_i L(wi) dwi        over  n.wi > 0,  dwi = 4 (wo.h) dh

summed over the same half-vectors as `lobetable`, where facets of all roughnesses are smooth. Here Fresnel's factor and
the shape hold azimuths and mu as well, so that nothing but the harmonics at the nodes can be kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from invrender.brdf.form import Angles, LobeForm
from invrender.brdf.fresnel import normalised_fresnel
from invrender.transport.lobe_table import (
    exitant_angles,
    half_vectors,
    lobe_radiance,
    lobe_rows,
    mean_lobe_rows,
    viewer,
)
from recon.harmonics.basis import degree_of, evaluate_harmonics, orders
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Steps of the differences that stand for derivatives in log sigma and log(mu - 1), forward ones to save a third.
_STEP = 1e-6
_ONE_AT_A_TIME = Lock()


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Half-vectors of one exitant angle.

    angles : (N,). measure : (N,), what F W cos theta_i multiplies. harmonics : (N, orders of 0 and above), of wi.
    """

    angles: Angles
    measure: Floats
    harmonics: Singles


def form_rows(field: LightField, l_max: int, form: LobeForm, mu: float | None, sigma: float) -> Singles:
    """Rows of rays over lighting coefficients, and their slopes in log sigma and log(mu - 1), (3, m, (l_max + 1)^2).

    Per unit of Ks, Fresnel's factor included, single precision, of unshadowed surfaces. Slopes are zero in what the
    form lacks.
    """
    return lobe_rows(field, _local(l_max, form, mu, sigma), _rise(field, l_max, mu))


def mean_form_rows(
    field: LightField,
    l_max: int,
    form: LobeForm,
    mu: float | None,
    sigma: float,
    seen: NDArray[np.floating] | NDArray[np.bool_],
) -> Singles:
    """`form_rows` of samples (3, n, (l_max + 1)^2), means over their rays, of which `seen` (m,) counts, 0 to 1."""
    counted = _rise(field, l_max, mu) * seen
    return mean_lobe_rows(field, _local(l_max, form, mu, sigma), [(f, counted) for f in range(3)])


def form_radiance(
    field: LightField, lighting: Floats, form: LobeForm, mu: float | None, sigma: float
) -> Floats:
    """What each ray (m, c) sees of lighting ((l_max + 1)^2, c) in the lobe, per unit of Ks with Fresnel's factor."""
    l_max = degree_of(len(lighting))
    return lobe_radiance(field, _local(l_max, form, mu, sigma)[:, 0], lighting, _rise(field, l_max, mu))


def _rise(field: LightField, l_max: int, mu: float | None) -> Floats:
    """By how much Fresnel's factor (m,) is above the table's steepest angle's; it rises too fast to be left at that.

    Some rays of a sample may be so steep.
    """
    cos = np.einsum("nk,nk->n", field.normals, field.views)
    steepest = np.cos(exitant_angles(l_max)[-1])
    return np.asarray(normalised_fresnel(mu, cos) / normalised_fresnel(mu, np.maximum(cos, steepest)))


def _local(l_max: int, form: LobeForm, mu: float | None, sigma: float) -> Floats:
    """Coefficients (J, 3, k) at the table's angles of a viewer in the local xz plane, and both slopes.

    Of orders m >= 0: of what is odd in azimuth both sides of the plane cancel.
    """
    # Who needs the same for another photograph waits for it.
    with _ONE_AT_A_TIME:
        return _computed(l_max, form, mu, sigma)


@lru_cache(maxsize=4)
def _computed(l_max: int, form: LobeForm, mu: float | None, sigma: float) -> Floats:
    def at_angle(nodes: _Nodes) -> Singles:
        values = nodes.measure * _with_slopes(nodes.angles, form, mu, sigma)
        return np.asarray(values.astype(np.float32) @ nodes.harmonics)

    return np.stack(list(parallel_map(at_angle, _nodes(l_max)))).astype(float)


def _with_slopes(angles: Angles, form: LobeForm, mu: float | None, sigma: float) -> Floats:
    """F W cos theta_i (3, N), and its slopes in log sigma and log(mu - 1)."""
    cos = np.clip(form.fresnel_cosine(angles), 0, 1)
    shape, wider = (form.shape(angles, sigma * np.exp(way)) for way in (0, _STEP))
    fresnel, change = np.ones_like(shape), np.zeros_like(shape)
    if mu is not None:
        fresnel, more = (normalised_fresnel(1 + (mu - 1) * np.exp(way), cos) for way in (0, _STEP))
        change = more - fresnel
    return np.stack([fresnel * shape, fresnel * (wider - shape) / _STEP, shape * change / _STEP])


# Those of degree 16 take up 150 MB: searches go from degree to degree, and a second computes them anew.
@lru_cache(maxsize=1)
def _nodes(l_max: int) -> tuple[_Nodes, ...]:
    return tuple(_nodes_at(float(theta_o), l_max) for theta_o in exitant_angles(l_max))


def _nodes_at(theta_o: float, l_max: int) -> _Nodes:
    theta, half, around, across = half_vectors(theta_o, l_max)
    view = viewer(theta_o)
    toward = half @ view
    measure = 4 * toward * around * across[:, None]
    counts = measure > 0
    half, toward = half[counts], toward[counts]
    incident = 2 * toward[:, None] * half - view
    angles = Angles(
        np.broadcast_to(theta[:, None], counts.shape)[counts],
        incident[:, 2],
        np.full(len(half), view[2]),
        toward,
    )
    harmonics = evaluate_harmonics(incident, l_max)[:, orders(l_max) >= 0]
    return _Nodes(angles, measure[counts], harmonics.astype(np.float32))

"""Pairs of directions over which two reflectances are compared: what pictures of a sphere under single sources show.

The mean square over pairs, weighted with d omega_i cos theta_o d omega_o, is that over the pixels of a sphere under one
source that may be anywhere. Views end at 81 degrees, as samples of photographs do.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Angles
from invrender.theory.refinement import interval_rule
from recon.sampling.draw import MIN_COS_EXITANT

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Edges of panels in theta_h, in widths of the lobe, and nodes of each; half the azimuth is one of two panels more.
_EDGES = (0.6, 1.5, 3.0, 6.0)
_NODES = 8
_AZIMUTHS = 12
_NORMAL = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Pairs:
    """Directions above the horizon.

    angles : of n pairs. views : (v,), cosines of the views that there are. view : (n,), which of them a pair has.
    solid : (n,), d omega_i. shares : (v,), cos theta_o d omega_o of each view.
    """

    angles: Angles
    views: Floats
    view: Ints
    solid: Floats
    shares: Floats

    @property
    def weights(self) -> Floats:
        """Of each pair, (n,)."""
        return self.solid * self.shares[self.view]

    def per_view(self, values: Floats) -> Floats:
        """Integrals (v, c) over d omega_i of values (n, c); of reflectance times cosine, the directional albedo."""
        columns = (np.bincount(self.view, self.solid * column, len(self.views)) for column in values.T)
        return np.stack(list(columns), axis=-1)


def direction_pairs(width: float) -> Pairs:
    """Pairs for a lobe of a width (sigma or alpha, radians)."""
    first, last = (interval_rule(_NODES, low, high) for low, high in pairwise((MIN_COS_EXITANT, 0.4, 1.0)))
    views, shares = (np.concatenate(parts) for parts in zip(first, last, strict=True))
    return pairs_at(views, shares * views, width)


def pairs_at(views: Floats, shares: Floats, width: float) -> Pairs:
    """Pairs for views of given cosines (v,), with shares (v,)."""
    half, measure = facet_directions(width)
    outgoing = np.stack([np.sqrt(1 - views**2), np.zeros_like(views), views], axis=-1)
    toward = outgoing @ half.T
    incident = 2 * toward[..., None] * half - outgoing[:, None]
    view, node = np.nonzero((incident[..., 2] > 0) & (toward > 0))
    angles = Angles.between(_NORMAL, incident[view, node], outgoing[view])
    # d omega_i = 4 (wo.h) d omega_h
    return Pairs(angles, views, view, 4 * toward[view, node] * measure[node], shares)


def facet_directions(width: float) -> tuple[Floats, Floats]:
    """Directions (n, 3) above the horizon and their d omega (n,), of facets that are so wide a lobe (radians).

    y >= 0 only: both sides of the plane of view are alike, and d omega is that of both.
    """
    theta, theta_weight = _panels(
        [0, *(edge * width for edge in _EDGES if edge * width < 1.2), np.pi / 2], _NODES
    )
    phi, phi_weight = _panels([0, np.pi / 2, np.pi], _AZIMUTHS)
    sin = np.sin(theta)[:, None]
    up = np.broadcast_to(np.cos(theta)[:, None], (len(theta), len(phi)))
    facets = np.stack([sin * np.cos(phi), sin * np.sin(phi), up], axis=-1).reshape(-1, 3)
    return facets, (2 * sin * theta_weight[:, None] * phi_weight).ravel()


def _panels(edges: list[float], nodes: int) -> tuple[Floats, Floats]:
    rules = [interval_rule(nodes, low, high) for low, high in pairwise(edges)]
    places, weights = (np.concatenate(parts) for parts in zip(*rules, strict=True))
    return places, weights

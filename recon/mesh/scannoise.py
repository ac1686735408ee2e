"""How a scan is off: displacements of a mesh's vertices along their normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.mesh.trianglemesh import TriangleMesh

Floats = NDArray[np.float64]

# Waves whose sum is a smooth random field: the covariance along a mesh is that of a Gaussian process to some percent.
_WAVES = 400


def scan_noise(mesh: TriangleMesh, std: float, correlation: float, rng: np.random.Generator) -> Floats:
    """Displacements (n,) of vertices along their normals, metres; vertices at one place move as one.

    std : metres, over draws. correlation : metres, at which distance the correlation has fallen to exp(-1/2): the noise
    is a Gaussian process with a Gaussian covariance [Rahimi and Recht 2007, "Random features for large-scale kernel
    machines"]. 0 : each vertex by itself.
    """
    # Each place once: products of matrices round equal rows differently, and seams would open.
    places, vertex = np.unique(mesh.vertices, axis=0, return_inverse=True)
    if not correlation:
        return np.asarray(std * rng.standard_normal(len(places))[vertex.ravel()])
    # About the mesh, so that far from the origin no digits are lost.
    places = places - places.mean(axis=0)
    phase = places @ (rng.standard_normal((3, _WAVES)) / correlation)
    along, across = rng.standard_normal((2, _WAVES)) / np.sqrt(_WAVES)
    return np.asarray(std * (np.cos(phase) @ along + np.sin(phase) @ across)[vertex.ravel()])

"""A sphere as a mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.mesh.trianglemesh import TriangleMesh

Floats = NDArray[np.float64]

# Rows of a sphere's triangles: they lie within 0.03% of its radius of it on the mean.
_ROWS = 64


def tessellated(centre: Floats, radius: float, rows: int = _ROWS) -> TriangleMesh:
    """A sphere of triangles between meridians and parallels; u is the azimuth over 2 pi, v rises to 1 at +Z.

    Along the first meridian and at the poles vertices are doubled.
    """
    columns = 2 * rows
    theta = np.linspace(0, np.pi, rows + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, columns + 1)
    outward = np.stack(
        np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), axis=-1
    )
    outward[:, -1] = outward[:, 0]
    outward[0], outward[-1] = [0, 0, 1], [0, 0, -1]
    u, v = np.broadcast_arrays(phi / (2 * np.pi), 1 - theta / np.pi)
    index = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    above, above_right, below, below_right = (
        part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:])
    )
    # At the poles one of a cell's two triangles has no area.
    lower = np.column_stack([above, below, below_right])[: (rows - 1) * columns]
    upper = np.column_stack([above, below_right, above_right])[columns:]
    normals = outward.reshape(-1, 3)
    return TriangleMesh(
        centre + radius * normals,
        np.concatenate([lower, upper]),
        normals,
        np.stack([u, v], axis=-1).reshape(-1, 2),
    )

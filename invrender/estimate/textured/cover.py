"""Which points of a surface the pixels of a photograph cover."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from capture.camera import Camera
from invrender.estimate.textured.layout import Layout
from recon.mesh.bodies import Body
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Two-point Gauss rule across a pixel, each way: exact for a texture that is cubic within it.
_NODES = np.array([-0.5, 0.5]) / np.sqrt(3)
# Samples whose rays are traced together.
_AT_A_TIME = 100_000


def cover(body: Body, camera: Camera, field: LightField, layout: Layout) -> csr_array:
    """How much each sample of a photograph covers of each point: (n, points), float32.

    Rows sum to 1; to zero for a sample whose rays meet no point. Four rays a pixel, each blending the points around
    where it meets the surface.
    """
    offsets = np.stack(np.meshgrid(_NODES, _NODES), axis=-1).reshape(-1, 2)
    parts = [
        _cover(body, camera, field.rows[part], field.columns[part], offsets, layout)
        for part in np.array_split(np.arange(len(field)), len(field) // _AT_A_TIME + 1)
    ]
    counts = np.concatenate([np.diff(part.indptr) for part in parts])
    return csr_array(
        (
            np.concatenate([part.data for part in parts]),
            np.concatenate([part.indices for part in parts]).astype(np.int32, copy=False),
            np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        ),
        shape=(len(field), len(layout)),
    )


def _cover(
    body: Body,
    camera: Camera,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    offsets: Floats,
    layout: Layout,
) -> csr_array:
    centres = np.column_stack([columns, rows]) + 0.5
    found = body.hits(camera, (centres[:, None] + offsets).reshape(-1, 2))
    assert found.faces is not None
    assert found.weights is not None
    points, shares = layout.places(found.faces, found.weights)
    shares = np.where((points >= 0) & found.hit[:, None], shares, 0).reshape(len(rows), -1)
    total = shares.sum(axis=1, keepdims=True)
    shares = shares / np.where(total > 0, total, 1)
    at = np.repeat(np.arange(len(rows), dtype=np.int32), shares.shape[1])
    used = shares.ravel() > 0
    entries = (shares.ravel()[used].astype(np.float32), (at[used], points.ravel()[used].astype(np.int32)))
    return csr_array(entries, shape=(len(rows), len(layout)))

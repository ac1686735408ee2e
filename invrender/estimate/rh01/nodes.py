"""A lat-long map as unknowns at its nodes: how directions look it up, and what holds its neighbours together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array

from capture.lighting import latlong_pixels

Floats = NDArray[np.float64]


def bilinear(directions: Floats, height: int) -> tuple[NDArray[np.int64], Floats]:
    """The four nodes (m, 4) around each direction in a map of 2 H^2, and their weights."""
    row, column = (place - 0.5 for place in latlong_pixels(directions, height))
    low, left = np.floor(row).astype(int), np.floor(column).astype(int)
    nodes, weights = [], []
    for down in (0, 1):
        for right in (0, 1):
            line, across = np.clip(low + down, 0, height - 1), (left + right) % (2 * height)
            nodes.append(line * 2 * height + across)
            weights.append(np.abs(1 - down - (row - low)) * np.abs(1 - right - (column - left)))
    return np.stack(nodes, axis=-1), np.stack(weights, axis=-1)


def laplacian(height: int) -> csr_array:
    """Squared differences of neighbouring nodes of a lat-long map, as a matrix (P, P).

    Along a parallel they count by how close its nodes are: near the poles few samples meet many nodes.
    """
    index = np.arange(2 * height**2).reshape(height, 2 * height)
    close = np.repeat(1 / np.sin(np.pi * (np.arange(height) + 0.5) / height), 2 * height)
    one = np.concatenate([index.ravel(), index[:-1].ravel()])
    other = np.concatenate([np.roll(index, -1, axis=1).ravel(), index[1:].ravel()])
    size = np.concatenate([close, np.ones(len(one) - len(close))])
    places = (np.tile(np.arange(len(one)), 2), np.concatenate([one, other]))
    difference = csr_array((np.concatenate([size, -size]), places), shape=(len(one), index.size))
    return csr_array(difference.T @ difference + 1e-6 * eye_array(index.size))

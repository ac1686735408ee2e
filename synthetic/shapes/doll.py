"""A turned wooden doll, as kokeshi are: a surface of revolution about z, its face towards +x.

Its texture coordinates are u = (azimuth + pi) / (2 pi), so that the seam runs down its back, and v the length
of the profile from the foot's centre, 0, to the crown, 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from recon.mesh.trianglemesh import TriangleMesh
from synthetic.shapes.surface import Points

Floats = NDArray[np.float64]

# Metres: the sphere about the origin that holds the doll.
REACH = 0.07
_CENTIMETRE = 0.01
# Height and radius of the profile from foot to crown, centimetres: foot, groove, tapered body, shoulders,
# neck, and a head that is round but a little flat.
_PROFILE = np.array(
    [
        [-6.2, 0.0],
        [-6.16, 1.3],
        [-6.05, 1.95],
        [-5.85, 2.18],
        [-5.55, 2.22],
        [-5.3, 2.1],
        [-5.15, 2.04],
        [-5.0, 2.1],
        [-4.7, 2.16],
        [-3.8, 2.06],
        [-2.6, 1.9],
        [-1.4, 1.84],
        [-0.4, 1.86],
        [0.3, 1.78],
        [0.75, 1.5],
        [1.05, 1.14],
        [1.3, 0.95],
        [1.5, 1.0],
        [1.8, 1.42],
        [2.3, 1.92],
        [3.0, 2.27],
        [3.7, 2.36],
        [4.4, 2.24],
        [5.0, 1.93],
        [5.5, 1.45],
        [5.8, 0.98],
        [6.0, 0.0],
    ]
)
# Squared radius over height, metres: at the ends it crosses zero with a finite slope, which closes the surface
# smoothly on its axis, where the radius itself rises vertically.
SQUARED_RADIUS = CubicSpline(_PROFILE[:, 0] * _CENTIMETRE, (_PROFILE[:, 1] * _CENTIMETRE) ** 2)
FOOT, CROWN = (float(height) for height in _PROFILE[[0, -1], 0] * _CENTIMETRE)


def _measured_profile() -> tuple[Floats, Floats]:
    """Heights and the profile's length up to them, metres, close enough for 1e-6 of the length."""
    # Dense at the ends as the points of a half circle are, for there the profile runs outwards.
    heights = (FOOT + CROWN) / 2 - (CROWN - FOOT) / 2 * np.cos(np.linspace(0, np.pi, 1 << 14))
    heights[[0, -1]] = FOOT, CROWN
    steps = np.hypot(np.diff(heights), np.diff(radii(heights)))
    return heights, np.concatenate([[0], np.cumsum(steps)])


def radii(heights: Floats) -> Floats:
    """The doll's radius at heights (n,), metres; zero from the crown up and from the foot down."""
    within = (heights > FOOT) & (heights < CROWN)
    return np.sqrt(np.where(within, np.maximum(SQUARED_RADIUS(heights), 0), 0))


def heights_at(v: Floats) -> Floats:
    """Heights (n,), metres, at texture coordinates v (n,), 0 to 1."""
    return np.interp(v, _LENGTHS / _LENGTHS[-1], _HEIGHTS)


def contains(points: Floats) -> NDArray[np.bool_]:
    """Whether points (n, 3), metres, lie inside the doll."""
    x, y, z = points.T
    return np.asarray((z > FOOT) & (z < CROWN) & (x**2 + y**2 < SQUARED_RADIUS(z)))


def doll_points(uv: Floats) -> Points:
    """The doll's surface at texture coordinates (n, 2), exact; tangents run around it, as turning does."""
    azimuths, heights = 2 * np.pi * uv[:, 0] - np.pi, heights_at(uv[:, 1])
    outward = np.column_stack([np.cos(azimuths), np.sin(azimuths), np.zeros(len(uv))])
    radius = radii(heights)
    positions = radius[:, None] * outward
    positions[:, 2] = heights
    # Gradient of x^2 + y^2 - squared radius, halved.
    normals = radius[:, None] * outward
    normals[:, 2] = -SQUARED_RADIUS(heights, 1) / 2
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangents = np.column_stack([-outward[:, 1], outward[:, 0], np.zeros(len(uv))])
    return Points(positions, normals, normals, tangents, uv)


def doll_mesh(edge: float) -> TriangleMesh:
    """Mesh of the doll with texture coordinates; vertices and normals are exact.

    edge : metres, the triangles' longest side but for the diagonals. The seam's vertices are doubled; at foot
    and crown each triangle has a vertex of its own, since there u is anything.
    """
    if not 0 < edge <= REACH / 4:
        raise ValueError(
            f"edge is {edge} m; it must be > 0 and at most {REACH / 4:.3g} m, a quarter of the reach"
        )
    rows = int(np.ceil(_LENGTHS[-1] / edge))
    columns = int(np.ceil(2 * np.pi * np.sqrt(SQUARED_RADIUS(_HEIGHTS).max()) / edge))
    u, v = np.meshgrid(np.arange(columns + 1) / columns, np.arange(1, rows) / rows)
    middles = (np.arange(columns) + 0.5) / columns
    ends = [np.column_stack([middles, np.full(columns, end)]) for end in (0.0, 1.0)]
    points = doll_points(np.concatenate([np.column_stack([u.ravel(), v.ravel()]), *ends]))
    positions, normals = points.positions.copy(), points.normals.copy()
    # To the last bit the same on both sides of the seam.
    seam = np.arange(rows - 1) * (columns + 1)
    positions[seam + columns], normals[seam + columns] = positions[seam], normals[seam]

    index = np.arange((rows - 1) * (columns + 1)).reshape(rows - 1, columns + 1)
    low, right = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    high, far = index[1:, :-1].ravel(), index[1:, 1:].ravel()
    foot = index.size + np.arange(columns)
    faces = np.concatenate(
        [
            np.column_stack([foot, index[0, 1:], index[0, :-1]]),
            np.column_stack([low, right, far]),
            np.column_stack([low, far, high]),
            np.column_stack([foot + columns, index[-1, :-1], index[-1, 1:]]),
        ]
    )
    return TriangleMesh(positions, faces, normals, points.uv)


_HEIGHTS, _LENGTHS = _measured_profile()

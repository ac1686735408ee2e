"""What rays meet: the surfaces that can be photographed, behind one interface."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a surface, structure of arrays.

    positions : (n, 3) metres. normals : (n, 3) unit, outward, as the surface is shaded.
    facets : (n, 3) unit, outward, of the geometry itself; differs from `normals` on meshes.
    tangents : (n, 3) unit, perpendicular to `normals`: the direction that anisotropic materials follow.
    uv : (n, 2) texture coordinates, 0 to 1, u to the right and v up; zeros where the surface has none.
    corners, shares : (n, 3) on meshes, the vertices between which a point lies, and with which weights.
    """

    positions: Floats
    normals: Floats
    facets: Floats
    tangents: Floats
    uv: Floats
    corners: NDArray[np.int64] | None = None
    shares: Floats | None = None

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, chosen: object) -> Points:
        held = {field.name: getattr(self, field.name) for field in fields(self)}
        return Points(**{name: values[chosen] for name, values in held.items() if values is not None})


class Surface(Protocol):
    """A closed surface. centre : (3,) and reach : metres, a sphere that holds all of it."""

    @property
    def centre(self) -> Floats: ...

    @property
    def reach(self) -> float: ...

    @property
    def convex(self) -> bool:
        """Whether no point shadows another, so that `occluded` needs no rays."""
        ...

    def first_hits(
        self, origins: Floats, directions: AnyFloats, facets: Floats | None = None
    ) -> tuple[NDArray[np.bool_], Points]:
        """Whether rays (n, 3), (n, 3) unit meet the surface (n,), and the points (of the k that do) they meet first.

        facets : (n, 3) as in `Points`, for rays that begin on the surface itself.
        """
        ...

    def met(self, origins: Floats, directions: AnyFloats) -> NDArray[np.bool_]:
        """Whether rays (n, 3), (n, 3) unit meet the surface (n,), as of `first_hits`."""
        ...

    def occluded(
        self,
        positions: Floats,
        facets: AnyFloats,
        directions: AnyFloats,
        distances: Floats | None = None,
    ) -> NDArray[np.bool_]:
        """Whether rays from points of the surface meet it again within `distances` (n,) metres; without them, at all.

        positions, facets : (n, 3) as in `Points`. directions : (n, 3) unit; below the facet they count as occluded.
        """
        ...

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Whether points (n, 3) lie inside."""
        ...

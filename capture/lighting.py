"""Lighting: a distant lat-long map, sources far away or near, and what of them is known.

A lat-long map has H rows and 2H columns; row r is at theta = (r + 0.5) pi / H from +Z, column c at
phi = (c + 0.5) 2 pi / W from +X towards +Y. Directions point from the object to the light.

Sources, as functions take them, are rows (k, 3), unit directions, or (k, 4) where some are near: a row (u, q) lies from
a point p in the direction of u - q p, and its irradiance there falls with the square of that vector's length. q is 0 of
a source far away, and u then its direction.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.files.imagefile import read_pixels

Floats = NDArray[np.float64]
AnyFloat = TypeVar("AnyFloat", np.float32, np.float64)


@dataclass(frozen=True, eq=False)
class Lighting:
    """One named lighting.

    radiance_map : (H, 2H, 3) float32 lat-long radiance without the sources, or None for darkness.
    directions : (k, 3) unit vectors towards the sources, as the object's centre sees them.
    irradiances : (k, 3), irradiance of each source on a plane there that faces it; ignored if to be recovered.
    recover_irradiance : the sources' irradiances are unknown; so are they fitted, per channel.
    recover_ambient : a uniform radiance from all sides, unknown, is fitted; it stands in for the map.
    origin : where it comes from, for messages: "room.exr", "mirror ball chrome.0.png", ...
    direction_std_deg : (k,), standard deviations of measured directions; None where they are given as exact.
    directions_found : whether sources were turned from where they are given to where photographs see them.
    warnings : what its measuring brought up, in plain words.
    closeness : (k,), 1 / metres, one over the distance of each source from the centre; None where all are far away.
    closeness_std : (k,), its standard deviations, infinite where no photograph tells; None where it is given.
    centre : (3,) metres, the object's; only near sources ask for it.
    """

    name: str
    radiance_map: NDArray[np.float32] | None
    directions: Floats
    irradiances: Floats
    recover_irradiance: bool = False
    recover_ambient: bool = False
    origin: str = ""
    direction_std_deg: Floats | None = None
    directions_found: bool = False
    warnings: tuple[str, ...] = ()
    closeness: Floats | None = None
    closeness_std: Floats | None = None
    centre: Floats = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        directions = np.asarray(self.directions, float).reshape(-1, 3)
        irradiances = np.asarray(self.irradiances, float).reshape(-1, 3)
        lengths = np.linalg.norm(directions, axis=1, keepdims=True)
        if not np.isfinite(directions).all() or (lengths == 0).any():
            raise ValueError(f"lighting {self.name!r}: a source direction is zero or not finite")
        if directions.shape != irradiances.shape:
            raise ValueError(
                f"lighting {self.name!r}: {len(directions)} directions but {len(irradiances)} irradiances"
            )
        if not np.isfinite(irradiances).all() or (irradiances < 0).any():
            raise ValueError(f"lighting {self.name!r}: an irradiance is negative or not finite")
        object.__setattr__(self, "directions", frozen_array(directions / lengths))
        object.__setattr__(self, "irradiances", frozen_array(irradiances))
        if self.closeness is not None:
            closeness = np.asarray(self.closeness, float)
            if closeness.shape != (len(directions),) or not (np.isfinite(closeness) & (closeness >= 0)).all():
                raise ValueError(
                    f"lighting {self.name!r}: closeness is {closeness.tolist()}; it must be a number, at least 0, of"
                    f" each of {len(directions)} sources"
                )
            object.__setattr__(self, "closeness", frozen_array(closeness))
        if self.closeness_std is not None:
            object.__setattr__(self, "closeness_std", frozen_array(self.closeness_std))
        object.__setattr__(self, "centre", frozen_array(self.centre))
        if self.radiance_map is not None:
            check_latlong(self.radiance_map, f"lighting {self.name!r}: map")
            object.__setattr__(self, "radiance_map", frozen_array(self.radiance_map, np.float32))

    @property
    def recovers(self) -> tuple[str, ...]:
        """The names, as in a manifest's `recover`, of what is fitted."""
        flags = {"irradiance": self.recover_irradiance, "ambient": self.recover_ambient}
        return tuple(name for name, recovered in flags.items() if recovered)

    @property
    def sources(self) -> Floats:
        """The sources as rows: (k, 3), or (k, 4) where some are near."""
        if self.closeness is None:
            return self.directions
        towards = self.directions + self.closeness[:, None] * self.centre
        return np.column_stack([towards, self.closeness])

    @property
    def places(self) -> tuple[tuple[Floats, Floats] | None, ...]:
        """Position (3,), metres, and intensity (3,), irradiance times metres squared, of each source; None far away."""
        if self.closeness is None:
            return (None,) * len(self.directions)
        return tuple(
            (self.centre + direction / closeness, irradiance / closeness**2) if closeness else None
            for direction, irradiance, closeness in zip(
                self.directions, self.irradiances, self.closeness, strict=True
            )
        )

    @property
    def from_afar(self) -> Lighting:
        """The same, its sources moved far away: directions and irradiances are those of the object's centre."""
        return replace(self, closeness=None, closeness_std=None)


def seen_from(sources: Floats, positions: Floats) -> tuple[Floats, Floats]:
    """Where points (m, 3) see sources, and how bright.

    Returns unit directions (m, k, 3) and factors (m, k) of irradiance; of sources (k, 3), which are far away,
    directions (k, 3) and factors (k,) for all points alike.
    """
    if sources.shape[1] == 3:
        return sources, np.ones(len(sources))
    towards = sources[:, :3] - positions[:, None] * sources[:, 3:]
    # Rays that miss the object have no place; theirs may be a source's.
    lengths = np.maximum(np.linalg.norm(towards, axis=2), 1e-9)
    return towards / lengths[..., None], 1 / lengths**2


def cosines(normals: Floats, directions: Floats) -> Floats:
    """Cosines (m, k) between normals (m, 3) and directions (k, 3), or directions (m, k, 3) of each normal's own."""
    if directions.ndim == 2:
        return np.asarray(normals @ directions.T)
    return np.einsum("mi,mki->mk", normals, directions)


def latlong_directions(height: int) -> Floats:
    """Unit directions (H, 2H, 3) of the pixel centres of a lat-long map."""
    theta = (np.arange(height) + 0.5) * np.pi / height
    phi = (np.arange(2 * height) + 0.5) * np.pi / height
    sin = np.sin(theta)[:, None]
    z = np.broadcast_to(np.cos(theta)[:, None], (height, 2 * height))
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), z], axis=-1)


def padded_latlong(
    latlong: NDArray[AnyFloat], count: int, across: NDArray[AnyFloat] | float = 1.0
) -> NDArray[AnyFloat]:
    """A map (h, 2h, c) with so many pixels more on each side: around in azimuth, across the poles in elevation.

    across : (c,), by which values are multiplied that are read across a pole.
    """
    turned = np.roll(latlong, latlong.shape[1] // 2, axis=1) * across
    rows = np.concatenate([turned[:count][::-1], latlong, turned[-count:][::-1]])
    return np.pad(rows, ((0, 0), (count, count), (0, 0)), mode="wrap").astype(latlong.dtype, copy=False)


def latlong_pixels(directions: NDArray[AnyFloat], height: int) -> tuple[NDArray[AnyFloat], NDArray[AnyFloat]]:
    """Continuous (row, column) of unit directions (..., 3), in their dtype.

    The first pixel's centre is (0.5, 0.5). Rounding can put a column at 2H, which is column 0 again.
    """
    scale = directions.dtype.type(height / np.pi)
    x, y, z = (directions[..., k] for k in range(3))
    if directions.dtype == np.float32:
        across = np.sqrt(x * x + y * y)
        return _angle(z, across) * scale, _angle(x, y) * scale
    theta = np.arccos(np.clip(z, -1, 1))
    phi = np.arctan2(y, x)
    phi = np.where(phi < 0, phi + directions.dtype.type(2 * np.pi), phi)
    return theta * scale, phi * scale


def _angle(x: NDArray[AnyFloat], y: NDArray[AnyFloat]) -> NDArray[AnyFloat]:
    """The angle of (x, y) from the x axis, 0 to 2 pi, in single precision; 0 at the origin.

    OpenCV's is good to 2e-4; Newton's step from there to rounding, in a quarter of `np.arctan2`'s time.
    """
    import cv2

    angle = np.asarray(cv2.phase(np.ravel(x), np.ravel(y)), x.dtype).reshape(x.shape)
    cos, sin = np.cos(angle), np.sin(angle)
    angle += (y * cos - x * sin) / np.maximum(x * cos + y * sin, x.dtype.type(1e-30))
    return np.maximum(angle, 0)


def latlong_solid_angles(height: int) -> Floats:
    """Exact solid angle (H, 1) in steradians of each pixel of a row; a map's pixels sum to 4 pi."""
    edges = np.cos(np.arange(height + 1) * np.pi / height)
    return ((edges[:-1] - edges[1:]) * np.pi / height)[:, None]


def check_latlong(radiance: NDArray[np.floating], where: str) -> None:
    """ValueError unless a map is (H, 2H, 3), finite and not negative."""
    height = radiance.shape[0] if radiance.ndim else 0
    if height == 0 or radiance.shape != (height, 2 * height, 3):
        size = "x".join(str(n) for n in radiance.shape[1::-1])
        raise ValueError(f"{where} is {size} pixels; a lat-long map is RGB and twice as wide as high")
    if not np.isfinite(radiance).all():
        raise ValueError(f"{where} holds {int((~np.isfinite(radiance)).sum())} values that are not finite")
    if (radiance < 0).any():
        raise ValueError(f"{where} holds negative radiance (lowest {radiance.min():.3g})")


def read_latlong(path: Path) -> NDArray[np.float32]:
    """Read a lat-long map, EXR or Radiance .hdr, (H, 2H, 3) float32 linear radiance."""
    pixels = read_pixels(path)
    if not np.issubdtype(pixels.dtype, np.floating):
        raise ValueError(f"{path}: a lighting map must be EXR or Radiance .hdr (linear), not {pixels.dtype}")
    radiance = pixels.astype(np.float32)
    check_latlong(radiance, str(path))
    if not radiance.any():
        raise ValueError(
            f"{path}: the lighting map is zero everywhere; give the map that was meant, or none where it is dark"
        )
    return radiance

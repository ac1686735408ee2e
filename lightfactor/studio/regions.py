"""Where lamps may be, as a person marks it: the map that shows the light, and what the manifest keeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.manifest import LightingTable
from capture.source_region import SourceRegion
from invrender.output.live.packed import packed
from invrender.result.saved import SavedResult
from lightfactor.studio.manifest import write_key
from lightfactor.studio.opened import Opened
from lightfactor.studio.pictures import ONE_AT_A_TIME
from recon.lighting import read_lighting

# Rows of a map where nothing is seen but lamps; and how many regions of one light make sense.
_DARK_HEIGHT, _MOST = 64, 20


def takes_regions(table: LightingTable) -> bool:
    """Whether lamps are looked for in a lighting."""
    return table.unknown or table.mirror_ball is not None


def light_seen(opened: Opened, key: str, result: SavedResult | None) -> bytes:
    """A lat-long map (H, 2H, 3) of a lighting and directions of its lamps, packed.

    As a result recovered it; without one, as the set's mirror ball shows it. ValueError where neither does.
    """
    photoset, number = opened.lighting(key)
    table = photoset.lightings[number]
    if result is not None:
        return _packed(result.read_lighting(result.lighting(table.name)))
    if table.mirror_ball is None:
        raise ValueError(f"light {table.name!r} is unknown: fit the set first, and its map is shown here")
    with ONE_AT_A_TIME:
        return _packed(read_lighting(photoset, table))


def save_regions(opened: Opened, key: str, regions: Sequence[Mapping[str, Any]]) -> None:
    """Keep where a lighting's lamps may be in the manifest; none of them removes the key.

    ValueError where one is no direction with a radius up to 180 degrees; nothing is written then.
    """
    photoset, number = opened.lighting(key)
    table = photoset.lightings[number]
    if not takes_regions(table):
        raise ValueError(f"light {table.name!r} is given: no lamps are looked for in it")
    if len(regions) > _MOST:
        raise ValueError(f"{len(regions)} source regions; mark {_MOST} at most")
    kept = []
    for region in regions:
        direction, radius = np.array(region["direction"], float), float(region["radiusDeg"])
        SourceRegion(direction, np.radians([radius]))
        kept.append({"direction": np.round(direction, 4).tolist(), "radius_deg": round(radius, 1)})
    write_key(photoset.manifest, "lighting", number, "source_regions", kept or None)


def _packed(lighting: Lighting) -> bytes:
    dark = np.zeros((_DARK_HEIGHT, 2 * _DARK_HEIGHT, 3), np.float32)
    radiance = dark if lighting.radiance_map is None else lighting.radiance_map
    arrays: dict[str, NDArray[Any]] = {
        "radiance": radiance.astype(np.float32),
        "lamps": lighting.directions.astype(np.float32),
    }
    return packed({}, arrays)

"""The light of a render: the result's own, a map, sources; as one element of the model of transfer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting, check_latlong, read_latlong
from invrender.output.render.numbers import direction, numbers
from invrender.result.saved import SavedResult
from invrender.transport.transfer import LightElement, light_elements

Floats = NDArray[np.float64]

_SOURCE = "AZIMUTH,ELEVATION,IRRADIANCE in degrees, the irradiance one number or three (30,40,1.5)"


def own_lighting(result: SavedResult, name: str | None, photo: str | None, is_own: bool = True) -> str | None:
    """Which of the result's lightings: the one that is named, or that of the photograph whose camera it is.

    is_own : whether the light is to be one of the result's at all.
    """
    if name is not None or not is_own:
        return name
    return next((entry.lighting for entry in result.content.photos if entry.file == photo), None)


def chosen_lighting(
    result: SavedResult,
    name: str | None,
    light: Path | NDArray[np.floating] | None,
    sources: Sequence[tuple[Floats, Floats]],
    panorama: bool,
) -> Lighting:
    """The lighting that is asked for: of the result by its name, or a map with sources added to it.

    light : a file, or the map itself, (H, 2H, 3). sources : direction and irradiance, (3,) each. panorama : the map is
        as cameras and other renderers have it, azimuth growing to the left of its middle; ours are mirrored against
        that.
    """
    if light is None and panorama:
        raise ValueError("--panorama says how --light is to be read; give --light")
    if light is None and not sources:
        return result.read_lighting(result.lighting(name))
    if name is not None:
        raise ValueError("--lighting names a lighting of the result; it excludes --light and --source")
    names, origin = [], ""
    radiance_map: NDArray[np.float32] | None = None
    if isinstance(light, Path):
        names.append(light.name)
        origin, radiance_map = str(light), read_latlong(light)
    elif light is not None:
        names.append("a map")
        radiance_map = np.asarray(light, np.float32)
        check_latlong(radiance_map, "--light")
    if radiance_map is not None and panorama:
        radiance_map = radiance_map[:, ::-1]
    if sources:
        names.append("a source" if len(sources) == 1 else f"{len(sources)} sources")
    directions = np.array([direction for direction, _ in sources]).reshape(-1, 3)
    irradiances = np.array([irradiance for _, irradiance in sources]).reshape(-1, 3)
    return Lighting(" and ".join(names), radiance_map, directions, irradiances, origin=origin)


def light_element(lighting: Lighting) -> LightElement:
    """A known lighting as one element; ValueError where it is dark."""
    if lighting.radiance_map is None and not lighting.irradiances.any():
        raise ValueError(f"lighting {lighting.name!r} is dark; give --light or --source")
    (element,) = light_elements(lighting)
    return element


def turned(element: LightElement, centre: Floats, degrees: float) -> LightElement:
    """An element turned about +Z through a centre (3,), counter-clockwise seen from above.

    Its sources exactly, its map between columns.
    """
    if degrees % 360 == 0:
        return element
    angle = np.radians(degrees)
    cos, sin = np.cos(angle), np.sin(angle)
    about_z = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    slow_map = element.slow_map
    if slow_map is not None:
        # What is far brighter than its surroundings is among the sources, so that mixing neighbours does no harm.
        columns = degrees / 360 * slow_map.shape[1]
        whole = int(np.floor(columns))
        share = np.float32(columns - whole)
        slow_map = (1 - share) * np.roll(slow_map, whole, axis=1) + share * np.roll(
            slow_map, whole + 1, axis=1
        )
    towards, closeness = element.directions[:, :3], element.directions[:, 3:]
    # A row (u, q) lies from a point p towards u - q p; rows without q are of sources far away.
    offsets = closeness.sum(axis=1, keepdims=True) * centre
    directions = np.column_stack([(towards - offsets) @ about_z.T + offsets, closeness])
    return replace(element, directions=directions, slow_map=slow_map)


def parse_source(text: str) -> tuple[Floats, Floats]:
    """Direction and irradiance (3,) of a source as it is written for `--source`."""
    azimuth, elevation, *irradiance = numbers(text, "--source", _SOURCE, (3, 5))
    return distant_source(azimuth, elevation, irradiance)


def distant_source(
    azimuth_deg: float, elevation_deg: float, irradiance: float | Sequence[float]
) -> tuple[Floats, Floats]:
    """Direction (3,) towards a distant source and its irradiance (3,); one number is that of all channels."""
    values = np.array(irradiance, float)
    if values.size not in (1, 3) or not np.isfinite(values).all():
        raise ValueError(f"--source: the irradiance is {irradiance}; give one number, or red, green and blue")
    if (values < 0).any():
        raise ValueError(f"--source: the irradiance is negative ({irradiance}); give 0 or more")
    return direction(azimuth_deg, elevation_deg, "--source"), np.broadcast_to(values.ravel(), 3)

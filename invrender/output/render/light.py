"""The light of a render: the result's own, a map, sources; as one element of the model of transfer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from capture.lighting import Lighting, read_latlong
from invrender.output.render.numbers import direction, numbers
from invrender.result.saved import SavedResult
from invrender.transport.transfer import LightElement, light_elements

_SOURCE = "AZIMUTH,ELEVATION,IRRADIANCE in degrees, the irradiance one number or three (30,40,1.5)"


def chosen_lighting(
    result: SavedResult, name: str | None, light: Path | None, sources: Sequence[str], panorama: bool
) -> Lighting:
    """The lighting that the options name: of the result by its name, or a map with sources added to it.

    panorama : the map is as cameras and other renderers have it, azimuth growing to the left of its middle; ours
        are mirrored against that.
    """
    if light is None and not sources:
        if panorama:
            raise ValueError("--panorama says how --light is to be read; give --light")
        return result.read_lighting(result.lighting(name))
    if name is not None:
        raise ValueError("--lighting names a lighting of the result; it excludes --light and --source")
    if light is None and panorama:
        raise ValueError("--panorama says how --light is to be read; give --light")
    names = []
    radiance_map = None
    if light is not None:
        names.append(light.name)
        radiance_map = read_latlong(light)
        radiance_map = radiance_map[:, ::-1] if panorama else radiance_map
    if sources:
        names.append("a source" if len(sources) == 1 else f"{len(sources)} sources")
    directions, irradiances = np.zeros((0, 3)), np.zeros((0, 3))
    if sources:
        parsed = [_source(text) for text in sources]
        directions = np.array([parts[0] for parts in parsed])
        irradiances = np.array([parts[1] for parts in parsed])
    return Lighting(" and ".join(names), radiance_map, directions, irradiances, origin=str(light or ""))


def light_element(lighting: Lighting) -> LightElement:
    """A known lighting as one element; ValueError where it is dark."""
    if lighting.radiance_map is None and not lighting.irradiances.any():
        raise ValueError(f"lighting {lighting.name!r} is dark; give --light or --source")
    (element,) = light_elements(lighting)
    return element


def turned(element: LightElement, degrees: float) -> LightElement:
    """An element turned about +Z, counter-clockwise seen from above; its sources exactly, its map between columns."""
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
    return replace(element, directions=element.directions @ about_z.T, slow_map=slow_map)


def _source(text: str) -> tuple[np.ndarray, np.ndarray]:
    values = numbers(text, "--source", _SOURCE, (3, 5))
    irradiance = np.array(values[2:])
    if (irradiance < 0).any():
        raise ValueError(f"--source {text}: the irradiance is negative")
    return direction(values[0], values[1], f"--source {text}"), np.broadcast_to(irradiance, 3)

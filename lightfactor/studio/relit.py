"""A result under light that the page turns: what its live picture is made of, and exact pictures of the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.files.outfolder import result_files
from capture.lighting import Lighting, read_latlong
from invrender.output.live.drawn import live_error
from invrender.output.live.packed import packed, packed_light, packed_subject
from invrender.output.live.scene import LiveScene, live_scene
from invrender.output.render.light import distant_source
from invrender.output.render.photographer import Photographer, photographer
from invrender.output.render.view import View
from invrender.result.saved import SavedResult, read_result
from recon.mesh.bodies import Body

# One picture at a time: each takes all cores.
_ONE_AT_A_TIME = Lock()
_MOST_SIDE = 1600
_MAP_SUFFIXES = (".hdr", ".exr")


@lru_cache(maxsize=2)
def _studio(result: Path, changed: float, photoset: Path | None) -> Photographer:
    """What takes pictures of a result, the last two kept. changed : when it was written."""
    saved = read_result(result)
    entry = saved.content.lighting[0]
    return photographer(saved, saved.read_lighting(entry), photoset)


@lru_cache(maxsize=4)
def _under(result: Path, changed: float, photoset: Path | None, light: str) -> Photographer:
    """The same under one of the result's lights."""
    studio = _studio(result, changed, photoset)
    return replace(studio, lighting=_lighting(studio.result, light))


@lru_cache(maxsize=4)
def _scene(result: Path, changed: float, photoset: Path | None, light: str) -> tuple[LiveScene, Lighting]:
    """A live scene under one light: the name of one of the result's, or a map's file."""
    studio = _studio(result, changed, photoset)
    lighting = _lighting(studio.result, light)
    return live_scene(studio, [lighting]), lighting


def _lighting(result: SavedResult, light: str) -> Lighting:
    if any(entry.name == light for entry in result.content.lighting):
        return result.read_lighting(result.lighting(light))
    radiance = read_latlong(Path(light))
    # As cameras and other programs have them, azimuth growing to the left.
    nothing = np.zeros((0, 3))
    return Lighting(Path(light).stem, radiance[:, ::-1], nothing, nothing, origin=light)


class Relit:
    """A result as it may be relit. photoset : its manifest, if there is one. lights : names, and files of maps."""

    def __init__(self, result: SavedResult, photoset: Path | None, maps: Sequence[Path]) -> None:
        self._key = (result.path, result.path.stat().st_mtime, photoset)
        self.lights = [entry.name for entry in result.content.lighting] + [str(path) for path in maps]

    @property
    def body(self) -> Body:
        """The object in the world."""
        with _ONE_AT_A_TIME:
            return _studio(*self._key).subject.body

    def subject(self) -> bytes:
        """Surface, reflectance and camera, packed."""
        return packed_subject(self._live(0)[0])

    def light(self, number: int) -> bytes:
        """A light, packed."""
        return packed_light(self._live(number)[0].lights[0])

    def stated(self, number: int) -> str:
        """How far live pictures under a light are off."""
        scene, lighting = self._live(number)
        with _ONE_AT_A_TIME:
            return live_error(scene, _studio(*self._key), [lighting]).stated

    def terms(self, light: str, camera: Camera, row: int, column: int) -> dict[str, list[float]]:
        """What adds up to a predicted pixel's radiance under a light, by name."""
        if not (0 <= row < camera.height and 0 <= column < camera.width):
            raise ValueError(f"pixel ({column}, {row}) is outside of {camera.width} x {camera.height}")
        with _ONE_AT_A_TIME:
            found = _under(*self._key, light).terms(camera, row, column)
        return {name: term.tolist() for name, term in zip(("base", "lobe", "bounced"), found, strict=True)}

    def still(self, state: Mapping[str, Any], size: tuple[int, int]) -> bytes:
        """What `render` makes of a state of the page: radiance over the light's unit, and coverage, packed."""
        if not all(1 <= side <= _MOST_SIDE for side in size):
            raise ValueError(f"a still of {size[0]} x {size[1]} pixels; sides are 1 to {_MOST_SIDE} pixels")
        scene, lighting = self._live(int(state["light"]))
        (light,) = scene.lights
        with _ONE_AT_A_TIME:
            own = replace(_studio(*self._key), lighting=_dimmed(lighting, state, light.unit))
            optics = own.optics(size)
            optics = replace(optics, camera=optics.camera.zoomed(float(state["zoom"])))
            view = View(float(state["azimuth"]), float(state["elevation"]), None)
            picture = own.take(own.camera(view, optics), float(state["turn"]))
        arrays: dict[str, NDArray[Any]] = {
            "radiance": (picture.radiance / light.unit).astype(np.float16),
            "coverage": picture.coverage,
        }
        return packed({"unit": light.unit}, arrays)

    def _live(self, number: int) -> tuple[LiveScene, Lighting]:
        if not 0 <= number < len(self.lights):
            raise ValueError(f"light {number}: there are {len(self.lights)}")
        with _ONE_AT_A_TIME:
            return _scene(*self._key, self.lights[number])


def keep_map(own: Path, name: str, data: bytes) -> None:
    """Keep a map of light, as a file has it, with what is the workbench's own; ValueError where it is none."""
    path = Path(name)
    if path.suffix.lower() not in _MAP_SUFFIXES or path.name != name or name.startswith("."):
        raise ValueError(f"{name!r}: a map of light is a lat-long picture, .hdr or .exr")
    folder = own / "lights"
    folder.mkdir(exist_ok=True)
    with result_files(folder / name) as place:
        (place / name).write_bytes(data)
        read_latlong(place / name)


def maps(own: Path) -> list[Path]:
    """Maps of light that are kept, by name."""
    return sorted(path for path in (own / "lights").glob("*") if path.suffix.lower() in _MAP_SUFFIXES)


def _dimmed(lighting: Lighting, state: Mapping[str, Any], unit: float) -> Lighting:
    """A lighting as the page has it: dimmed, with lamps of its own, which don't turn with it."""
    room, turn = float(state["room"]), float(state["turn"])
    lamps = [
        distant_source(lamp["azimuth"] - turn, lamp["elevation"], float(lamp["strength"]) * np.pi * unit)
        for lamp in state["lamps"]
    ]
    directions = np.array([direction for direction, _ in lamps]).reshape(-1, 3)
    irradiances = np.array([irradiance for _, irradiance in lamps]).reshape(-1, 3)
    radiance = lighting.radiance_map
    closeness = lighting.closeness
    return replace(
        lighting,
        radiance_map=None if radiance is None or room == 0 else radiance * np.float32(room),
        directions=np.concatenate([lighting.directions, directions]),
        irradiances=np.concatenate([room * lighting.irradiances, irradiances]),
        closeness=None if closeness is None else np.append(closeness, np.zeros(len(lamps))),
        closeness_std=None,
        direction_std_deg=None,
    )

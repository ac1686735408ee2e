"""Known light on held-out photographs of a set whose other light is unknown: what it scores is reflectance alone.

Under unknown light reflectance is known up to a factor per channel, and so is what it does under light of a known
strength: each element of such a light takes the factor that suits its photograph best.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.manifest import LightingTable
from capture.photoset import PhotoSet
from invrender.estimate.evidence import fit_strengths
from invrender.estimate.interreflection.correction import Sent
from invrender.estimate.quantities import FittedLighting
from invrender.estimate.solution import Solution
from invrender.transport.columns import photo_columns
from invrender.transport.transfer import LightElement, light_elements
from invrender.transport.visibility import Shadows
from recon.lighting import read_lighting
from recon.mesh.bodies import Body
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

_UP_TO_SCALE = "known up to its scale"
# Turns of strengths and what bounces by them; each leaves a share of the error that is as small as what bounces.
_TURNS = 3


@dataclass(frozen=True, eq=False)
class HeldOutLight:
    """A known lighting that only held-out photographs are under.

    lighting : as the set gives it. elements : its parts, all of free strength.
    """

    lighting: Lighting
    elements: tuple[LightElement, ...]

    def strengths(self, solution: Solution, field: LightField, shadows: Shadows | None) -> Floats:
        """Strengths (elements, 3) that suit a photograph's samples best, in the units of the reflectance."""
        form = solution.estimate.model.form
        columns = photo_columns(self.lighting.name, self.elements, field, form, shadows)
        return fit_strengths(columns, 1 / solution.noise.variance(field.radiance), solution.estimate)


def lit_by_itself(
    sent: Sent,
    name: str,
    elements: Sequence[LightElement],
    field: LightField,
    strengths: Callable[[LightField], Floats],
) -> tuple[Floats, Sent]:
    """Strengths (elements, 3) of a lighting that suit a photograph without what bounces by them, and that.

    strengths : those that suit samples best.
    """
    found = strengths(field)
    for _ in range(_TURNS):
        sent = sent.under(name, elements, found)
        found = strengths(field.less(sent.radiance(name, field)))
    return found, sent


def scored_lighting(
    lighting: Lighting, elements: Sequence[LightElement], strengths: Floats
) -> FittedLighting:
    """A lighting that only held-out photographs are under, with strengths fitted to score them; no error bars."""
    irradiances, std = lighting.irradiances.copy(), np.zeros_like(lighting.irradiances)
    radiance_map, ambient, scaled = lighting.radiance_map, None, False
    for element, strength in zip(elements, strengths, strict=True):
        if element.name == _UP_TO_SCALE:
            irradiances, std = irradiances * np.maximum(strength, 0), np.full_like(std, np.nan)
            scaled = True
            if radiance_map is not None:
                radiance_map = radiance_map * np.maximum(strength, 0)
        elif element.name.startswith("source"):
            k = int(element.name.removeprefix("source ")) - 1
            irradiances[k], std[k] = np.maximum(strength, 0), np.nan
        elif element.name == "ambient":
            ambient = strength
    ambient_std = None if ambient is None else np.full(3, np.nan)
    fitted = replace(lighting, irradiances=irradiances, radiance_map=radiance_map)
    return FittedLighting(fitted, std, ambient, ambient_std, up_to_scale=scaled)


def held_out_lights(photoset: PhotoSet, body: Body) -> Mapping[str, HeldOutLight]:
    """The known lightings beside the unknown ones of a set, by name; ValueError where a photograph under one is fitted.

    None where all are known: no lighting is given to a fit then.
    """
    tables = used_tables(photoset)
    if not any(table.unknown for table in tables):
        return {}
    fitted = {photo.lighting for photo in photoset.photos if not photo.held_out}
    found = {}
    for table in tables:
        if table.unknown:
            continue
        if table.name in fitted:
            raise ValueError(
                f"{photoset.manifest}: some photographs are under unknown light, others under {table.name!r}, of which"
                " something is known; such sets are not solved together yet: process them in sets of their own, write"
                f" unknown = true into every [[lighting]], or hold out the photographs under {table.name!r}, which then"
                " score the reflectance"
            )
        lighting = read_lighting(photoset, table, body)
        elements = [
            replace(element, name=_UP_TO_SCALE) if element.name == "known" else element
            for element in light_elements(lighting)
        ]
        found[table.name] = HeldOutLight(lighting, tuple(elements))
    return found


def used_lightings(photoset: PhotoSet, body: Body | None = None) -> dict[str, Lighting]:
    """What the set gives of the lightings that photographs are under, by name; body : as of `read_lighting`."""
    return {table.name: read_lighting(photoset, table, body) for table in used_tables(photoset)}


def used_tables(photoset: PhotoSet) -> list[LightingTable]:
    """The manifest's tables of those lightings that photographs are under."""
    used = {photo.lighting for photo in photoset.photos}
    return [table for table in photoset.lightings if table.name in used]

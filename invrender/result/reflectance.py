"""The BRDF of a saved result, ready to be used under other light; refused where the photographs left it open.

result.json holds no value for what the photographs don't determine, and none is made up here: whoever wants a picture
all the same assumes one by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.microfacet import SIGMA_RANGE, Microfacet
from invrender.estimate.identifiability import lighting_degree
from invrender.result.saved import SavedQuantity, SavedResult, nearest
from invrender.result.saved_textures import SavedTextures, read_textures

Floats = NDArray[np.float64]

# What may be assumed, and between which values the model holds.
ASSUMABLE = {"mu": MU_RANGE, "sigma": SIGMA_RANGE}
_WORDS = {"kd": "Kd", "ks": "Ks", "mu": "mu", "sigma": "sigma"}


@dataclass(frozen=True, eq=False)
class Reflectance:
    """A BRDF with its uncertainty, and what a user should know of both.

    covariance : (3, 4, 4), per channel, of (kd, ks, mu, sigma); zero for what the model lacks or what is assumed.
    assumed : the values that the user put in place of undetermined ones.
    notes : sentences.
    textures : where Kd and Ks vary over the object; those of the BRDF are then their means, without covariance.
    """

    brdf: Microfacet
    covariance: Floats
    assumed: Mapping[str, float]
    notes: tuple[str, ...]
    textures: SavedTextures | None = None


def reflectance(result: SavedResult, assumed: Mapping[str, float], means: bool = False) -> Reflectance:
    """The BRDF of a result, with values for mu or sigma where it has none.

    means : of textures only the means are taken. ValueError where a number is undetermined and not assumed, or assumed
    although it is determined.
    """
    saved = result.content.brdf
    form = saved.form
    for name, value in assumed.items():
        check_assumable(name)
        _check_assumed(result, name, value, getattr(saved, name))
    values: dict[str, Floats | None] = {}
    notes = []
    for name in _WORDS:
        quantity: SavedQuantity | None = getattr(saved, name)
        if quantity is None:
            values[name] = None
        elif name in assumed:
            values[name] = np.array(assumed[name])
            notes.append(
                f"{name} = {assumed[name]:g} is assumed: the photographs do not determine it, and the picture is"
                " no better than the guess."
            )
        elif quantity.value is None:
            raise ValueError(_undetermined(result, name))
        else:
            values[name] = np.array(quantity.value)
            if quantity.status == "weak":
                notes.append(
                    f"{_WORDS[name]} is only weakly determined; `lightfactor render --std` shows what that does."
                )
    if not result.is_absolute:
        notes.append(
            f"The result is in a relative gauge ({result.content.gauge}): only ratios of radiance within a colour"
            " channel mean anything."
        )
    ks = values["ks"]
    if ks is None and (finding := result.finding("ks")).reason:
        notes.append(f"The picture has no highlights: {finding.reason}; {finding.remedy}.")
    mu, sigma = values["mu"], values["sigma"]
    assert values["kd"] is not None
    brdf = Microfacet(
        values["kd"],
        np.zeros(3) if ks is None else ks,
        None if mu is None else float(mu),
        None if sigma is None else float(sigma),
        form,
    )
    covariance, textures = _covariance(result, assumed), read_textures(result, brdf.ks)
    if means and textures is None:
        raise ValueError(f"--mean: {result.path} has one Kd and Ks for the whole object; leave it out")
    if textures is not None and means:
        textures = None
        notes.append("Kd and Ks vary over the object; the picture has their means.")
    if textures is not None and (table := result.content.texture) is not None and table.known < 1:
        notes.append(
            f"The photographs leave Kd and Ks open on {1 - table.known:.0%} of the surface: it is transparent in the"
            " picture; --mean shows all of it, with the means."
        )
    if textures is not None:
        # The deviations of texels say all of Kd and Ks.
        covariance[:, :2] = covariance[:, :, :2] = 0
    return Reflectance(brdf, covariance, dict(assumed), tuple(notes), textures)


def assumption_notes(reflectance: Reflectance, lighting: Lighting) -> list[str]:
    """What an assumed roughness does under a lighting, in sentences."""
    sigma = reflectance.assumed.get("sigma")
    if sigma is None:
        return []
    degree = lighting_degree([lighting])
    # As where sigma is judged: a lobe passes degrees up to about 1 / sigma.
    if degree is None or degree * sigma >= 1:
        return [
            "This light is sharp enough to show the roughness: width and brightness of highlights are guesses."
        ]
    return [f"This light is so soft (degree {degree}) that little in the picture hangs on the assumed sigma."]


def check_assumable(name: str) -> None:
    """ValueError where a number is none of those that can be assumed."""
    if name not in ASSUMABLE:
        raise ValueError(f"--assume {name}: {name!r} cannot be assumed; {nearest(name, ASSUMABLE)}")


def _check_assumed(result: SavedResult, name: str, value: float, quantity: SavedQuantity | None) -> None:
    if quantity is None:
        raise ValueError(f"--assume {name}: the model of {result.path} has no {name}; leave it out")
    if quantity.value is not None:
        raise ValueError(
            f"--assume {name}: {result.path} has {name} = {quantity.value:.5g}, determined by the photographs;"
            " only what they leave undetermined can be assumed"
        )
    low, high = ASSUMABLE[name]
    if not low <= value <= high:
        raise ValueError(f"--assume {name}={value:g}: it must be between {low:g} and {high:g}")


def _undetermined(result: SavedResult, name: str) -> str:
    finding = result.finding(name)
    text = f"{result.path}: {_WORDS[name]} is undetermined, so no picture can be predicted"
    if finding.reason:
        text += f": {finding.reason}. To settle it: {finding.remedy}"
    if name in ASSUMABLE:
        text += f". To see what a guess would give: --assume {name}=VALUE"
    return text


def _covariance(result: SavedResult, assumed: Mapping[str, float]) -> Floats:
    table = result.content.brdf.covariance
    size = len(table.names)
    if [len(row) for row in table.values] != [size] * size:
        raise ValueError(f"{result.path}: brdf.covariance must have {size} rows and columns, one per name")
    values = np.array(table.values, dtype=float).reshape(size, size)
    covariance = np.zeros((3, 4, 4))
    for channel, letter in enumerate("rgb"):
        names = (f"kd.{letter}", f"ks.{letter}", "mu", "sigma")
        present = [k for k, name in enumerate(names) if name in table.names and name not in assumed]
        places = [table.names.index(names[k]) for k in present]
        covariance[channel][np.ix_(present, present)] = values[np.ix_(places, places)]
    return covariance

"""The material that is exported: a result's BRDF in absolute terms, and what a user should know of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.brdf.microfacet import Microfacet
from invrender.output.render.numbers import numbers
from invrender.result.reflectance import reflectance
from invrender.result.saved import SavedQuantity, SavedResult
from invrender.result.saved_textures import SavedTextures
from invrender.wording import with_error

Floats = NDArray[np.float64]

# What pi Kd + Ks of the brightest channel becomes where a result has no scale of its own: neither white nor dark.
_PLAUSIBLE_ALBEDO = 0.5
# Of texels: this percentile counts as the brightest, dirt and glints aside.
_BRIGHT_PERCENTILE = 99.0


@dataclass(frozen=True, eq=False)
class ExportedBRDF:
    """A BRDF to be exported.

    brdf : absolute; of textures with their means. textures : where Kd and Ks vary. scale : (3,), what Kd and Ks of the
    result were multiplied by, and light must be divided by. assumed : values that the user put in place of undetermined
    ones. notes : sentences.
    """

    brdf: Microfacet
    textures: SavedTextures | None
    scale: Floats
    assumed: Mapping[str, float]
    notes: tuple[str, ...]

    def under(self, lighting: Lighting) -> Lighting:
        """A lighting of the result as it makes the exported material look the same."""
        radiance = lighting.radiance_map
        if radiance is not None:
            radiance = (radiance / self.scale).astype(np.float32)
        return replace(lighting, radiance_map=radiance, irradiances=lighting.irradiances / self.scale)


def material_of(
    result: SavedResult, assumed: Mapping[str, float], albedo: Sequence[float] | None
) -> ExportedBRDF:
    """The material of a result.

    albedo : of a result in a relative gauge, what its pi Kd + Ks is: one number for the brightest channel, or three.
    ValueError where a number is undetermined and not assumed, or the albedo isn't free.
    """
    found = reflectance(result, assumed)
    notes = [
        f"{name} = {value:g} is assumed: the photographs do not determine it, and the material is no better than the"
        " guess."
        for name, value in found.assumed.items()
    ]
    notes += [
        _weakness(result, name, quantity)
        for name in ("kd", "ks", "mu", "sigma")
        if (quantity := getattr(result.content.brdf, name)) is not None and quantity.status == "weak"
    ]
    if found.brdf.sigma is None and (finding := result.finding("ks")).reason:
        notes.append(f"The material has no highlights: {finding.reason}; {finding.remedy}.")
    scale, note = _scale(result, found.brdf, found.textures, albedo)
    brdf = replace(found.brdf, kd=found.brdf.kd * scale, ks=found.brdf.ks * scale)
    return ExportedBRDF(brdf, _scaled(found.textures, scale), scale, found.assumed, (*notes, *note))


def _weakness(result: SavedResult, name: str, quantity: SavedQuantity) -> str:
    """What is said of a weak number that is exported, with the reason: a metal's mu has a small error."""
    values, deviations = (
        np.atleast_1d(np.array(of, float)).tolist() for of in (quantity.value, quantity.std)
    )
    text = ", ".join(with_error(value, std) for value, std in zip(values, deviations, strict=True))
    reason = result.finding(name).reason
    return f"{name} is only weakly determined ({text}){reason and f': {reason}'}; the export takes the value."


def _scale(
    result: SavedResult, brdf: Microfacet, textures: SavedTextures | None, albedo: Sequence[float] | None
) -> tuple[Floats, Sequence[str]]:
    """What Kd and Ks are multiplied by, (3,), and what is said of it."""
    if result.is_absolute:
        if albedo is not None:
            raise ValueError(
                f"--albedo: the scale of {result.path} is known ({result.content.gauge}); leave it out"
            )
        return np.ones(3), ()
    total = np.pi * brdf.kd + brdf.ks
    if textures is not None:
        texels = np.pi * textures.kd + textures.ks
        total = np.percentile(texels.reshape(-1, 3), _BRIGHT_PERCENTILE, axis=0)
    wanted = [_PLAUSIBLE_ALBEDO] if albedo is None else _checked(albedo)
    per_channel = len(wanted) == 3
    if not (total > 0).all() if per_channel else not total.max() > 0:
        raise ValueError(f"{result.path}: Kd and Ks are 0; a black object has no scale")
    scale = np.array(wanted) / total if per_channel else np.full(3, wanted[0] / total.max())
    after = "; light that is exported is divided by the same" if not per_channel else ""
    chosen = "is taken for" if albedo is None else "is"
    what = "of each channel" if per_channel else "of the brightest channel"
    return scale, (
        f"The result has no scale of its own ({result.content.gauge}): pi Kd + Ks {what} {chosen}"
        f" {', '.join(f'{value:g}' for value in wanted)}{after}."
        + (" --albedo says what it is in truth, in one number or R,G,B." if albedo is None else ""),
    )


def parse_albedo(text: str) -> list[float]:
    """An albedo as it is written for `--albedo`."""
    return numbers(text, "--albedo", "a number above 0 and below 1, or three: R,G,B", (1, 3))


def _checked(albedo: Sequence[float]) -> Sequence[float]:
    if len(albedo) not in (1, 3) or not all(0 < value < 1 for value in albedo):
        given = ", ".join(f"{value:g}" for value in albedo)
        raise ValueError(f"--albedo {given}: must be a number above 0 and below 1, or three")
    return albedo


def _scaled(textures: SavedTextures | None, scale: Floats) -> SavedTextures | None:
    if textures is None:
        return None
    return replace(
        textures,
        kd=textures.kd * scale,
        ks=textures.ks * scale,
        kd_std=textures.kd_std * scale,
        ks_std=textures.ks_std * scale,
    )

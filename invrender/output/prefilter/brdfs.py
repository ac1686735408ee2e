"""The BRDF that light is prefiltered for: a result's, a measured one, or a published one by its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.kajiya_kay import kajiya_kay
from invrender.brdf.lafortune import SKIN
from invrender.brdf.phong import mirrored_phong
from invrender.brdf.rh01 import simplified_microfacet
from invrender.inverse_brdf.measured import SUFFIXES
from invrender.inverse_brdf.table_lobe import measured_table, table_lobes
from invrender.prefilter.centred import (
    CentredBrdf,
    CentredLobe,
    lambertian_lobe,
    specular_lobe,
)
from invrender.prefilter.reflectionmap import axial_coefficients
from invrender.result.reflectance import reflectance
from invrender.result.saved import RESULT_NAME, nearest, read_result
from invrender.transport.centred_lobes import centred_microfacet

Floats = NDArray[np.float64]

_ALL = np.ones(3)


@dataclass(frozen=True)
class NamedBrdf:
    """A published BRDF. number : what its number is, or "". allowed : from, to. make : the BRDF of that number."""

    number: str
    allowed: tuple[float, float]
    make: Callable[[float], CentredBrdf]


@dataclass(frozen=True, eq=False)
class ChosenBrdf:
    """What `--brdf` names. is_absolute : whether it has a scale. notes : sentences. inputs : files that it is from."""

    brdf: CentredBrdf
    is_absolute: bool = True
    notes: tuple[str, ...] = ()
    inputs: tuple[Path, ...] = ()


def chosen_brdf(text: str, assumed: Mapping[str, float]) -> ChosenBrdf:
    """The BRDF of a result (its folder or result.json), a measured one (a file), or a named one, as "phong:32".

    assumed : mu or sigma of a result that leaves them open. ValueError where there is none of these, for numbers that
    no such BRDF has, and as `reflectance` and `measured_table`.
    """
    path = Path(text)
    if path.is_file() and path.suffix in SUFFIXES and path.name != RESULT_NAME:
        if assumed:
            raise ValueError(
                f"--assume: {path} has no open numbers; only a result can leave mu or sigma open"
            )
        return _of_table(path)
    if path.exists():
        return _of_result(path, assumed)
    name, _, number = text.partition(":")
    if name not in NAMED:
        raise ValueError(
            f"--brdf {text}: there is no such file, and no BRDF of that name: {nearest(name, NAMED)} A result is"
            f" given by the folder that `lightfactor process` wrote, or its {RESULT_NAME}; a measured BRDF by its file"
            f" ({', '.join(SUFFIXES)})"
        )
    if assumed:
        raise ValueError(f"--assume: {name!r} has no open numbers; only a result can leave mu or sigma open")
    return ChosenBrdf(NAMED[name].make(_number(text, number, NAMED[name])))


def _of_result(path: Path, assumed: Mapping[str, float]) -> ChosenBrdf:
    result = read_result(path)
    found = reflectance(result, assumed, result.content.texture is not None)
    notes = tuple(note.replace("picture", "map") for note in found.notes if "--mean" not in note)
    brdf = centred_microfacet(found.brdf, f"{result.content.name} ({result.content.brdf.model})")
    return ChosenBrdf(brdf, result.is_absolute, notes, (result.path,))


def _of_table(path: Path) -> ChosenBrdf:
    """All of a measured BRDF as one lobe about the mirrored view, as R02 has it of CURET's [R02, section 5.7.2]."""
    lobe = specular_lobe("whole", table_lobes(measured_table(path)), _ALL)
    return ChosenBrdf(CentredBrdf(f"{path.name}, as measured", (lobe,)), inputs=(path,))


def _number(text: str, given: str, named: NamedBrdf) -> float:
    if not named.number:
        if given:
            raise ValueError(f"--brdf {text}: it has no number; leave ':{given}' out")
        return 0.0
    try:
        value = float(given)
    except ValueError:
        value = np.nan
    low, high = named.allowed
    if not low <= value <= high:
        name = text.partition(":")[0]
        raise ValueError(f"--brdf {text}: give its {named.number}, {low:g} to {high:g}, as {name}:NUMBER")
    return value


def _lambertian(_: float) -> CentredBrdf:
    return CentredBrdf("Lambertian of albedo 1", (lambertian_lobe("diffuse", _ALL / np.pi),))


def _phong(exponent: float) -> CentredBrdf:
    lobe = CentredLobe("specular", (mirrored_phong(exponent),), _ALL, True)
    return CentredBrdf(f"Phong's lobe of exponent {exponent:g} [R02, eq. 5.26]", (lobe,))


def _simplified(sigma: float) -> CentredBrdf:
    lobe = CentredLobe("specular", (simplified_microfacet(sigma),), _ALL, True)
    return CentredBrdf(f"microfacets of sigma {sigma:g} rad [R02, eq. 5.34]", (lobe,))


def _skin(_: float) -> CentredBrdf:
    diffuse = lambertian_lobe("diffuse", np.array(SKIN.albedo) / np.pi)
    gloss = specular_lobe("specular", [SKIN.specular(channel) for channel in range(3)], _ALL)
    return CentredBrdf("skin, Lafortune's lobes [Marschner et al. 1999]", (diffuse, gloss))


def _fibre(exponent: float) -> CentredBrdf:
    """Scaled so that the view that sees most light sees as much as there is: across the fibre."""
    lobe = kajiya_kay(exponent)
    whole, _ = axial_coefficients(lobe, 0, 0, [0.0])
    scaled = CentredLobe("specular", (lobe,), _ALL / (np.sqrt(4 * np.pi) * whole[0, 0, 0]), False)
    return CentredBrdf(
        f"Kajiya and Kay's fibres of exponent {exponent:g}, about the tangent", (scaled,), "tangent"
    )


# By name: what its number is, and the BRDF of that.
NAMED = {
    "lambertian": NamedBrdf("", (0, 0), _lambertian),
    "phong": NamedBrdf("exponent", (0.1, 1e6), _phong),
    "microfacet": NamedBrdf("sigma in radians", (0.001, 1.5), _simplified),
    "skin": NamedBrdf("", (0, 0), _skin),
    "kajiya-kay": NamedBrdf("exponent", (0.1, 1e6), _fibre),
}

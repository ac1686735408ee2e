"""`result.json`: everything that a run found, as formats are documented in docs/formats.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import numbers, software
from capture.lighting import Lighting
from capture.polarisation import Extinction
from invrender.brdf.microfacet import Microfacet
from invrender.diagnostics.named import NamedCause
from invrender.estimate.evidence import Candidate, PictureError
from invrender.estimate.interreflection.statement import Interreflection
from invrender.estimate.quantities import FittedLighting, HarmonicLight, Quantity, ReferenceScore
from invrender.estimate.solution import Solution
from invrender.estimate.textured.layout import TexelLayout
from invrender.estimate.textured.textures import (
    KD_NAME,
    KD_STD_NAME,
    KS_NAME,
    KS_STD_NAME,
    MESH_NAME,
    FittedTextures,
)
from invrender.result.run import Run
from invrender.result.source_set import cameras_hash
from recon.harmonics.basis import to_degree
from recon.harmonics.complex import project_sources
from recon.harmonics.latlong import map_coefficients

FORMAT = 1
# The first nine coefficients are the ones that a diffuse surface sees.
_L_MAX = 2
_DARK_MAP_HEIGHT = 16


def result_document(
    run: Run,
    lighting_files: Mapping[str, str],
    inputs: Mapping[str, str],
) -> dict[str, Any]:
    """What a run found as JSON-ready data; numbers are finite or null.

    lighting_files : lighting's name -> file in the result folder. inputs : path -> "sha256:...".
    """
    solution = run.solution
    quantities = solution.quantities
    model = solution.model.estimate.model
    scalars = {
        name: quantity_entry(quantities.get(name), scalar=True) for name in ("mu", "sigma", "exponent")
    }
    fitted = [photo for photo in run.scores if not photo.held_out]
    return {
        "format": FORMAT,
        "name": run.photoset.name,
        "gauge": solution.gauge,
        "brdf": {
            "model": solution.brdf.form.name if model.specular else "lambertian",
            "specular": specular_colour(solution),
            "kd": quantity_entry(quantities["kd"]),
            "ks": quantity_entry(quantities.get("ks")),
            **scalars,
            "form_numbers": {
                name: quantity_entry(quantities[name], scalar=True)
                for name in own_numbers(solution.brdf)
                if name in quantities
            },
            "brushed_about": solution.brdf.form.axis,
            "albedo": quantity_entry(quantities.get("albedo")),
            "normalised": {
                "kd": quantity_entry(quantities.get("kd_normalised")),
                "ks": quantity_entry(quantities.get("ks_normalised")),
            },
            "covariance": {"names": list(solution.covariance_names), "values": numbers(solution.covariance)},
        },
        "object": dict(run.geometry.description),
        "texture": None if run.textures is None else _texture(run.textures),
        "lighting": [_lighting(entry, lighting_files[entry.lighting.name]) for entry in solution.lightings],
        "fit": {
            "rms_relative": run.rms(held_out=False),
            "cross_validated_rms_relative": solution.model.error,
            "held_out_rms_relative": run.rms(held_out=True),
            "samples": sum(photo.samples for photo in fitted),
            "photos": len(fitted),
            "structured_rms_relative": solution.structured,
            "noise": {"floor": solution.noise.floor, "relative": solution.noise.relative},
        },
        "photos": [
            {
                "file": photo.label,
                "lighting": photo.lighting,
                "held_out": photo.held_out,
                "samples": photo.samples,
                "rms_relative": photo.rms,
                "cross_validated_rms_relative": photo.cross_validated,
            }
            for photo in run.scores
        ],
        "interreflection": None if run.interreflection is None else _bounces(run.interreflection),
        "references": [_reference(score) for score in run.references],
        "polarisation": None if run.photoset.extinction is None else _filters(run.photoset.extinction),
        "causes": [_cause(cause) for cause in run.causes],
        "identifiability": identifiability(solution),
        "models": model_entries(solution.candidates, solution.chosen),
        "warnings": list(run.warnings),
        "timing_s": {stage: round(value, 3) for stage, value in run.seconds.items()},
        "cameras": cameras_hash(run.photoset),
        "inputs": dict(inputs),
        "software": software(),
    }


def _reference(score: ReferenceScore) -> dict[str, Any]:
    return {
        "name": score.name,
        "photo": score.photo,
        "lighting": score.lighting,
        "weight": score.weight,
        "std_relative": numbers(score.std),
        "std_relative_by": {cause: numbers(std) for cause, std in score.stds.items()},
        "predicted_over_shown": numbers(score.over_shown),
    }


def with_picture_errors(document: Mapping[str, Any], errors: Mapping[str, PictureError]) -> dict[str, Any]:
    """The result with the errors of predicted pictures, by photograph, in place of those of the samples.

    One measure for all: RMS over all unsaturated pixels of the object. What a fit that has not seen a photograph misses
    beyond one that has is known of its samples, and added.
    """
    photos = []
    for photo in document["photos"]:
        error, unseen = errors[photo["file"]], photo["cross_validated_rms_relative"]
        if unseen is not None:
            unseen = float(np.sqrt(max(error.rms**2 + unseen**2 - photo["rms_relative"] ** 2, 0)))
        photos.append(
            {
                **photo,
                "rms_relative": error.rms,
                "cross_validated_rms_relative": unseen,
                "error_in_brightest_2_percent": error.brightest,
            }
        )

    def mean(key: str, held_out: bool) -> float | None:
        values = [photo[key] for photo in photos if photo["held_out"] == held_out]
        return float(np.mean(values)) if values and None not in values else None

    fit = {
        **document["fit"],
        "rms_relative": mean("rms_relative", False),
        "cross_validated_rms_relative": mean("cross_validated_rms_relative", False),
        "held_out_rms_relative": mean("rms_relative", True),
        "error_in_brightest_2_percent": {
            "fitted": mean("error_in_brightest_2_percent", False),
            "held_out": mean("error_in_brightest_2_percent", True),
        },
    }
    return {**document, "photos": photos, "fit": fit}


def _cause(cause: NamedCause) -> dict[str, Any]:
    return {
        "cause": cause.name,
        "share": cause.share,
        "numbers": numbers(cause.numbers),
        "photo": cause.photo,
        "text": cause.text,
    }


def _texture(textures: FittedTextures) -> dict[str, Any]:
    layout = textures.layout
    return {
        "kd": KD_NAME,
        "kd_std": KD_STD_NAME,
        "ks": KS_NAME if textures.ks_varies else None,
        "ks_std": KS_STD_NAME if textures.ks_varies else None,
        "at": "texels" if isinstance(layout, TexelLayout) else "vertices",
        "side": layout.side if isinstance(layout, TexelLayout) else None,
        "known": textures.share_known,
        # The set's own mesh has the texture coordinates, unless they were made.
        "mesh": MESH_NAME if layout.made is not None else None,
    }


def _filters(extinction: Extinction) -> dict[str, Any]:
    known = extinction.origin in ("given", "found")
    return {
        "extinction": extinction.value if known else None,
        "extinction_std": extinction.std if known else None,
        "origin": extinction.origin,
    }


def _bounces(found: Interreflection) -> dict[str, Any]:
    return {
        "rms_relative": found.relative,
        "highest_relative": found.highest,
        "taken_off": found.taken_off,
        "albedo": None if found.albedo is None else numbers(found.albedo),
        "asked": {"value": found.asked, "std": found.asked_std},
        "cross_validated_rms_relative": {"taken_off": found.error_with, "left": found.error_without},
        "moved": {
            name: numbers(found.moved(name) if name in ("kd", "ks") else found.moved(name)[0])
            for name in ("kd", "ks", "mu", "sigma")
        },
    }


def specular_colour(solution: Solution) -> str | None:
    """ "neutral" if one Ks for all channels explains as much as three, "coloured" if not; None where undetermined."""
    model = solution.model.estimate.model
    if not any(candidate.estimate.model.neutral for candidate in solution.candidates) or not model.specular:
        return None
    return "neutral" if model.neutral else "coloured"


def own_numbers(brdf: Microfacet) -> tuple[str, ...]:
    """Names of the numbers of the form's own, and of those that follow from them."""
    return (*brdf.form.numbers, *(() if brdf.sigma is None else brdf.form.derived(brdf.sigma)))


def identifiability(solution: Solution) -> list[dict[str, str]]:
    """One entry per BRDF parameter: status, and where it is not determined the reason and the remedy."""
    rows = []
    for name in ("kd", "ks", "mu", "sigma"):
        quantity = solution.quantities.get(name)
        if quantity is None:
            quantity = Quantity(None, None, "undetermined", *absence(solution, name))
        rows.append(
            {
                "parameter": name,
                "status": quantity.status,
                "reason": quantity.reason,
                "remedy": quantity.remedy,
            }
        )
    return rows


def absence(solution: Solution, name: str) -> tuple[str, str]:
    """Why the chosen model lacks a parameter, and what would show whether the object needs it."""
    chosen, best = solution.model, min(solution.candidates, key=lambda candidate: candidate.error)
    what = "Fresnel factor" if name == "mu" and chosen.estimate.model.specular else "specular term"
    if solution.misfits:
        withheld = next(iter(solution.quantities.values()))
        return withheld.reason, withheld.remedy
    form = chosen.estimate.model.form
    if what == "Fresnel factor" and not form.has_fresnel:
        return (
            f"the form that explains these photographs best, {form.name}'s, has no Fresnel factor",
            "photographs with highlights at grazing angles would show whether a form that has one does better",
        )
    change = f"{chosen.error:.2%}" if best is chosen else f"{chosen.error:.2%} against {best.error:.2%}"
    reason = (
        f"these photographs need no {what}: the error on unseen photographs is {change},"
        f" within one standard error ({best.standard_error:.2%}) of the best model's"
    )
    remedy = (
        "photographs with highlights at grazing angles would show whether the object has one"
        if what == "Fresnel factor"
        else "photographs under a small, bright source, its highlight in view, would show whether the object has one"
    )
    return reason, remedy


def lighting_map(entry: FittedLighting) -> NDArray[np.float32]:
    """The lat-long map (H, 2H, 3) of a fitted lighting without its directional sources; black if there is none."""
    if entry.lighting.radiance_map is not None and not entry.lighting.recover_ambient:
        return entry.lighting.radiance_map
    dark = np.zeros((_DARK_MAP_HEIGHT, 2 * _DARK_MAP_HEIGHT, 3), np.float32)
    return dark if entry.ambient is None else dark + np.maximum(entry.ambient, 0).astype(np.float32)


def quantity_entry(quantity: Quantity | None, scalar: bool = False) -> dict[str, Any] | None:
    """A number as JSON files have it: value, std, status; scalar : of one that isn't per channel."""
    if quantity is None:
        return None
    if quantity.value is None or quantity.std is None:
        return {"value": None, "std": None, "status": quantity.status, "variance_shares": {}}
    value, std = numbers(quantity.value), numbers(quantity.std)
    undetermined = np.isnan(quantity.std).all()
    return {
        "value": value[0] if scalar else value,
        "std": None if undetermined else std[0] if scalar else std,
        "status": quantity.status,
        "variance_shares": {cause: round(share, 4) for cause, share in quantity.shares.items()},
    }


def model_entries(candidates: Sequence[Candidate], chosen: int) -> list[dict[str, Any]]:
    """The ladder of models with their evidence."""
    return [
        {
            "name": candidate.estimate.model.name,
            "parameters": candidate.parameters,
            "cross_validated_rms_relative": candidate.error,
            "standard_error": candidate.standard_error,
            "chosen": index == chosen,
        }
        for index, candidate in enumerate(candidates)
    ]


def _lighting(entry: FittedLighting, map_file: str) -> dict[str, Any]:
    lighting, harmonics = entry.lighting, entry.harmonics
    recovered = (
        [
            *lighting.recovers,
            *(["scale"] if entry.up_to_scale else []),
            *(["direction"] if lighting.directions_found else []),
            *(["distance"] if lighting.closeness_std is not None else []),
        ]
        if harmonics is None
        else ["all"]
    )
    if harmonics is None:
        coefficients = map_coefficients(lighting_map(entry), _L_MAX)
    else:
        coefficients = to_degree(harmonics.coefficients, _L_MAX)
    coefficients += project_sources(lighting.directions, lighting.irradiances, _L_MAX)
    return {
        "name": lighting.name,
        "known": not recovered,
        "recovered": recovered,
        "l_max": _L_MAX,
        "sh": {"value": numbers(coefficients), "std": numbers(_coefficient_std(entry))},
        "directional": [
            {
                "direction": numbers(direction),
                "direction_std_deg": None if std_deg is None else float(std_deg),
                "irradiance": numbers(irradiance),
                "irradiance_std": numbers(std),
                "position": None if place is None else numbers(place[0]),
                "distance_std": None if distance_std is None else float(distance_std),
            }
            for direction, std_deg, irradiance, std, place, distance_std in zip(
                lighting.directions,
                [None] * len(lighting.directions)
                if lighting.direction_std_deg is None
                else lighting.direction_std_deg,
                lighting.irradiances,
                entry.irradiance_std,
                lighting.places,
                _distance_std(lighting),
                strict=True,
            )
        ],
        "ambient": None if entry.ambient is None else numbers(entry.ambient),
        "ambient_std": None if entry.ambient_std is None else numbers(entry.ambient_std),
        "centre": None if lighting.closeness is None else numbers(lighting.centre),
        "map": map_file,
        "harmonics": None if harmonics is None else _harmonics(harmonics),
    }


def _distance_std(lighting: Lighting) -> list[float | None]:
    """Standard deviations of found distances, metres; None where none was found."""
    if lighting.closeness is None or lighting.closeness_std is None:
        return [None] * len(lighting.directions)
    known = np.isfinite(lighting.closeness_std) & (lighting.closeness > 0)
    return [
        float(std / closeness**2) if found else None
        for closeness, std, found in zip(lighting.closeness, lighting.closeness_std, known, strict=True)
    ]


def _harmonics(light: HarmonicLight) -> dict[str, Any]:
    return {
        "l_max": len(light.shares) - 1,
        "value": numbers(light.coefficients),
        "std": numbers(light.std),
        "determined_degree": light.determined_degree,
        "shares": numbers(light.shares),
        "reason": light.reason,
        "remedy": light.remedy,
    }


def _coefficient_std(entry: FittedLighting) -> NDArray[np.float64]:
    """Standard deviations of the coefficients ((l+1)^2, 3): zero for what was given, from strengths else."""
    lighting = entry.lighting
    variance = np.zeros(((_L_MAX + 1) ** 2, 3))
    for direction, std in zip(lighting.directions, entry.irradiance_std, strict=True):
        variance += project_sources(direction[None], std[None], _L_MAX) ** 2
    if entry.harmonics is not None:
        variance += to_degree(entry.harmonics.std, _L_MAX) ** 2
    if entry.ambient_std is not None:
        variance[0] += 4 * np.pi * entry.ambient_std**2
    return np.sqrt(variance)

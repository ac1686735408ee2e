"""What is said of an export: `export.json`, and what is lost, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from capture.files.documents import input_hashes, numbers, software
from capture.lighting import Lighting
from invrender.output.export.mapping import Mapping
from invrender.output.export.material import ExportedBRDF
from invrender.output.export.written import WrittenExport
from invrender.result.saved import SavedQuantity, SavedResult

# From these relative differences on a word is due: of all directions, and of uniform light reflected to one view.
_LARGE, _LARGE_ALBEDO = 0.1, 0.05


def export_document(
    result: SavedResult,
    form: str,
    material: ExportedBRDF,
    mapping: Mapping,
    written: WrittenExport,
    lighting: Lighting | None,
    notes: Sequence[str],
    inputs: Sequence[Path],
) -> dict[str, Any]:
    """export.json as JSON-ready data; numbers are finite or null."""
    saved, brdf = result.content.brdf, material.brdf
    values = {
        "kd": brdf.kd,
        "ks": brdf.ks if brdf.sigma is not None else None,
        "mu": brdf.mu,
        "sigma": brdf.sigma,
    }
    return {
        "format": 1,
        "name": result.content.name,
        "exported_as": form,
        "files": list(written.files),
        "gauge": result.content.gauge,
        "scale": numbers(material.scale),
        "brdf": {
            "model": saved.model,
            "textured": material.textures is not None,
            **{name: _quantity(value, getattr(saved, name)) for name, value in values.items()},
        },
        "material": {"model": mapping.target.model, "parameters": dict(written.parameters)},
        "lost": lost_document(mapping),
        "lighting": None if lighting is None else lighting.name,
        "notes": list(notes),
        "inputs": input_hashes(inputs),
        "software": software(),
    }


def lost_document(mapping: Mapping) -> dict[str, Any]:
    """What the mapping loses, as JSON-ready data."""
    worst = mapping.worst
    return {
        "relative_rms": mapping.relative_rms,
        "views": [
            {
                "view_deg": degrees,
                "relative_rms": rms,
                "albedo": numbers(albedo),
                "albedo_error": numbers(error),
            }
            for degrees, rms, albedo, error in zip(
                mapping.view_deg.tolist(),
                mapping.view_rms.tolist(),
                mapping.albedo,
                mapping.albedo_error,
                strict=True,
            )
        ],
        "worst": {
            "light_deg": worst.light_deg,
            "view_deg": worst.view_deg,
            "ours": worst.ours,
            "theirs": worst.theirs,
        },
    }


def lost(mapping: Mapping) -> list[str]:
    """What the mapping loses, in sentences."""
    relative = abs(mapping.albedo_error).max(axis=1) / mapping.albedo.max(axis=1)
    front, steep = mapping.view_deg.argmin(), mapping.view_deg.argmax()
    worst = mapping.worst
    return [
        f"Its material is {mapping.target.model}. Under single sources it differs from the BRDF by"
        f" {mapping.relative_rms:.1%} (RMS over all directions of light, views up to {mapping.view_deg[steep]:.0f}"
        f" degrees): {mapping.view_rms[front]:.1%} seen head-on, {mapping.view_rms[steep]:.1%} at the steepest. Under"
        f" uniform light by {relative[front]:.1%} and {relative[steep]:.1%}.",
        f"Most with light at {worst.light_deg:.0f} and the viewer at {worst.view_deg:.0f} degrees: BRDF times cosine"
        f" {worst.theirs:.3g} instead of {worst.ours:.3g} per sr.",
    ]


def warnings(mapping: Mapping) -> list[str]:
    """Where users should not trust an export, in sentences."""
    found = []
    relative = float((abs(mapping.albedo_error).max(axis=1) / mapping.albedo.max(axis=1)).max())
    if mapping.relative_rms > _LARGE or relative > _LARGE_ALBEDO:
        found.append(
            f"The mapping is coarse: {mapping.relative_rms:.0%} under single sources, up to {relative:.0%} under"
            " uniform light. export.json has it view by view."
        )
    bright = mapping.albedo.max(axis=1) > 1
    if bright.any():
        found.append(
            f"The BRDF as fitted reflects more than it receives at views beyond {mapping.view_deg[bright].min():.0f}"
            f" degrees (up to {mapping.albedo.max():.2f} times), as lobes without shadowing do, or diffuse and specular"
            " parts that together exceed 1; light that bounces there may grow without end."
        )
    return found


def _quantity(value: Any, saved: SavedQuantity | None) -> dict[str, Any] | None:
    """A value as exported, its relative deviation that of the result."""
    if value is None or saved is None:
        return None
    return {
        "value": numbers(value),
        "result_value": saved.value,
        "result_std": saved.std,
        "status": saved.status,
    }

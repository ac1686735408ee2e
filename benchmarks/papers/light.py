"""RH01's fig. 8 and 9: light recovered from photographs of a bronze sphere of known BRDF."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.ink import BLUE, ORANGE
from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.sets import photographed
from capture.decode import decode_photo
from capture.lighting import Lighting
from capture.manifest import LightingTable
from capture.photoset import load_photoset
from invrender.brdf.microfacet import Microfacet
from invrender.inverse_brdf.figure import draw_picture
from invrender.inverse_lighting.estimate import LightingChoices, LightResult, estimate_light
from invrender.inverse_lighting.figure import blurred_truth, draw_map, white_level
from invrender.inverse_lighting.known_brdf import read_brdf
from invrender.inverse_lighting.maps import coefficient_map, true_light
from invrender.process.pipeline import process
from invrender.result.truth import truth_side
from invrender.transport.harmonic_rows import lobe_blur
from invrender.transport.lobe_table import Transfer
from recon.harmonics.basis import clamped_cosine_transfer, degree_of, degrees, evaluate_harmonics
from recon.harmonics.latlong import map_coefficients
from recon.lighting import read_lighting
from recon.mesh.bodies import body_pixels, body_window
from recon.sampling.draw import NO_SOURCES, samples_at
from recon.sampling.find import find_body

Floats = NDArray[np.float64]

_SCENE = "rh01-lighting"
_SAMPLES, _FEW = 20_000, 800
HARMONICS = ("0,0", "1,-1", "1,0", "1,1", "2,-2", "2,-1", "2,0", "2,1", "2,2")


def dual_steps(place: Workplace) -> Outcome:
    """Fig. 8: diffuse part from nine coefficients, the rest as a map, and the coefficients of that map."""
    folder = _folder(place)
    found = _recovered(folder, 12, "mirror", _FEW if place.quick else _SAMPLES)
    photoset, brdf, dual = load_photoset(folder), found.brdf, found.dual
    assert dual is not None
    photo = photoset.fitted[len(photoset.fitted) // 2]
    body = find_body(photoset).body
    observed = decode_photo(photoset.radiometry, photo)
    field = samples_at(body, photo.camera, observed, *body_pixels(body, photo.camera), NO_SOURCES)
    top, left, bottom, right = body_window(body, photo.camera)
    passed = clamped_cosine_transfer(2)[degrees(2)]
    diffuse = np.zeros(observed.radiance.shape)
    values = brdf.kd * ((evaluate_harmonics(field.normals, 2) * passed) @ dual.nine)
    diffuse[field.rows, field.columns] = field.mean_over_rays(values)
    radiance, diffuse = (part[top:bottom, left:right] for part in (observed.radiance, diffuse))
    inside = diffuse.sum(axis=2) > 0
    white = float(np.quantile(radiance, 0.99))

    figure = Figure(figsize=(14, 6.4), layout="constrained")
    grid = figure.add_gridspec(2, 4, height_ratios=(1, 1.1))
    for column, (title, picture) in enumerate(
        {
            "photograph B": radiance,
            "phase 1: $B_d$ of nine $L^1_{lm}$": diffuse,
            "$B - B_d$: the specular part": np.where(inside[..., None], radiance - diffuse, 0),
        }.items()
    ):
        draw_picture(figure.add_subplot(grid[0, column]), title, np.maximum(picture, 0), white)
    axes = figure.add_subplot(grid[0, 3])
    draw_map(axes, dual.radiance, white_level(dual.radiance), "map of all specular parts")
    second = map_coefficients(dual.radiance, 2)
    assert found.truth is not None
    truth = found.truth.coefficients[:9]
    apart, off = (float(np.abs(dual.nine - other).max() / truth[0].max()) for other in (second, truth))
    axes = figure.add_subplot(grid[1, :])
    places = np.arange(9)
    axes.bar(
        places - 0.27, dual.nine[:, 1], 0.26, color=BLUE, label="$L^1_{lm}$, which give the diffuse part"
    )
    axes.bar(places, second[:, 1], 0.26, color=ORANGE, label="$L^2_{lm}$, of the map that is left")
    axes.bar(places + 0.27, truth[:, 1], 0.26, color="0.7", label="truth")
    axes.axhline(0, color="0.5", linewidth=0.8)
    axes.set_xticks(places, HARMONICS)
    axes.set(xlabel="degree, order", ylabel="coefficient, green [radiance]")
    axes.legend(fontsize="small")
    return Outcome(
        "the consistency condition is $L^1 = L^2$",
        f"both agree to {apart:.0e} of the first, and are off the truth by up to {off:.1%} of it",
        f"Nine linear equations make both sets equal. Reflections reach {dual.coverage:.0%} of directions; the map is"
        " what the coefficients say elsewhere. The method takes the lobe for a mirror, which leaves the error.",
        place.save(figure, "rh01-fig8"),
    )


def methods(place: Workplace) -> Outcome:
    """Fig. 9: the gazing sphere's light, coefficients up to l* = 12 and 20, the dual map; below, ours and the truth."""
    folder = _folder(place)
    samples = _FEW if place.quick else _SAMPLES
    printed, exact = (
        [_recovered(folder, degree, transfer, samples) for degree in (12, 20)]
        for transfer in ("mirror", "exact")
    )
    truth, brdf = exact[1].truth, exact[1].brdf
    assert truth is not None
    blurred = blurred_truth(truth, brdf)
    names = ("coefficients, l* = 12", "coefficients, l* = 20", "dual map and coefficients")
    rows = {
        "as printed": [*(coefficient_map(found.direct.values) for found in printed), _dual(printed[1])],
        "exact": [*(blurred_map(found.direct.values, brdf) for found in exact), _dual(exact[1])],
    }
    joint = blurred_truth(true_light(_joint(folder, samples)), brdf)
    ends = {
        "as printed": (
            ("real light, from a gazing sphere", true_light(_gazing_sphere(folder)).radiance_map),
            ("true light", truth.radiance_map),
        ),
        "exact": (
            (f"true light, blurred by σ = {brdf.sigma}", blurred),
            ("light and BRDF at once, blurred", joint),
        ),
    }
    white = white_level(blurred)
    figure = Figure(figsize=(21, 5.2), layout="constrained")
    for panels, (kind, maps) in zip(figure.subplots(2, 5), rows.items(), strict=True):
        first, last = ends[kind]
        titled = [(f"{name}, {kind}", picture) for name, picture in zip(names, maps, strict=True)]
        for axes, (title, picture) in zip(panels, [first, *titled, last], strict=True):
            draw_map(axes, picture, white, title)
    off = {kind: [_off(picture, blurred) for picture in maps] for kind, maps in rows.items()}
    printed_off, exact_off = ("{:.1%}, {:.1%} and {:.1%}".format(*values) for values in off.values())
    return Outcome(
        "the dual map is sharper; l* = 12 rings a little, l* = 20 is very noisy",
        f"off by {printed_off} (l* = 12, l* = 20, dual) as printed, by {exact_off} with the lobe's own transfer",
        "RMS of degrees up to 20, against the true light as the lobe blurs it. As printed, eq. 25 takes the lobe for a"
        f" mirror, which shifts and stretches the lamp. Light and BRDF found at once are off by"
        f" {_off(joint, blurred):.1%}.",
        place.save(figure, "rh01-fig9"),
    )


def _dual(found: LightResult) -> Floats:
    assert found.dual is not None
    return found.dual.radiance


def blurred_map(coefficients: Floats, brdf: Microfacet) -> Floats:
    """The map (64, 128, 3) of a light's coefficients as the lobe blurs it."""
    l_max = degree_of(len(coefficients))
    return coefficient_map(coefficients * lobe_blur(brdf, l_max)[degrees(l_max), None])


def _off(picture: Floats, truth: Floats) -> float:
    """Relative RMS of a map (H, 2H, 3) against another of any height, of degrees up to 20."""
    both = [map_coefficients(one, 20) for one in (picture, truth)]
    return float(np.sqrt(np.sum((both[0] - both[1]) ** 2) / np.sum(both[1] ** 2)))


@lru_cache(maxsize=4)
def _recovered(folder: Path, degree: int, transfer: Transfer, samples: int) -> LightResult:
    """The light of the set by coefficients up to a degree, and by the dual method."""
    truth = truth_side(folder / "truth.json").lightings[0].lighting
    photoset = load_photoset(folder)
    truths = {photoset.photos[0].lighting: truth}
    choices = LightingChoices(degree, transfer, samples)
    return estimate_light(photoset, read_brdf(folder / "truth.json"), choices, truths)[0]


def _folder(place: Workplace) -> Path:
    """The set, whose photographs of a mirror ball state its light."""
    return photographed(_SCENE, place, "ball")


def _gazing_sphere(folder: Path) -> Lighting:
    """The light that the set's photographs of a mirror ball show."""
    photoset = load_photoset(folder)
    return read_lighting(photoset, photoset.lightings[0])


def _joint(folder: Path, samples: int) -> Lighting:
    """The light of the set as `process` recovers it together with the BRDF, in the truth's scale."""
    photoset = load_photoset(folder)
    unknown = tuple(LightingTable(name=table.name, unknown=True) for table in photoset.lightings)
    found = process(replace(photoset, lightings=unknown), samples).solution.lightings[0].lighting
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["brdf"]
    # Its own is free: there Kd + Ks is 1.
    scale = 1 / (np.array(truth["kd"]) + np.array(truth["ks"]))
    assert found.radiance_map is not None
    dimmed = (found.radiance_map * scale).astype(np.float32)
    return replace(
        found, radiance_map=dimmed, irradiances=found.irradiances * scale, recover_irradiance=False
    )

"""The command `light` at work: progress on the terminal, maps, numbers and a figure on disk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.markup import escape
from rich.table import Table

from capture.files.documents import input_hashes, write_json
from capture.files.imagefile import write_exr
from capture.files.outfolder import result_folder
from capture.lighting import Lighting, read_latlong
from capture.photoset import PhotoSet, load_photoset
from capture.tasks.workplace import opened_workplace
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.inverse_lighting.coefficients import HIGHEST_DEGREE
from invrender.inverse_lighting.document import degree_errors, light_document, truth_error
from invrender.inverse_lighting.estimate import LightingChoices, LightResult, estimate_light
from invrender.inverse_lighting.figure import light_figure
from invrender.inverse_lighting.given import GivenLight, given_lights
from invrender.inverse_lighting.known_brdf import known_brdf, read_brdf
from invrender.inverse_lighting.maps import coefficient_map, coefficient_std_map
from invrender.transport.lobe_table import TRANSFERS
from recon.sampling.draw import NO_SOURCES

OWN_FILES = ("lighting.json", "lighting.png", "lighting-*.exr")
_LEAST_SAMPLES = 100


def given_brdf(
    result: Path | None, kd: str | None, ks: str | None, mu: float | None, sigma: float | None
) -> Microfacet:
    """The BRDF that the options name; ValueError for none, for two, and for what no BRDF is."""
    numbers = [
        name for name, value in (("kd", kd), ("ks", ks), ("mu", mu), ("sigma", sigma)) if value is not None
    ]
    if result is not None and numbers:
        raise ValueError(f"--brdf and --{numbers[0]} both give the BRDF; leave one of them out")
    if result is not None:
        return read_brdf(result)
    if kd is None and ks is None:
        raise ValueError(
            "the object's BRDF isn't given; name a result by --brdf, or give --kd, --ks, --mu and --sigma"
        )
    return known_brdf(_numbers(kd, "--kd"), _numbers(ks, "--ks"), mu, sigma)


def run_light(
    source: Path,
    out: Path,
    brdf: Microfacet,
    degree: int | None,
    rung: str,
    samples: int,
    truth: Path | None,
    fresh: bool = False,
) -> None:
    """Recover the lightings of a photo set into a result folder and print what was found.

    fresh : as of `opened_workplace`.
    """
    chosen = next((name for name in TRANSFERS if name == rung), None)
    if chosen is None:
        raise ValueError(f"--rung is {rung!r}; it must be one of {', '.join(TRANSFERS)}")
    if chosen != "exact" and brdf.form is not RH01_FORM:
        raise ValueError(
            f"--rung {rung} approximates RH01's lobe; the BRDF has one of the form {brdf.form.name!r}: leave --rung out"
        )
    if degree is not None and not 0 <= degree <= HIGHEST_DEGREE:
        raise ValueError(f"--degree is {degree}; it must be 0 to {HIGHEST_DEGREE}")
    if samples < _LEAST_SAMPLES:
        raise ValueError(f"--samples is {samples}; take {_LEAST_SAMPLES} or more")
    leave_cleanly_when_stopped()
    photoset = load_photoset(source)
    given = _given(photoset, truth)
    choices = LightingChoices(degree, chosen, samples)
    with result_folder(out, OWN_FILES) as folder, opened_workplace(photoset.manifest, fresh=fresh):
        lights = {name: entry.lighting for name, entry in given.items()}
        results = estimate_light(photoset, brdf, choices, lights, track)
        files = [_write_maps(folder, result, len(results) > 1) for result in results]
        light_figure(results).savefig(folder / "lighting.png")
        inputs = [photoset.manifest, *photoset.calibration_files]
        inputs += [path for photo in photoset.photos for path in (photo.file, photo.mask) if path is not None]
        given_by = ", ".join(dict.fromkeys(entry.given_by for entry in given.values()))
        document = light_document(
            photoset.name, brdf, choices, results, files, input_hashes(inputs), given_by
        )
        write_json(folder / "lighting.json", document)
    for result in results:
        _report(result, given_by)
    console.print(f"Results: {out / 'lighting.json'}   Look at it: {out / 'lighting.png'}", soft_wrap=True)


def _given(photoset: PhotoSet, truth: Path | None) -> dict[str, GivenLight]:
    """The known lights of a set, or the map that the user names for all of them."""
    if truth is None:
        return given_lights(photoset)
    light = GivenLight(Lighting("truth", read_latlong(truth), NO_SOURCES, NO_SOURCES), str(truth))
    return {photo.lighting: light for photo in photoset.photos}


def _numbers(text: str | None, option: str) -> Sequence[float]:
    if text is None:
        return [0.0]
    try:
        return [float(part) for part in text.replace(",", " ").split()]
    except ValueError as error:
        raise ValueError(f"{option} is {text!r}; give one number, or three as 0.3,0.2,0.1") from error


def _write_maps(folder: Path, result: LightResult, several: bool) -> dict[str, str]:
    """The maps of one lighting, and their names."""
    maps = {"sh": coefficient_map(result.direct.values), "std": coefficient_std_map(result.direct)}
    if result.dual is not None:
        maps |= {"dual": result.dual.radiance, "dual-std": result.dual.std}
    suffix = f"-{result.name.replace('/', '_')}" if several else ""
    names = {kind: f"lighting-{kind}{suffix}.exr" for kind in maps}
    for kind, radiance in maps.items():
        write_exr(folder / names[kind], radiance.astype(np.float32))
    return names


def _report(result: LightResult, given_by: str) -> None:
    direct, dual = result.direct, result.dual
    table = Table(
        title=escape(f"{result.name}: light up to degree {direct.degree}, from {result.samples} samples"),
        title_justify="left",
    )
    headings = ["l", "share", "", "RMS", "± std"]
    for heading in headings + (["given", "off", "off / std"] if result.truth is not None else []):
        # The longest of the statuses, which have no heading.
        table.add_column(heading, justify="right", min_width=None if heading else len("undetermined"))
    errors = degree_errors(result)
    for l, (share, status) in enumerate(zip(direct.share_per_degree, result.statuses, strict=True)):
        band = slice(l * l, (l + 1) ** 2)
        value, std = (np.sqrt(np.mean(each[band] ** 2)) for each in (direct.values, direct.std))
        shown = "-" if status == "undetermined" else f"{value:.4g}"
        row = [str(l), f"{share:.1%}", status, shown, f"{std:.2g}"]
        if errors is not None:
            true, off, ratio = errors[l]
            row += [
                f"{true:.4g}",
                *(("", "") if status == "undetermined" else (f"{off:.2g}", f"{ratio:.1f}")),
            ]
        table.add_row(*row)
    console.print(table)
    said = f"RMS residual {result.rms:.2%} of the radiance"
    unseen = [rms for _, rms in result.held_out if rms is not None]
    if unseen:
        said += f", up to {max(unseen):.2%} on {len(unseen)} held-out photographs"
    if dual is not None:
        said += f"; reflections reach {dual.coverage:.0%} of all directions"
    console.print(f"{said}.", soft_wrap=True)
    against = truth_error(result)
    if against is not None:
        said = f"the first nine coefficients are off by up to {against.nine:.4f} of L00"
        if against.dual is not None:
            said += f", those of the dual method by {against.dual:.4f}"
            said += f" ({against.dual_over_std:.1f} standard deviations, RMS)"
        console.print(
            f"Against the truth ({escape(given_by)}): {said}; errors of all are {against.over_std:.2f} standard"
            " deviations (RMS).",
            soft_wrap=True,
        )
    for warning in result.warnings:
        console.print(f"Warning: {escape(warning)}", style="yellow", soft_wrap=True)

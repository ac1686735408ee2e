"""The command `prefilter` at work: maps, coefficients and a figure on disk, orders and errors on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.markup import escape
from rich.table import Table

from capture.files.documents import write_json
from capture.files.imagefile import write_exr
from capture.files.outfolder import result_folder
from capture.lighting import read_latlong
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.output.prefilter.brdfs import chosen_brdf
from invrender.output.prefilter.document import prefilter_document
from invrender.output.prefilter.figure import prefilter_figure
from invrender.output.render.numbers import direction, numbers
from invrender.output.render.run import parse_assumed
from invrender.prefilter.bounds import ErrorBound
from invrender.prefilter.prefiltered import PrefilteredLight, PrefilteredLobe, prefilter
from recon.harmonics.basis import degree_of, degrees, orders

Singles = NDArray[np.float32]

OWN_FILES = ("prefilter.json", "prefilter.png", "*-local.exr", "*-world.exr", "*-view-*.exr")
# A share of light that is reflected above which it is said that this is too much.
_EXCESS = 1.01
# Beyond this angle to the normal lobes are streaks, which low orders hold badly.
_STEEP_DEG = 75


@dataclass(frozen=True)
class PrefilterOptions:
    """What the command line says, unread: see `lightfactor prefilter --help`."""

    light: Path
    out: Path
    brdf: str
    epsilon: float
    orders: str | None
    rows: int | None
    views: tuple[str, ...]
    panorama: bool
    assume: tuple[str, ...]


def run_prefilter(options: PrefilterOptions) -> None:
    """Prefilter a map into a result folder and print what was chosen and what is left out."""
    if not 0 < options.epsilon < 1:
        raise ValueError(f"--epsilon is {options.epsilon}; the share of energy must be above 0 and below 1")
    if options.rows is not None and options.rows < 2:
        raise ValueError(f"--rows is {options.rows}; a map has 2 or more")
    given = None if options.orders is None else _orders(options.orders)
    views = [_view(text) for text in options.views]
    chosen = chosen_brdf(options.brdf, parse_assumed(options.assume))
    light = read_latlong(options.light)
    if options.panorama:
        light = light[:, ::-1]
    leave_cleanly_when_stopped()
    with result_folder(options.out, OWN_FILES) as folder:
        (found,) = track(
            (
                prefilter(light, chosen.brdf, options.epsilon, given, options.rows, chosen.is_absolute)
                for _ in range(1)
            ),
            "Prefiltering",
        )
        directions = [direction(*view, "--view") for view in views]
        files = {
            each.lobe.name: _write_maps(folder, each, directions)
            for each in track(found.lobes, "Writing maps")
        }
        warnings = [*chosen.notes, *_warnings(found, chosen.is_absolute)]
        prefilter_figure(options.light.name, light, found, directions[0]).savefig(folder / "prefilter.png")
        epsilon = options.epsilon if given is None else None
        document = prefilter_document(options.light, chosen, found, epsilon, views, files, warnings)
        write_json(folder / "prefilter.json", document)
    _report(options, found, warnings)


def _write_maps(
    folder: Path, each: PrefilteredLobe, viewers: Sequence[NDArray[np.float64]]
) -> dict[str, Any]:
    """The maps of a lobe, and their names."""
    names = {kind: f"{each.lobe.name}-{kind}.exr" for kind in ("local", "world")}
    _write_terms(folder / names["local"], each.local.maps)
    _write_terms(folder / names["world"], each.world.maps)
    seen = [f"{each.lobe.name}-view-{k}.exr" for k in range(1, len(viewers) + 1)]
    for name, viewer in zip(seen, viewers, strict=True):
        write_exr(folder / name, each.seen_from(viewer).transpose(1, 2, 0))
    return {**names, "views": seen}


def _write_terms(path: Path, maps: Singles) -> None:
    """An EXR whose R, G, B is the term of degree 0, and whose layers p1q-1, p1q0, ... are the others."""
    p_max = degree_of(len(maps))
    named = zip(degrees(p_max).tolist(), orders(p_max).tolist(), maps.transpose(0, 2, 3, 1), strict=True)
    layers = {f"p{p}q{q}": term for p, q, term in named if p}
    write_exr(path, maps[0].transpose(1, 2, 0), layers=layers)


def _warnings(found: PrefilteredLight, is_absolute: bool) -> list[str]:
    angles = np.degrees(np.arccos(found.bound.cos_angles))
    above = (found.albedo > _EXCESS).any(axis=1)
    if not is_absolute or not above.any():
        return []
    worst = float(found.albedo.max())
    return [
        f"Seen at some angles from {angles[above].min():.0f} degrees on, this BRDF reflects up to {worst:.2f}"
        " times the light that it receives; its formula does, and the maps show it."
    ]


def _report(options: PrefilterOptions, found: PrefilteredLight, warnings: Sequence[str]) -> None:
    table = Table(title=escape(f"{options.light.name} for {found.brdf.description}"), title_justify="left")
    for heading in ("lobe", "about", "F", "P", "rows", "energy left out", "RMS left out", "never more than"):
        table.add_column(heading, justify="left" if heading in ("lobe", "about") else "right")
    for each in found.lobes:
        rms, most = (_relative(each.bound, which) for which in ("picture_rms", "picture_largest"))
        about = "mirrored view" if each.lobe.mirrored else found.brdf.axis
        f, p = each.orders
        rows = str(each.local.maps.shape[2])
        table.add_row(
            each.lobe.name, about, str(f), str(p), rows, f"{each.left_out:.2%}", f"{rms:.1%}", f"{most:.0%}"
        )
    console.print(table)
    both = [_relative(found.bound, which) for which in ("picture_rms", "picture_largest")]
    ball = found.brdf.axis == "normal"
    said = "A ball in this light is" if ball else "Fibres in this light are"
    said += f" off by {both[0]:.1%} of the radiance (RMS over pixels and views)"
    if ball:
        said += (
            f", up to {_STEEP_DEG} degrees by {_relative(found.bound.up_to(_STEEP_DEG), 'picture_rms'):.1%}"
        )
    between = max(each.between_pixels for each in found.lobes)
    console.print(
        f"{said}, in no view by more than {both[1]:.0%}; between the maps' pixels by up to {between:.1%} of the largest"
        " value more.",
        soft_wrap=True,
    )
    for warning in warnings:
        console.print(f"Warning: {escape(warning)}", style="yellow", soft_wrap=True)
    console.print(
        f"Maps: {options.out / 'prefilter.json'}   Look at it: {options.out / 'prefilter.png'}",
        soft_wrap=True,
    )


def _relative(bound: ErrorBound, which: str) -> float:
    """The worst of the channels, over what is reflected."""
    return float(np.max(getattr(bound, which) / np.maximum(bound.picture_reflected, 1e-300)))


def _orders(text: str) -> tuple[int, int]:
    values = numbers(text, "--orders", "F,P, two whole numbers (24,3)", (2,))
    f, p = (int(value) for value in values)
    if [f, p] != values or min(values) < 0:
        raise ValueError(f"--orders {text}: cannot be read; give F,P, two whole numbers >= 0 (24,3)")
    return f, p


def _view(text: str) -> tuple[float, float]:
    azimuth, elevation = numbers(text, "--view", "AZIMUTH,ELEVATION in degrees (30,20)", (2,))
    direction(azimuth, elevation, f"--view {text}")
    return azimuth, elevation

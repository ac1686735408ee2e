"""Whether error bars hold what errors of calibration do: python -m benchmarks --only calibration.

Twelve photographs of a ball and of the cat under three lamps. Each draw gives poses, a lens, light directions or a scan
that are off by what the set states. The photographs stay as they are, so that calibration alone moves the numbers.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.ink import save, write_table
from benchmarks.kept import Kept
from benchmarks.spheres.coverage import RMS_BAND, rms_and_covered
from capture.manifest import UncertaintyTable
from capture.photoset import MANIFEST_NAME, load_photoset
from invrender.process.pipeline import process
from recon.mesh.trianglemesh import write_mesh
from synthetic.given import given_mesh, given_place, given_poses
from synthetic.manifest import Photograph, WrittenSet, manifest_text
from synthetic.scenes.build import read_staging
from synthetic.staging import Staging
from synthetic.writer import MESH_NAME, write_photoset

_OBJECTS = {
    "ball": '[object]\nshape = "sphere"\nradius = 0.02\n[camera]\nwidth = 160\nheight = 120\nfocal_px = 1440\n',
    "cat": '[object]\nshape = "cat"\natlas = false\n[camera]\nwidth = 240\nheight = 180\nfocal_px = 800\n',
}
_SCENE = """format = 1
name = "{name}"
[material]
model = "microfacet"
kd = 0.2
ks = 0.05
mu = 1.6
sigma = 0.12
[[lighting]]
directional = [
    {{ azimuth_deg = -20, elevation_deg = 25, irradiance = [1.6, 1.5, 1.35] }},
    {{ azimuth_deg = 120, elevation_deg = 50, irradiance = [0.5, 0.6, 0.7] }},
    {{ azimuth_deg = 230, elevation_deg = 35, irradiance = [0.9, 0.9, 0.9] }},
]
"""
_TRUTH = {"kd": 0.2, "ks": 0.05, "mu": 1.6, "sigma": 0.12}
_ELEVATIONS = (10, 30, 50, 20, 5, 40, 25, 60, 15, 35, 0, 45)
# What is off, as the set states it.
_CASES: dict[str, dict[str, float]] = {
    "poses 0.3 degrees": {"rotation_deg": 0.3},
    "poses 0.05 degrees": {"rotation_deg": 0.05},
    "camera places 0.05 mm": {"position": 5e-5},
    "focal length 0.5%": {"focal_length": 0.005},
    "light directions 0.3 degrees": {"direction_deg": 0.3},
    "scan 0.1 mm, vertex by vertex": {"height": 1e-4},
    "scan 0.1 mm over 3 mm": {"height": 1e-4, "height_correlation": 3e-3},
    "scan 0.5 mm over 3 mm": {"height": 5e-4, "height_correlation": 3e-3},
}
_DRAWS, _SAMPLES = 12, 20_000


def draw_calibration(out: Path, quick: bool) -> None:
    """Write calibration.md, calibration.png and what they were made from, calibration.json."""
    draws, samples = (1, 1500) if quick else (_DRAWS, _SAMPLES)
    kept = Kept(out / "calibration.json", {"draws": draws, "samples": samples})
    for name in ("ball",) if quick else _OBJECTS:
        cases = [case for case, own in _CASES.items() if name == "cat" or "height" not in own]
        missing = [case for case in cases if f"{name}, {case}" not in kept]
        if not missing:
            continue
        with tempfile.TemporaryDirectory() as folder:
            staging = _photographed(name, Path(folder))
            for case in missing[:1] if quick else missing:
                stated = UncertaintyTable(**_CASES[case])
                off = [
                    replace(staging, uncertainty=stated, scene=replace(staging.scene, seed=k))
                    for k in range(draws)
                ]
                kept[f"{name}, {case}"] = [_errors(each, Path(folder), samples) for each in off]
    found = {case: _coverage(entries) for case, entries in kept.items()}
    write_table(out / "calibration.md", _lines(found), kept.caption)
    save(_figure(found), out / "calibration.png", kept.caption)


def _photographed(name: str, folder: Path) -> Staging:
    views = "".join(
        f"[[view]]\nazimuth_deg = {azimuth}\nelevation_deg = {elevation}\n"
        for azimuth, elevation in zip(range(-60, 300, 30), _ELEVATIONS, strict=True)
    )
    path = folder / "scene.toml"
    path.write_text(_SCENE.format(name=name) + _OBJECTS[name] + views)
    staging = read_staging(path)
    write_photoset(staging, folder)
    return staging


def _errors(staging: Staging, folder: Path, samples: int) -> dict[str, float | None]:
    """Errors of a fit's numbers in their stated deviations, of the mean over channels; None where there is none."""
    if staging.mesh is not None:
        write_mesh(folder / MESH_NAME, given_mesh(staging, staging.mesh))
    photographs = [
        Photograph(k, f"{k:03d}.exr", f"{k:03d}_mask.png", None) for k in range(len(staging.scene.shots))
    ]
    place = None if staging.mesh is None else given_place(staging)
    radiometry: dict[str, Any] = {"encoding": "linear", "exposure": "equal"}
    written = WrittenSet({}, {}, given_poses(staging), place, radiometry, photographs)
    (folder / MANIFEST_NAME).write_text(manifest_text(staging, written, MESH_NAME))
    quantities = process(load_photoset(folder), samples, causes=False).solution.quantities
    errors: dict[str, float | None] = {}
    for name, truth in _TRUTH.items():
        one = quantities.get(name)
        errors[name] = None
        if one is not None and one.value is not None and one.std is not None:
            errors[name] = float((one.value.mean() - truth) / one.std.mean())
    return errors


def _coverage(entries: list[dict[str, float | None]]) -> dict[str, tuple[float, float, int]]:
    """RMS error in stated deviations, share of 95% intervals that hold the truth, and how many draws gave a number."""
    found = {}
    for name in _TRUTH:
        values = np.array([entry[name] for entry in entries if entry[name] is not None], float)
        if len(values):
            found[name] = (*rms_and_covered(values), len(values))
    return found


def _lines(found: Mapping[str, Mapping[str, tuple[float, float, int]]]) -> list[str]:
    lines = [
        "# Error bars and calibration\n",
        "RMS error in stated standard deviations, share of 95% intervals that hold the truth, and draws with a number."
        " 1 is right; below it bars are too wide, above it too narrow.\n",
        f"| what is off | {' | '.join(_TRUTH)} |",
        f"|---|{'---|' * len(_TRUTH)}",
    ]
    for case, own in found.items():
        cells = [
            f"{own[name][0]:.2f}, {own[name][1]:.0%}, {own[name][2]}" if name in own else "-"
            for name in _TRUTH
        ]
        lines.append(f"| {case} | {' | '.join(cells)} |")
    return lines


def _figure(found: Mapping[str, Mapping[str, tuple[float, float, int]]]) -> Figure:
    figure = Figure(figsize=(8, 1.5 + 0.38 * len(found)), layout="constrained")
    axes = figure.subplots()
    places = np.arange(len(found))[::-1]
    axes.axvspan(*RMS_BAND, color="0.9", zorder=0, label="0.8 to 1.3")
    for k, (name, marker) in enumerate(zip(_TRUTH, "osD^", strict=True)):
        at = [(own[name][0], place) for own, place in zip(found.values(), places, strict=True) if name in own]
        if at:
            axes.plot(*np.array(at).T, marker, color=f"C{k}", label=name, linestyle="none")
    axes.set_yticks(places, list(found))
    axes.set_xscale("log")
    axes.set_xticks([0.2, 0.5, 1, 2], ["0.2", "0.5", "1", "2"])
    axes.minorticks_off()
    axes.set_xlabel("RMS error over stated standard deviation (below 1: bars too wide)")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=8)
    return figure

"""Our photographs against Mitsuba 3's, an unrelated renderer: python -m benchmarks.mitsuba FIGURE.png [SCENE ...].

SCENE:2 is a scene's third photograph. Printed is by how much both differ in the pixels that are all object (relative
RMS and difference of the means, the worst channel), how much of that is Mitsuba's own noise, and the seconds that each
took. Pixels next to the rim are left out: RH01's 1 / cos theta_o gives their Monte Carlo estimates no finite variance.
The figure has a row per scene: ours, Mitsuba's, and twenty times the difference about grey. Needs the extra `reference`
and LLVM 16 or newer.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import mitsuba as mi
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from benchmarks.ink import save
from benchmarks.kept import machine, machine_words
from synthetic.materials.material import Material
from synthetic.render.photograph import photographs
from synthetic.scene import Scene
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_path
from tests.synthetic.mitsubalobes import has_llvm, lobe_of, register_lobes
from tests.synthetic.mitsubascene import Plugin, bsdf_of, mitsuba_photo

Floats = NDArray[np.float64]

_SCENES = (
    "rh01-teflon",
    "rh01-steel",
    "rh01-marschner",
    "phong",
    "exact-ggx",
    "anisotropic",
    "rh01-cat",
    "cat-interreflection",
    "rh01-doll",
)
# Paths per pixel of a pass, a square of a prime as the sampler wants it, and passes: few enough for 4 GB.
_SAMPLES, _PASSES = 11**2, 16


class Comparison(NamedTuple):
    """Radiance (h, w, 3) of both, the pixels that are compared (h, w), Mitsuba's noise, and seconds of both."""

    name: str
    ours: Floats
    theirs: Floats
    inner: NDArray[np.bool_]
    noise: float
    seconds: tuple[float, float]


def main(arguments: list[str]) -> None:
    """Print the table, and write the figure."""
    if not arguments:
        sys.exit("usage: python -m benchmarks.mitsuba FIGURE.png [SCENE ...]")
    if not has_llvm():
        sys.exit("LLVM 16 or newer isn't found: install libllvm19, or set DRJIT_LIBLLVM_PATH")
    mi.set_variant("llvm_ad_rgb")
    register_lobes()
    print(
        f"{'scene':24s} {'pixels':>7s} {'RMS %':>7s} {'noise %':>8s} {'mean %':>7s} {'ours s':>7s} {'Mitsuba s':>9s}"
    )
    comparisons = []
    for argument in arguments[1:] or _SCENES:
        name, _, photograph = argument.partition(":")
        scene = read_staging(scene_path(name)).scene
        scene = replace(scene, shots=(scene.shots[int(photograph or 0)],))
        comparison = compared(argument, scene)
        print(_line(comparison), flush=True)
        comparisons.append(comparison)
    write_figure(Path(arguments[0]), comparisons)
    print(f"written: {arguments[0]}")


def compared(name: str, scene: Scene) -> Comparison:
    """Both renderers' photograph of a scene that has one."""
    begin = time.perf_counter()
    ((ours, coverage),) = photographs(scene)
    middle = time.perf_counter()
    bsdf = _bsdf(scene.material)
    with tempfile.TemporaryDirectory() as folder:
        passes = [
            mitsuba_photo(scene, Path(folder), _SAMPLES, bsdf=bsdf, seed=seed) for seed in range(_PASSES)
        ]
    end = time.perf_counter()
    theirs, inner = np.mean(passes, axis=0), binary_erosion(coverage == 1, np.ones((3, 3)))
    scatter = np.var(passes, axis=0, ddof=1)[inner].mean(axis=0) / _PASSES
    noise = np.sqrt(scatter / (ours[inner] ** 2).mean(axis=0)).max()
    return Comparison(name, ours, theirs, inner, float(noise), (middle - begin, end - middle))


def write_figure(path: Path, comparisons: list[Comparison]) -> None:
    """Rows of ours, Mitsuba's, and their difference."""
    rows = len(comparisons)
    figure = Figure(figsize=(9, 2.4 * rows + 0.3), layout="constrained")
    axes = figure.subplots(rows, 3, squeeze=False)
    for (first, second, third), comparison in zip(axes, comparisons, strict=True):
        white = np.percentile(comparison.ours[comparison.inner], 99.5)
        for axis, radiance, title in (
            (first, comparison.ours, comparison.name),
            (second, comparison.theirs, "Mitsuba 3"),
        ):
            axis.imshow(np.clip(radiance / white, 0, 1) ** (1 / 2.2))
            axis.set_title(title, fontsize=8)
        difference = (comparison.theirs - comparison.ours) / white
        third.imshow(np.clip(0.5 + 20 * difference, 0, 1))
        third.set_title("20 x difference, of white", fontsize=8)
    for axis in axes.flat:
        axis.set_axis_off()
    save(figure, path, f"{machine_words(machine())}, {_PASSES * _SAMPLES} paths per pixel")


def _bsdf(material: Material) -> Plugin:
    """The plugin that has our formula, if one has been written, else Mitsuba's own."""
    try:
        return lobe_of(material)
    except ValueError:
        return bsdf_of(material)


def _line(comparison: Comparison) -> str:
    ours = comparison.ours[comparison.inner]
    difference = comparison.theirs[comparison.inner] - ours
    rms = np.sqrt((difference**2).mean(axis=0) / (ours**2).mean(axis=0)).max()
    means = difference.mean(axis=0) / ours.mean(axis=0)
    mean = means[np.abs(means).argmax()]
    numbers = f"{100 * rms:7.2f} {100 * comparison.noise:8.2f} {100 * mean:+7.3f}"
    seconds = f"{comparison.seconds[0]:7.1f} {comparison.seconds[1]:9.1f}"
    return f"{comparison.name:24s} {len(ours):7d} {numbers} {seconds}"


if __name__ == "__main__":
    main(sys.argv[1:])

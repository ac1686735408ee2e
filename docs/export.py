"""Draws docs/export.png: our picture of a result, Mitsuba's of its export, and what each format loses.

python docs/export.py [FIGURE [RESULT]]: without a result it makes the demonstration's. It needs the extra `reference`.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import mitsuba as mi
import numpy as np
from matplotlib.figure import Figure

from capture.srgb import linear_to_srgb
from invrender.output.export.gltf_target import GLTF
from invrender.output.export.mapping import map_brdf
from invrender.output.export.materialx_target import STANDARD_SURFACE
from invrender.output.export.mitsuba_target import MITSUBA
from invrender.output.export.run import ExportOptions, run_export
from invrender.output.render.light import light_element
from invrender.output.render.picture import take_picture
from invrender.output.render.subject import photographed_subject
from invrender.output.render.view import new_optics, parse_view, seen_from
from invrender.output.report.run import run_demo
from invrender.result.reflectance import reflectance
from invrender.result.saved import read_result

VIEW = "60,20"
SIDE, PATHS = 128, 8192
# The difference is drawn so much stronger.
STRONGER = 20


def main(figure_path: Path, folder: Path) -> None:
    """Write the figure and print the numbers of the page."""
    result = read_result(folder)
    material = reflectance(result, {})
    subject = photographed_subject(result, None)
    optics = new_optics(None, subject.radius, (SIDE, SIDE), None)
    camera = seen_from(optics, parse_view(VIEW), subject.centre, subject.radius)
    lighting = result.read_lighting(result.lighting(None))
    picture = take_picture(subject, camera, material, light_element(lighting))
    inner = picture.coverage == 1
    ours, theirs = picture.radiance.astype(float), rendered(folder)
    rms = np.sqrt(((theirs - ours)[inner] ** 2).mean() / (ours[inner] ** 2).mean())
    mean = (theirs[inner].mean(axis=0) / ours[inner].mean(axis=0) - 1).mean()
    print(
        f"Pictures differ by {rms:.2%} (relative RMS, Mitsuba's noise included), their means by {mean:.2%}."
    )

    figure = Figure(figsize=(15, 4.2), dpi=80, layout="constrained")
    panels = figure.subplots(1, 4, width_ratios=[1, 1, 1, 1.25])
    white = float(np.quantile(ours[inner], 0.995))
    difference = np.where(inner[:, :, None], theirs - ours, 0) / white
    shown = (
        ("our prediction", linear_to_srgb(np.clip(ours / white, 0, 1))),
        ("Mitsuba's rendering of the export", linear_to_srgb(np.clip(theirs / white, 0, 1))),
        (
            f"Mitsuba less ours, {STRONGER} times as strong\n(grey: none)",
            np.clip(0.5 + STRONGER * difference, 0, 1),
        ),
    )
    for axes, (title, image) in zip(panels, shown, strict=False):
        axes.imshow(image)
        axes.set_title(title)
        axes.set_axis_off()
    for label, targets in (("glTF", [GLTF]), ("Mitsuba", MITSUBA), ("MaterialX", [STANDARD_SURFACE])):
        mapping = map_brdf(material.brdf, targets)
        order = mapping.view_deg.argsort()
        panels[3].plot(mapping.view_deg[order], 100 * mapping.view_rms[order], label=label)
        print(f"{label}: {mapping.relative_rms:.1%} over all directions.")
    panels[3].set(
        title="lost by each mapping",
        xlabel="angle of view to the normal (degrees)",
        ylabel="difference under single sources (% RMS)",
        xlim=(0, 81.5),
        ylim=(0, None),
    )
    panels[3].legend()
    figure.savefig(figure_path, metadata={"Software": None})


def rendered(folder: Path) -> np.ndarray:
    """Mitsuba's picture (h, w, 3) of a result, through its export."""
    mi.set_variant("llvm_ad_rgb" if "llvm_ad_rgb" in mi.variants() else "scalar_rgb")
    with TemporaryDirectory() as temporary:
        run_export(ExportOptions(folder, Path(temporary) / "scene", "mitsuba", view=VIEW))
        scene = mi.load_file(str(Path(temporary) / "scene" / "scene.xml"))
        # Its pixels are finer than those that are shown.
        size = scene.sensors()[0].film().crop_size()[0]
        fine = np.array(mi.render(scene, spp=PATHS * SIDE**2 // size**2), float)[:, :, :3]
    step = size // SIDE
    return np.asarray(fine.reshape(SIDE, step, SIDE, step, 3).mean(axis=(1, 3)))


if __name__ == "__main__":
    place = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("export.png")
    if len(sys.argv) > 2:
        main(place, Path(sys.argv[2]))
    else:
        with TemporaryDirectory() as folder:
            run_demo(Path(folder) / "demo")
            main(place, Path(folder) / "demo" / "result")

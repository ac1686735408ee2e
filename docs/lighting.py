"""Our fig. 9 of RH01, docs/lighting.png: light recovered from photographs of a bronze sphere, beside the truth.

python docs/lighting.py [FOLDER]
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.figure import Figure

from capture.lighting import Lighting
from capture.photoset import load_photoset
from invrender.inverse_lighting.estimate import LightingChoices, LightResult, estimate_light
from invrender.inverse_lighting.figure import blurred_truth, draw_map, white_level
from invrender.inverse_lighting.given import given_lights
from invrender.inverse_lighting.known_brdf import read_brdf
from invrender.inverse_lighting.maps import coefficient_map, true_light
from invrender.process.pipeline import process
from synthetic.run import run_synth

SCENE = "rh01-lighting"


def recovered(folder: Path, degree: int) -> LightResult:
    """The light of the set by coefficients up to a degree, and by the dual method."""
    photoset = load_photoset(folder)
    lights = {name: given.lighting for name, given in given_lights(photoset).items()}
    return estimate_light(photoset, read_brdf(folder / "truth.json"), LightingChoices(degree), lights)[0]


def joint(folder: Path) -> Lighting:
    """The light of the set as `process` recovers it together with the BRDF, in the truth's scale."""
    found = process(load_photoset(folder)).result.lightings[0].lighting
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["brdf"]
    # Its own is free: there Kd + Ks is 1.
    scale = 1 / (np.array(truth["kd"]) + np.array(truth["ks"]))
    assert found.radiance_map is not None
    dimmed = (found.radiance_map * scale).astype(np.float32)
    return replace(
        found, radiance_map=dimmed, irradiances=found.irradiances * scale, recover_irradiance=False
    )


def comparison(twelve: LightResult, twenty: LightResult, together: Lighting) -> Figure:
    """Truth, and as blurred by the highlight; coefficients up to l = 12 and 20, the dual map, the joint fit's light."""
    assert twenty.truth is not None
    assert twenty.dual is not None
    blurred = blurred_truth(twenty.truth, twenty.brdf)
    white = white_level(blurred)
    figure = Figure(figsize=(14, 5.6), layout="constrained")
    grid = figure.subplots(2, 3)
    panels = grid.ravel()
    draw_map(panels[0], twenty.truth.radiance_map, white, "true light: a screen and a lamp")
    draw_map(panels[1], blurred, white, f"true light, blurred by σ = {twenty.brdf.sigma}")
    of_joint = blurred_truth(true_light(together), twenty.brdf)
    draw_map(panels[2], of_joint, white, "joint: light and BRDF at once, as blurred")
    draw_map(panels[3], coefficient_map(twelve.direct.values), white, "coefficients, l* = 12")
    draw_map(panels[4], coefficient_map(twenty.direct.values), white, "coefficients, l* = 20")
    draw_map(panels[5], twenty.dual.radiance, white, "dual: angular and frequency space")
    for axes in grid[1]:
        axes.set_xlabel("azimuth from +X (degrees)")
    for axes in grid[:, 0]:
        axes.set_ylabel("polar angle\nfrom +Z (degrees)")
    return figure


def main() -> None:
    """Photograph the scene, recover its light, and draw."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    with TemporaryDirectory() as temporary:
        folder = Path(temporary) / "set"
        run_synth(SCENE, folder, "nothing", None)
        twelve, twenty = (recovered(folder, degree) for degree in (12, 20))
        together = joint(folder)
    out.mkdir(parents=True, exist_ok=True)
    comparison(twelve, twenty, together).savefig(out / "lighting.png", dpi=80)
    for result in (twelve, twenty):
        print(f"l* = {result.direct.degree}: RMS residual {result.rms:.1%}")


if __name__ == "__main__":
    main()

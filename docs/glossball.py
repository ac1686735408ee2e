"""docs/glossball.png: a real glossy ball under a lamp that no fit has seen, and in light where it never was.

LIGHTFACTOR_DATA=DATA python docs/glossball.py [FOLDER]: DATA holds `glossball/` (DiLiGenT's ball, Shi et al. 2016) and
`probes/Grace_Cathedral.hdr` (Debevec 1998).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from capture.files.imagefile import read_pixels
from capture.srgb import linear_to_srgb

# One photograph in so many is held out; one of them is shown.
EVERY, SHOWN = 4, "063.png"

_HEAD = """format = 1
name = "glossy ball"
[camera]
model = "ORTHOGRAPHIC"
width = 160
height = 160
[radiometry]
encoding = "linear"
[object]
shape = "sphere"
"""
_ENTRY = """[[lighting]]
name = "{name}"
directional = [{{ direction = {direction}, irradiance = {irradiance} }}]
[[photo]]
file = "{folder}/{name}.png"
mask = "{folder}/mask.png"
world_to_camera = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1000], [0, 0, 0, 1]]
lighting = "{name}"
held_out = {held_out}
"""


def write_photoset(source: Path, folder: Path) -> None:
    """The manifest of the ball's photographs; world: x right, y up, z to the camera, pixels for its unit."""
    rows = [line.split() for line in (source / "lights.txt").read_text().splitlines() if line[:1] != "#"]
    entries = []
    for place, (name, *numbers) in enumerate(row for row in rows if row):
        values = np.array(numbers, float)
        entry = _ENTRY.format(
            name=name,
            direction=json.dumps((values[:3] / np.linalg.norm(values[:3])).tolist()),
            irradiance=json.dumps(values[3:].tolist()),
            folder=source.as_posix(),
            held_out=json.dumps(place % EVERY == EVERY - 1),
        )
        entries.append((place % EVERY == EVERY - 1, entry))
    # Held-out photographs come last.
    entries.sort(key=lambda pair: pair[0])
    folder.mkdir()
    (folder / "photoset.toml").write_text(_HEAD + "".join(entry for _, entry in entries), encoding="utf-8")


def lightfactor(*arguments: str | Path) -> None:
    """Run the program as a user does."""
    subprocess.run(
        [sys.executable, "-c", "from lightfactor.cli import main; main()", *map(str, arguments)], check=True
    )


def numbers_of(result: dict[str, Any]) -> str:
    """The numbers of a result in lines of text."""
    brdf = result["brdf"]
    lines = ["what was found", ""]
    lines += [
        f"albedo {name}  {value:.3f} ± {std:.3f}"
        for name, value, std in zip(
            ("red  ", "green", "blue "), brdf["albedo"]["value"], brdf["albedo"]["std"], strict=True
        )
    ]
    lines.append(f"Ks            {brdf['ks']['value'][0]:.4f} ± {brdf['ks']['std'][0]:.4f}")
    lines.append(f"sigma         {brdf['sigma']['value']:.3f} ± {brdf['sigma']['std']:.3f} rad")
    lines.append("mu            not needed" if brdf["mu"] is None else f"mu            {brdf['mu']['value']}")
    held_out = [photo["rms_relative"] for photo in result["photos"] if photo["held_out"]]
    lines += ["", f"error on {len(held_out)} unseen", f"photographs   {np.mean(held_out):.1%} (RMS)"]
    return "\n".join(lines)


def shown(radiance: NDArray[np.floating]) -> NDArray[np.float64]:
    """Linear radiance (h, w, 3) as sRGB; the brightest hundredth, highlights, is white."""
    return linear_to_srgb(np.clip(radiance / np.quantile(radiance.max(axis=2), 0.99), 0, 1))


def main(out: Path) -> None:
    data = Path(os.environ["LIGHTFACTOR_DATA"]).resolve()
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_photoset(data / "glossball", folder / "set")
        lightfactor("process", folder / "set", "-o", folder / "result")
        light = ("--light", data / "probes/Grace_Cathedral.hdr", "--panorama")
        view = ("--view", "90,0", "--size", "320x320")
        lightfactor("render", folder / "result", *light, *view, "-o", folder / "new.exr")
        result = json.loads((folder / "result/result.json").read_text(encoding="utf-8"))
        photograph = read_pixels(data / "glossball" / SHOWN).astype(float)
        prediction = read_pixels(folder / "result/predicted" / SHOWN.replace(".png", ".exr")).astype(float)
        relit = read_pixels(folder / "new.exr").astype(float)
    figure = Figure(figsize=(11, 3.3), layout="constrained")
    panels = figure.subplots(1, 4)
    pictures = (
        ("photograph, not used in the fit", photograph),
        ("prediction from 36 other photographs", prediction),
        ("the same ball in Grace Cathedral", relit[:, :, :3]),
    )
    for axes, (title, picture) in zip(panels, pictures, strict=False):
        axes.imshow(shown(picture))
        axes.set_title(title, fontsize=10)
    panels[3].text(0, 0.5, numbers_of(result), family="monospace", fontsize=10, va="center")
    for axes in panels:
        axes.set_axis_off()
    figure.savefig(out / "glossball.png", dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

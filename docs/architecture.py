"""docs/architecture.png: the packages, and the types that data has on its way from photographs to result files.

python docs/architecture.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

INK = "0.15"
COLOURS = {
    "files": "#f3efe2",
    "capture": "#dcebf7",
    "recon": "#dff1de",
    "invrender": "#fbe6d4",
    "synthetic": "#ece0f2",
    "top": "0.92",
}


def box(
    axes: Axes, x: float, y: float, width: float, height: float, colour: str, title: str, text: str
) -> None:
    """A rounded box with its lower left corner at (x, y), a title in bold and lines below it."""
    shape = FancyBboxPatch(
        (x, y),
        width,
        height,
        boxstyle="round,pad=0,rounding_size=0.08",
        facecolor=colour,
        edgecolor=INK,
        linewidth=0.8,
    )
    axes.add_patch(shape)
    axes.text(
        x + width / 2, y + height - 0.1, title, ha="center", va="top", fontsize=9, weight="bold", color=INK
    )
    axes.text(
        x + width / 2, y + height - 0.42, text, ha="center", va="top", fontsize=8, color=INK, linespacing=1.35
    )


def arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], label: str) -> None:
    """An arrow with a label: above it, or to the right of an upright one."""
    style = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.1, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=style)
    x, y = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
    upright = start[0] == end[0]
    axes.text(
        x + (0.07 if upright else 0),
        y + (0 if upright else 0.06),
        label,
        fontsize=8,
        style="italic",
        color=INK,
        ha="left" if upright else "center",
        va="center" if upright else "bottom",
        linespacing=1.2,
    )


ROW, HEIGHT, BELOW, LOW, TOP = 2.35, 1.6, 0.1, 1.15, 4.5
# Left edge, bottom, width, height, colour, title, lines.
BOXES = (
    (0.0, ROW, 1.25, HEIGHT, "files", "files", "photographs\nphotoset.toml\ncalibration\nmesh"),
    (1.75, ROW, 1.5, HEIGHT, "capture", "capture", "decode, linearise\nvariance, masks\ncameras, lens\nlighting"),
    (4.25, ROW, 1.5, HEIGHT, "recon", "recon", "sphere, mesh, hull\nposes, placement\nmirrorball, harmonics\nsampling"),
    (6.65, ROW, 1.8, HEIGHT, "invrender", "invrender.estimate", "search, evidence\nuncertainty\ntextures"),
    (9.4, ROW, 1.8, HEIGHT, "invrender", "invrender.result", "what was found\npredicted pictures\nread and write"),
    (12.3, ROW, 1.7, HEIGHT, "invrender", "invrender.output", "report, render\ncompare\nexport"),
    (1.75, BELOW, 1.5, LOW, "synthetic", "synthetic", "scenes with truth\nby brute force\nown formulas"),
    (6.4, BELOW, 2.3, LOW, "invrender", "invrender.transport", "what a BRDF does to light\nvisibility, bounces"),
    (9.3, BELOW, 2.0, LOW, "invrender", "invrender.diagnostics", "causes of what\na fit leaves\nunexplained"),
    (0.0, TOP, 3.25, 0.8, "top", "lightfactor", "program and Python interface"),
    (4.25, TOP, 6.95, 0.8, "invrender", "invrender.process", "from a photo set to its result"),
)  # fmt: skip
MIDDLE = ROW + HEIGHT / 2
# Start, end, label.
ARROWS = (
    ((1.25, MIDDLE), (1.75, MIDDLE), ""),
    ((3.25, MIDDLE), (4.25, MIDDLE), "PhotoSet\nRadianceImage"),
    ((5.75, MIDDLE), (6.65, MIDDLE), "LightField"),
    ((8.45, MIDDLE), (9.4, MIDDLE), "Solution"),
    ((11.2, MIDDLE), (12.3, MIDDLE), "Run\nresult.json"),
    ((2.5, BELOW + LOW), (2.5, ROW), "photo set\nand truth.json"),
    ((7.55, BELOW + LOW), (7.55, ROW), "PhotoColumns\nharmonic rows"),
    ((10.3, BELOW + LOW), (10.3, ROW), "NamedCause"),
    ((7.55, TOP), (7.55, ROW + HEIGHT), ""),
    ((3.25, TOP + 0.4), (4.25, TOP + 0.4), ""),
)


def draw(axes: Axes) -> None:
    """The whole drawing."""
    for x, y, width, height, colour, title, text in BOXES:
        box(axes, x, y, width, height, COLOURS[colour], title, text)
    for start, end, label in ARROWS:
        arrow(axes, start, end, label)
    others = "inverse_lighting, inverse_brdf,\nfactor, refine, plan,\nphotometric_stereo:\nother questions, same parts"
    axes.text(13.15, TOP + 0.4, others, ha="center", va="center", fontsize=8, color=INK)
    axes.set(xlim=(-0.1, 14.3), ylim=(0, TOP + 0.9), aspect="equal")
    axes.set_axis_off()


def main(out: Path) -> None:
    figure = Figure(figsize=(13.2, 5.4), layout="constrained")
    draw(figure.subplots())
    figure.savefig(out / "architecture.png", dpi=90, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

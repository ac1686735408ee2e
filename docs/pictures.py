"""docs/pictures.png: time against error of pictures under a map, of an integral for each ray and of few, interpolated.

LIGHTFACTOR_DATA=DATA python docs/pictures.py [FOLDER]: DATA holds `probes/Grace_Cathedral.hdr`. Takes ten minutes.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from capture.lighting import Lighting, read_latlong
from capture.srgb import linear_to_srgb
from invrender.brdf.microfacet import Microfacet
from invrender.output.render.light import light_element
from invrender.output.render.picture import Picture, take_picture
from invrender.output.render.subject import Subject, mesh_subject, sphere_subject
from invrender.output.render.view import View, new_optics, seen_from
from invrender.result.reflectance import Reflectance
from invrender.transport import half_vectors
from synthetic.run import run_synth

SIZE = 320
WIDTHS = (0.05, 0.15)
# Half-vectors' distances over those of `render`: of the curve, and of what counts as true.
EVEN, TRUE = (2.0, 1.4, 1.0), 0.4
TOLERANCES = (4.0, 1.0, 0.5, 0.25)


@contextmanager
def half_vectors_apart(share: float) -> Iterator[None]:
    """Integrals over maps with half-vectors a share as far apart, along and across rings."""
    rough = half_vectors._ROUGH
    azimuths = tuple((theta, round(count / share)) for theta, count in rough.azimuths)
    with patch.object(
        half_vectors, "_ROUGH", replace(rough, log_step=rough.log_step * share, azimuths=azimuths)
    ):
        yield


def taken(subject: Subject, width: float, lighting: Lighting, percent: float) -> tuple[Picture, float]:
    """A picture and the seconds that it took, the map's making ready left out."""
    camera = seen_from(
        new_optics(None, subject.radius, (SIZE, SIZE), None),
        View(30.0, 20.0, None),
        subject.centre,
        subject.radius,
    )
    brdf = Microfacet(kd=np.full(3, 0.1), ks=np.full(3, 0.5), mu=1.5, sigma=width)
    material = Reflectance(brdf, np.zeros((3, 4, 4)), {}, ())
    element = light_element(lighting)
    begin = time.perf_counter()
    picture = take_picture(subject, camera, material, element, tolerance=percent / 100)
    return picture, time.perf_counter() - begin


def curves(
    subject: Subject, width: float, lighting: Lighting
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float64]]:
    """The picture that counts as true, and (error in percent, seconds) of each even and each interpolated one."""
    with half_vectors_apart(TRUE):
        true = taken(subject, width, lighting, 0)[0].radiance

    def point(percent: float) -> tuple[float, float]:
        picture, seconds = taken(subject, width, lighting, percent)
        return 100 * float(np.linalg.norm(picture.radiance - true) / np.linalg.norm(true)), seconds

    even = []
    for share in EVEN:
        with half_vectors_apart(share):
            even.append(point(0))
    return true, np.array(even), np.array([point(percent) for percent in TOLERANCES])


def main(out: Path) -> None:
    radiance = read_latlong(Path(os.environ["LIGHTFACTOR_DATA"]) / "probes" / "Grace_Cathedral.hdr")
    lighting = Lighting(
        "Grace cathedral",
        cv2.resize(radiance, (500, 250), interpolation=cv2.INTER_AREA),
        np.zeros((0, 3)),
        np.zeros((0, 3)),
    )
    figure = Figure(figsize=(13, 9), layout="constrained")
    figure.suptitle(f"Pictures of {SIZE} x {SIZE} pixels under Grace cathedral: what accuracy costs")
    panels = figure.subplots(2, 4)
    with TemporaryDirectory() as folder:
        run_synth("rh01-cat", Path(folder) / "cat", None, None)
        subjects = {
            "ball": sphere_subject(np.zeros(3), 0.05),
            "cat": mesh_subject(Path(folder) / "cat" / "object.obj", None),
        }
        for row, (name, subject) in zip(panels, subjects.items(), strict=True):
            taken(subject, 0.3, lighting, 0.5)  # what is read and made ready once
            for column, width in enumerate(WIDTHS):
                true, even, few = curves(subject, width, lighting)
                shown, chart = row[2 * column : 2 * column + 2]
                shown.imshow(linear_to_srgb(np.clip(true / np.percentile(true, 99.5), 0, 1)))
                shown.set_title(f"{name}, sigma {width:g} rad")
                shown.set_axis_off()
                chart.plot(*even.T, "o-", label="an integral for each ray")
                chart.plot(*few.T, "s-", label="few integrals, interpolated")
                for (error, seconds), percent in zip(few, TOLERANCES, strict=True):
                    chart.annotate(
                        f"{percent:g}%",
                        (error, seconds),
                        (0, -12),
                        textcoords="offset points",
                        fontsize=8,
                        ha="center",
                    )
                chart.set_xlabel("RMS error over RMS radiance (%)")
                chart.set_ylabel("time (s)")
                chart.set_xlim(0)
                chart.set_ylim(0)
                chart.grid(alpha=0.3)
                chart.legend(fontsize=8)
                print(
                    name,
                    width,
                    "even",
                    even.round(2).tolist(),
                    "interpolated",
                    few.round(2).tolist(),
                    flush=True,
                )
    figure.savefig(out / "pictures.png", dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

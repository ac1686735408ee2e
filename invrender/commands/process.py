"""lightfactor process: a photo set in, BRDF with error bars and a report out."""

from __future__ import annotations

from typing import Annotated

import typer

from capture.commands.options import ClusterAddress, Fresh, ResultOut, SetFolder, Workers

DEFAULT_SAMPLES = 60_000


def process(
    photoset: SetFolder,
    out: ResultOut,
    samples: Annotated[
        int,
        typer.Option(
            min=1000,
            help="Pixels of all photographs together that enter the fit, drawn evenly; fewer are faster, with"
            " larger error bars.",
        ),
    ] = DEFAULT_SAMPLES,
    published: Annotated[
        bool,
        typer.Option(
            "--published",
            help="Solve known light as Ramamoorthi and Hanrahan (2001, section 6.1) did, to compare with: a simplex"
            " over mu and sigma, Kd and Ks by least squares, no error bars.",
        ),
    ] = False,
    fresh: Fresh = False,
    workers: Workers = None,
    cluster: ClusterAddress = None,
) -> None:
    """Recover BRDF and error bars, and the lighting where it is unknown, from a photo set of a sphere or a mesh.

    Writes OUT/result.json (every number with its standard deviation), OUT/report.html (open it in a
    browser), OUT/predicted/ (EXR) and the lighting as used. Kd is in 1/sr, so the albedo is pi Kd; sigma is
    in radians.
    """
    from capture.photoset import check_present

    check_present(photoset)
    from invrender.output.report.run import run_process

    run_process(photoset, out, samples, published, fresh, workers, cluster)

"""lightfactor process: a photo set in, BRDF with error bars and a report out."""

from __future__ import annotations

from typing import Annotated

import typer

from capture.commands.options import ClusterAddress, Fresh, ResultOut, SetFolder, Workers, check_useful

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

    Of a set with shape = "normals" (one camera, many lamps, no mesh) it finds normals, albedo and the lobe that all
    pixels share, by photometric stereo: OUT/normals.npz, .exr and .png (x right, y up, z to the camera) with standard
    deviations in degrees, albedo.exr, depth.exr, and stereo.png: look at it. `integrate` makes a mesh of it.
    """
    from capture.photoset import check_present

    loaded = check_present(photoset)
    if loaded.object.shape == "normals":
        from invrender.photometric_stereo.run import run_stereo

        given = {
            "--samples": samples != DEFAULT_SAMPLES,
            "--published": published,
            "--workers": workers is not None,
            "--cluster": cluster is not None,
            "--fresh": fresh,
        }
        check_useful(given, "a set with shape = 'normals', whose pixels are all solved in this process")
        run_stereo(loaded, out)
        return
    from invrender.output.report.run import run_process

    run_process(photoset, out, samples, published, fresh, workers, cluster)

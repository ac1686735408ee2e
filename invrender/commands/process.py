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

    Of a set with shape = "normals" (one camera, many lamps, no mesh) it finds normals, albedo and the lobe that all
    pixels share, by photometric stereo: OUT/normals.npz, .exr and .png (x right, y up, z to the camera) with standard
    deviations in degrees, albedo.exr, depth.exr, and stereo.png: look at it. `integrate` makes a mesh of it.
    """
    from capture.photoset import check_present, load_photoset

    check_present(photoset)
    loaded = load_photoset(photoset)
    if loaded.object.shape == "normals":
        from invrender.photometric_stereo.run import run_stereo

        _check_stereo(samples != DEFAULT_SAMPLES, published, fresh, workers is not None, cluster is not None)
        run_stereo(loaded, out)
        return
    from invrender.output.report.run import run_process

    run_process(photoset, out, samples, published, fresh, workers, cluster)


def _check_stereo(samples: bool, published: bool, fresh: bool, workers: bool, cluster: bool) -> None:
    """ValueError for options that were given and do nothing of a set whose shape is normals."""
    given = {
        "--samples": samples,
        "--published": published,
        "--workers": workers,
        "--cluster": cluster,
        "--fresh": fresh,
    }
    useless = [name for name, is_given in given.items() if is_given]
    if useless:
        raise ValueError(
            f"{useless[0]} does nothing for a set with shape = 'normals', whose pixels are all solved in this process;"
            " leave it out"
        )

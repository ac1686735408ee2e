"""lightfactor samples: the light field of a photo set, as arrays, and a figure to check the set by."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def samples(
    photoset: Annotated[
        Path,
        typer.Argument(
            metavar="SET",
            help="Folder of a photo set with poses, or its photoset.toml; a mesh must be in its place.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="Folder for the samples; earlier ones are replaced.",
            show_default=False,
        ),
    ],
    budget: Annotated[
        int,
        typer.Option(
            "--samples",
            min=0,
            help="Samples of all photographs together, spread over photographs and normals; 0: every usable pixel.",
        ),
    ] = 60_000,
    l_max: Annotated[
        int,
        typer.Option(
            min=0, max=30, help="Highest degree of spherical harmonics of light whose transfer is computed."
        ),
    ] = 8,
    rays: Annotated[
        int, typer.Option(min=16, max=65_536, help="Rays per vertex that look for shadows of the sky.")
    ] = 256,
) -> None:
    """See what a photo set says of its object: which pixels count, with which geometry, and what light reaches them.

    Checks that the mesh projects into its masks; draws samples from every photograph; traces which mirrored rays and
    sources they see; computes how light from everywhere reaches every vertex (kept beside the mesh for next time).

    Writes OUT/samples.json (a summary), OUT/samples.png (look at it), OUT/samples/PHOTO.npz (rows, columns, radiance,
    variance, weight; per ray: ray_sample, positions in metres, normals, views, reflected_visible, sources_visible,
    faces, corner_weights) and OUT/transfer.npz (vertices, faces, normals in the world; per vertex coefficients in
    steradian, of degree l and order m in column l*l + l + m, and their std).
    """
    from recon.sampling.run import run_samples

    run_samples(photoset, output, budget or None, l_max, rays)

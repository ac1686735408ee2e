"""lightfactor integrate: a mesh from a normal map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def integrate(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT|MAP",
            help="Folder that `process` wrote for a set with shape = 'normals', or a normal map: .npz, .exr, or .png as"
            " (n + 1) / 2; x right, y up, z to the camera.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--out", metavar="OUT", help="The mesh, .obj; an earlier one is replaced."),
    ] = Path("surface.obj"),
    pixel: Annotated[
        float,
        typer.Option(
            min=1e-9,
            help="Metres that a pixel of a MAP covers, seen from far away; of a RESULT the camera says it.",
        ),
    ] = 1.0,
) -> None:
    """Make a mesh of the surface that has given normals.

    Depths are the least-squares fit to all slopes, two triangles to four pixels. A mesh of a RESULT lies in the world
    of its set, so it needs no alignment: [object] shape = "mesh", mesh = "surface.obj", texture = true. Its texture
    coordinates are the picture's: albedo.exr is its texture. Steps in depth, as between an arm and the body behind it,
    have no normals: the surface bends there in place of a step, and absolute depth is unknown.
    """
    from capture.files.outfolder import result_files
    from capture.terminal import console, leave_cleanly_when_stopped
    from recon.mesh.trianglemesh import write_mesh
    from recon.normals.integration import integrate as depths_of
    from recon.normals.integration import slope_errors, surface_mesh
    from recon.normals.saved import read_seen_normals

    leave_cleanly_when_stopped()
    if output.suffix.lower() != ".obj":
        raise ValueError(f"{output}: is written as .obj, which holds texture coordinates; name it so")
    seen = read_seen_normals(source, pixel)
    depths = depths_of(seen.normal_map, seen.camera, seen.depth)
    mesh = surface_mesh(seen.normal_map, seen.camera, depths)
    with result_files(output, inputs=[source]) as folder:
        write_mesh(folder / output.name, mesh)
    off = slope_errors(seen.normal_map, seen.camera, depths)
    console.print(
        f"{len(mesh.vertices)} vertices, {len(mesh.faces)} faces; the surface's own normals differ from the map's by"
        f" {off:.1f} degrees (median)."
    )
    console.print(f"Mesh: {output}", soft_wrap=True)

"""lightfactor hull: a mesh from the silhouettes of a photo set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def hull(
    photoset: Annotated[
        Path,
        typer.Argument(
            metavar="SET", help="Folder of a photo set with poses, or its photoset.toml.", show_default=False
        ),
    ],
    cells: Annotated[
        int,
        typer.Option(
            min=8,
            max=1024,
            help="Cells along the longest side of the object; time and memory grow with the cube.",
        ),
    ] = 160,
    background: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1.0,
            help="Of photographs without a mask, what is darker than this share of the brightest parts is background."
            " Rather too low than too high: what one photograph has too much of, others cut away.",
        ),
    ] = 0.04,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--out", metavar="OUT", help="The mesh, .ply or .obj; an earlier one is replaced."
        ),
    ] = Path("hull.ply"),
) -> None:
    """Make a mesh of an object that nobody scanned: the largest body that fits all its silhouettes.

    It uses the masks of the set, or the brightness where the background is black. The mesh is in the world of the
    poses, so it needs no alignment: [object] shape = "mesh", mesh = "hull.ply". Hollows that no silhouette shows are
    filled, and normals are off there: it is a stand-in, not a scan. Where silhouettes contradict each other, the
    photographs and places are named: dark parts of the object need masks.
    """
    from rich.markup import escape

    from capture.decode import decode_photo, photo_mask
    from capture.files.outfolder import result_files
    from capture.photoset import load_photoset
    from capture.terminal import console, leave_cleanly_when_stopped, track
    from recon.hull.consistency import contradiction_warning, contradictions
    from recon.hull.silhouette import bright_region
    from recon.hull.visualhull import visual_hull
    from recon.mesh.trianglemesh import volume, write_mesh

    leave_cleanly_when_stopped()
    if output.suffix.lower() not in (".ply", ".obj"):
        raise ValueError(f"{output}: must end in .ply or .obj")
    loaded = load_photoset(photoset, find_alignment=True)
    inputs = [path for photo in loaded.photos for path in (photo.file, photo.mask) if path is not None]
    with result_files(output, inputs=inputs) as folder:
        coverages = []
        for photo in track(loaded.photos, "Reading silhouettes"):
            mask = photo_mask(photo)
            if mask is None:
                mask = bright_region(decode_photo(loaded.radiometry, photo).radiance, background)
            coverages.append(mask)
            if not coverages[-1].any():
                raise ValueError(f"{photo.file}: has no mask, and nothing in it is bright; give a mask")
        cameras = [photo.camera for photo in loaded.photos]
        mesh = visual_hull(cameras, coverages, cells, track)
        write_mesh(folder / output.name, mesh)
    warning = contradiction_warning(
        contradictions(mesh, cameras, coverages, cells),
        [photo.label for photo in loaded.photos],
        [photo.mask is not None for photo in loaded.photos],
        background,
    )
    if warning is not None:
        console.print(f"[bold]Warning:[/bold] {escape(warning)}", soft_wrap=True)
    size = mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)
    console.print(
        f"{len(mesh.faces)} faces, {size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g}, volume {volume(mesh):.4g}, in the"
        " poses' unit (metres, unless they are relative)."
        f" Wrote {output}",
        soft_wrap=True,
    )

"""A first manifest for a folder of photographs: what can be seen of them, and what only a person knows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from capture.decode import decode, read_mask
from capture.files.imageheader import is_raw
from capture.files.outfolder import result_files
from capture.photoset import MANIFEST_NAME

# Files that are read as photographs, beside RAW files; what lies beside them under `_MASK` is their mask.
_ENDINGS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".hdr")
_MASK = "_mask.png"
_MESHES = (".ply", ".obj", ".stl", ".glb")
_ENCODINGS = {"srgb": "as cameras write JPEG", "linear": "linear"}
_LIGHTS = ("unknown", "dark")
# Of the longer side: the focal length of which nobody knows anything.
_FOCAL_SHARE = 1.2


def photographs(folder: Path) -> list[Path]:
    """Files of a folder that look like photographs, by name."""
    return sorted(
        path
        for path in folder.iterdir()
        if (path.suffix.lower() in _ENDINGS or is_raw(path))
        and not path.name.endswith(_MASK)
        and not path.name.startswith(".")
    )


def found(folder: Path) -> dict[str, Any]:
    """What a manifest could be written from."""
    meshes = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in _MESHES)
    return {"photos": [path.name for path in photographs(folder)], "meshes": meshes}


def write_manifest(folder: Path, said: Mapping[str, Any]) -> Path:
    """Write photoset.toml for the photographs of a folder; ValueError where one is there, or nothing can be written.

    said : "mesh", a file's name or "" for a sphere; "unit" of the mesh; "encoding"; "light": "unknown", or "dark" for
    lamps in a dark room; "focal", pixels, or None.
    """
    manifest = folder / MANIFEST_NAME
    if manifest.exists():
        raise ValueError(f"{manifest}: is there already")
    files = photographs(folder)
    if not files:
        raise ValueError(f"{folder}: holds no photographs")
    mesh, light = said["mesh"], said["light"]
    if mesh and mesh not in found(folder)["meshes"]:
        raise ValueError(f"{mesh}: there is no such mesh in {folder}")
    if light not in _LIGHTS or said["encoding"] not in _ENCODINGS or said["unit"] not in ("m", "cm", "mm"):
        raise ValueError("light is unknown or dark, encoding srgb or linear, the unit m, cm or mm")
    height, width = decode(files[0]).radiance.shape[:2]
    focal, guessed = said.get("focal"), ""
    if focal is None:
        focal = _FOCAL_SHARE * max(width, height)
        guessed = "   # a guess: lightfactor calibrate camera measures it"
    if not (isinstance(focal, int | float) and 0 < focal < 1e7):
        raise ValueError(f"the focal length is {focal}; give pixels, above 0")
    lines = [
        "format = 1",
        f"name = {json.dumps(folder.name)}",
        "",
        "[camera]",
        'model = "PINHOLE"',
        f"params = [{focal:.6g}, {focal:.6g}, {width / 2:g}, {height / 2:g}]{guessed}",
        f"width = {width}",
        f"height = {height}",
        "",
        "[radiometry]",
        f'encoding = "{said["encoding"]}"',
        "",
        "[object]",
        *(
            [f'shape = "mesh"\nmesh = {json.dumps(mesh)}\nunit = "{said["unit"]}"']
            if mesh
            else ['shape = "sphere"']
        ),
        "",
        "[[lighting]]",
        'name = "light"',
        "unknown = true",
        *(["dark = true"] if light == "dark" else []),
        "",
    ]
    for file in files:
        lines += ["[[photo]]", f"file = {json.dumps(file.name)}"]
        mask = file.with_name(file.stem + _MASK)
        if mask.is_file():
            read_mask(mask, (height, width))
            lines.append(f"mask = {json.dumps(mask.name)}")
        lines.append("")
    with result_files(manifest) as place:
        (place / MANIFEST_NAME).write_text("\n".join(lines), encoding="utf-8")
    return manifest

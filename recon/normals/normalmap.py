"""Normal maps: a unit normal for each pixel, in the picture's axes (x right, y up, z towards the camera).

As PNG a normal n is the colour (n + 1) / 2, as most programs have it; as EXR it is itself in R, G and B; as NPZ it is
`normals`, beside `std_deg`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.files.imagefile import read_pixels, write_exr, write_png

Floats = NDArray[np.float64]
# The picture's axes in the camera's (x right, y down, z forward).
_PICTURE_IN_CAMERA = np.diag([1.0, -1.0, -1.0])
# A stored normal shorter than this is none; lengths that are off by more than this were no normals.
_NONE, _NEARLY_UNIT = 0.1, 0.1


@dataclass(frozen=True, eq=False)
class NormalMap:
    """Normals of a picture.

    normals : (h, w, 3) unit, NaN where there is no surface. std_deg : (h, w), degrees, of the angle between a normal
    and the true one (RMS); None where nobody knows it.
    """

    normals: Floats
    std_deg: Floats | None = None

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Where there is a surface, (h, w)."""
        return np.asarray(np.isfinite(self.normals).all(axis=2))


def picture_axes(camera: Camera) -> Floats:
    """The picture's axes in the world, as rows (3, 3): right, up, towards the camera."""
    return np.asarray(_PICTURE_IN_CAMERA @ camera.world_to_camera[:3, :3])


def read_normal_map(path: Path) -> NormalMap:
    """Read a normal map, PNG or TIFF (n = 2 colour - 1), EXR (n itself) or NPZ (`normals`, and `std_deg` if there).

    ValueError where most of it isn't unit vectors.
    """
    std_deg = None
    if path.suffix.lower() == ".npz":
        normals, std_deg = _of_npz(path)
    else:
        pixels = read_pixels(path)
        if np.issubdtype(pixels.dtype, np.floating):
            normals = pixels.astype(float)
        else:
            levels = np.iinfo(pixels.dtype).max  # type: ignore[type-var]
            normals = 2 * pixels.astype(float) / levels - 1
            # Black is outside, in the files of most programs; so is the colour of no normal.
            normals[(pixels == 0).all(axis=2)] = 0
    length = np.linalg.norm(np.nan_to_num(normals), axis=2)
    inside = length > _NONE
    if not inside.any():
        raise ValueError(f"{path}: holds no normals: all vectors are shorter than {_NONE}")
    off = float((np.abs(length[inside] - 1) > _NEARLY_UNIT).mean())
    if off > 0.05:
        raise ValueError(
            f"{path}: {off:.0%} of its vectors aren't unit within {_NEARLY_UNIT}; give normals as (n + 1) / 2 in a PNG"
            " without gamma, or as n in EXR or NPZ"
        )
    unit = np.where(inside[..., None], normals / np.where(inside, length, 1)[..., None], np.nan)
    if (unit[..., 2][inside] < 0).mean() > 0.5:
        raise ValueError(
            f"{path}: most normals face away from the camera; the axes are x right, y up, z towards the camera"
        )
    return NormalMap(unit, std_deg)


def _of_npz(path: Path) -> tuple[Floats, Floats | None]:
    try:
        with path.open("rb") as handle, np.load(handle) as file:
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, BadZipFile) as error:
        raise ValueError(f"{path}: can't be read as NPZ ({error})") from error
    if "normals" not in arrays:
        raise ValueError(f"{path}: holds {', '.join(arrays)}; the normals must be named 'normals'")
    normals = np.asarray(arrays["normals"], float)
    std_deg = np.asarray(arrays["std_deg"], float) if "std_deg" in arrays else None
    if normals.ndim != 3 or normals.shape[2] != 3:
        raise ValueError(f"{path}: normals are {normals.shape}; they must be (height, width, 3)")
    return normals, std_deg


def write_normal_map(folder: Path, found: NormalMap) -> None:
    """Write normals.npz, normals.exr and normals.png (16 bit) into a folder."""
    arrays = {"normals": found.normals.astype(np.float32)}
    if found.std_deg is not None:
        arrays["std_deg"] = found.std_deg.astype(np.float32)
    np.savez_compressed(folder / "normals.npz", **arrays)  # type: ignore[arg-type]
    whole = np.nan_to_num(found.normals)
    layers = None if found.std_deg is None else {"std_deg": np.nan_to_num(found.std_deg)}
    write_exr(folder / "normals.exr", whole, layers=layers)
    colours = np.where(found.inside[..., None], (whole + 1) / 2, 0)
    write_png(folder / "normals.png", np.round(colours * 65535).astype(np.uint16))

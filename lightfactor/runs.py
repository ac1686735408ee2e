"""From a photo set to a fit, and from a folder back to one."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from pathlib import Path

from capture.photoset import PhotoSet
from capture.photoset import load_photoset as read_photoset
from capture.progress import silent
from capture.terminal import track as terminal_track
from invrender.output.report.files import write_fit, write_pictures
from invrender.photometric_stereo.result import StereoResult
from invrender.photometric_stereo.result import photometric_stereo as solve_stereo_set
from invrender.process.pipeline import DEFAULT_SAMPLES
from invrender.process.pipeline import process as run_pipeline
from invrender.result.saved import read_result
from lightfactor.arguments import naming_arguments
from lightfactor.fit import Fit


@naming_arguments
def load_photoset(path: Path | str) -> PhotoSet:
    """Read a photo set from its folder or its photoset.toml; ValueError says what is wrong, and where.

    Its photographs are not read yet: `PhotoSet.photos` has their files, cameras and the names of their lightings.
    """
    return read_photoset(Path(path))


@naming_arguments
def process(photoset: PhotoSet | Path | str, samples: int = DEFAULT_SAMPLES, progress: bool = False) -> Fit:
    """Recover BRDF and error bars, and the light where it is unknown, from a photo set of a sphere or a mesh.

    photoset : its folder or manifest, or what `load_photoset` read. samples : pixels of all photographs together that
    enter the fit, 1000 or more; fewer are faster, with larger error bars. progress : show bars on the terminal.
    Does what `lightfactor process` does, and the numbers are the same. ValueError says what is wrong with the set.
    """
    if samples < 1000:
        raise ValueError(f"samples is {samples}; give 1000 or more")
    given = photoset if isinstance(photoset, PhotoSet) else load_photoset(photoset)
    if given.object.shape == "normals":
        raise ValueError(
            f"{given.manifest}: [object] shape is 'normals': lf.photometric_stereo(photoset) solves it"
        )
    track = terminal_track if progress else silent
    folder = Path(tempfile.mkdtemp(prefix="lightfactor-"))
    try:
        run = run_pipeline(given, samples, track)
        write_pictures(run, folder, write_fit(run, folder), track)
        fit = Fit(read_result(folder), given.manifest)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(fit, shutil.rmtree, folder, ignore_errors=True)
    return fit


@naming_arguments
def photometric_stereo(photoset: PhotoSet | Path | str, progress: bool = False) -> StereoResult:
    """Normals, albedo and the shared lobe of a photo set with shape = "normals": one camera, many lamps.

    photoset, progress : as of `process`. The result's `normal_map` has normals (h, w, 3), x right, y up, z to the
    camera, and std_deg (h, w), degrees; `depths` (h, w) is in metres. The numbers are those of `lightfactor process`.
    ValueError says what is wrong with the set.
    """
    given = photoset if isinstance(photoset, PhotoSet) else load_photoset(photoset)
    if given.object.shape != "normals":
        raise ValueError(
            f"{given.manifest}: [object] shape is {given.object.shape!r}: lf.process(photoset) solves it, or write"
            " shape = 'normals'"
        )
    return solve_stereo_set(given, terminal_track if progress else silent)


@naming_arguments
def read_fit(folder: Path | str, photoset: Path | str | None = None) -> Fit:
    """Read a result folder that `lightfactor process` or `Fit.save` wrote, also one of an older version.

    photoset : the set that it was made from, for pictures with its cameras; looked for around the folder otherwise.
    ValueError says what is wrong with the folder, and what to give instead.
    """
    return Fit(read_result(Path(folder)), None if photoset is None else Path(photoset))

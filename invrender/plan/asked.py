"""What a plan is asked for: a built-in scene or a scene file, or a result, whose set one photograph more may join."""

from __future__ import annotations

from pathlib import Path

from capture.progress import Track, silent
from invrender.plan.experiment import Experiment
from invrender.plan.from_result import result_experiment
from invrender.plan.from_scene import read_experiment
from invrender.result.saved import RESULT_NAME, read_result
from synthetic.lights.illumination import Given
from synthetic.scenes.builtin import scene_names


def asked_experiment(
    name: str, given: Given | None = None, photoset: Path | None = None, track: Track = silent
) -> tuple[Experiment, Path]:
    """The experiment of a scene's name, a scene file or a result, and the file that it was read from.

    given : what a set gives of the light, in place of what the scene file or the manifest says; of a result "all" or
    "nothing". photoset : a result's, looked for around it if None. ValueError says what is wrong.
    """
    path, is_builtin = Path(name), name in scene_names()
    if is_builtin or not (path.name == RESULT_NAME or (path / RESULT_NAME).is_file()):
        if photoset is not None:
            raise ValueError(f"--set is for results, and {name!r} is a scene; leave it out")
        if not is_builtin and path.is_dir():
            raise ValueError(
                f"{path}: holds no {RESULT_NAME}; give the folder that `lightfactor process` wrote, or a scene"
            )
        return read_experiment(name, given)
    if given not in (None, "all", "nothing"):
        raise ValueError(f"--light {given}: a result's light is all known or nothing; give all or nothing")
    result = read_result(path)
    return result_experiment(result, photoset, None if given is None else given == "all", track), result.path

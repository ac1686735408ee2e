"""The command `synth`; heavy imports wait until it runs, so that --help is instant."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from capture.commands.options import ClusterAddress, Workers


class LightOfSet(StrEnum):
    ALL = "all"
    DISTANT = "distant"
    BALL = "ball"
    NOTHING = "nothing"


def synth(
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE", help="Name of a built-in scene, or a scene file, NAME.toml.", show_default=False
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="SET",
            help="Folder for the photo set; an earlier one of the same scene in it is replaced.",
            show_default=False,
        ),
    ] = None,
    list_scenes: Annotated[bool, typer.Option("--list", help="List the built-in scenes and stop.")] = False,
    show: Annotated[
        bool,
        typer.Option(
            "--show", help="Print the scene file and stop: redirect it into NAME.toml and edit that."
        ),
    ] = False,
    light: Annotated[
        LightOfSet | None,
        typer.Option(
            help="What the set gives of the light on photographs that are not held out, instead of what the scene"
            " file says: all, all with lamps as if they were distant, photographs of a mirror ball, or nothing.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0, help="Another draw of all that is random (noise, faults); default: the scene file's."
        ),
    ] = None,
    workers: Workers = None,
    cluster: ClusterAddress = None,
) -> None:
    """Photograph a synthetic scene: a photo set as a camera would have taken it, with the truth beside it.

    Radiance comes from brute-force integration of the reflection integral over all light. Scenes are small TOML files:
    start from a built-in one with --show. Lengths are metres, kd is in 1/sr (the diffuse albedo is pi kd), sigma in
    radians, keys that end in _deg in degrees; light is relative.

    Writes photoset.toml, photographs, masks, lighting maps and the mesh into SET, for `lightfactor process` and others
    to read; truth.json and truth/ (parameters, poses, photographs without noise), scene.toml, and contact.png to look
    at. The same scene and seed give the same bytes.
    """
    from synthetic.run import list_built_in, run_synth, show_scene

    spread = {"--workers": workers, "--cluster": cluster}
    others = {"SCENE": scene, "--out": out, "--show": show or None, "--light": light, "--seed": seed} | spread
    if list_scenes:
        _refuse("--list", others)
        list_built_in()
        return
    if scene is None:
        raise ValueError("which scene? Give the name of a built-in one (--list shows them), or a scene file")
    if show:
        _refuse("--show", {key: others[key] for key in ("--out", "--light", "--seed", *spread)})
        show_scene(scene)
        return
    if out is None:
        raise ValueError("where to? Give a folder for the photo set: -o SET")
    run_synth(scene, out, light.value if light else None, seed, workers, cluster)


def _refuse(option: str, others: Mapping[str, object]) -> None:
    """ValueError for arguments that say nothing beside an option that prints and stops."""
    given = [name for name, value in others.items() if value is not None]
    if given:
        raise ValueError(f"{option} prints and stops: remove {' and '.join(given)}, or remove {option}")

"""What all tests share: where the real photographs lie."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import cv2

# It puts handlers of its own in place for crashes, whose words pytest swallows: pytest's own must come after it.
import pycolmap  # noqa: F401
import pytest
import typer

from capture.parallel import one_blas_thread
from lightfactor.cli import main
from recon.mesh.trianglemesh import TriangleMesh
from synthetic.scenes import build
from synthetic.shapes.cat import REACH, cat_field
from synthetic.shapes.meshing import mesh_implicit

# The benchmarks aren't installed; what is installed comes first.
sys.path.append(str(Path(__file__).parents[1]))


@pytest.fixture(scope="session", autouse=True)
def _one_thread() -> Iterator[None]:
    """The cores are shared by processes of tests: threads within each would wait for each other."""
    with one_blas_thread(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("capture.parallel.cores", lambda: 1)
        cv2.setNumThreads(1)
        yield


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Solved sets that tests leave unfinished aren't kept among the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIGHTFACTOR_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a cache that the test shares with no other."""
    monkeypatch.setenv("LIGHTFACTOR_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Callable[[Any, str], list[None]]:
    """`counted(module, name)`: a list that grows with each call of a module's function."""

    def of(module: Any, name: str) -> list[None]:
        calls: list[None] = []
        function = getattr(module, name)

        def call(*arguments: object, **more: object) -> object:
            calls.append(None)
            return function(*arguments, **more)

        monkeypatch.setattr(module, name, call)
        return calls

    return of


def _find_data(environ: Mapping[str, str]) -> Path:
    """The folder of real photographs: skip where nobody promised it, fail where it was promised."""
    folder = environ.get("LIGHTFACTOR_DATA")
    if not folder:
        message = "LIGHTFACTOR_DATA is not set: it names the folder of real photographs (psm/, ...)"
        if environ.get("CI") == "true":
            pytest.fail(f"{message}, and continuous integration promises it")
        pytest.skip(message)
    if not Path(folder).is_dir():
        pytest.fail(f"LIGHTFACTOR_DATA is {folder!r}, which is not a folder")
    return Path(folder)


@pytest.fixture(scope="session")
def find_data() -> Callable[[Mapping[str, str]], Path]:
    """The rule behind `data_dir`, for its own test."""
    return _find_data


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real photographs, named by the environment variable LIGHTFACTOR_DATA."""
    return _find_data(os.environ)


@pytest.fixture(scope="session", autouse=True)
def _commands_once() -> Iterator[None]:
    """Typer's runner puts all commands together for each call; the program does so once, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("typer.testing._get_command", cache(typer.main.get_command))
        yield


@pytest.fixture(scope="session", autouse=True)
def mesh_once() -> Iterator[Callable[..., TriangleMesh]]:
    """`mesh_implicit`, which scenes use too, but each mesh is made once."""
    with pytest.MonkeyPatch.context() as patch:
        once = cache(mesh_implicit)
        patch.setattr(build, "mesh_implicit", once)
        yield once


@pytest.fixture(scope="session", autouse=True)
def _paint_once() -> Iterator[None]:
    """The doll's paint, which scenes use too, is computed once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "doll_textures", cache(build.doll_textures))
        yield


@pytest.fixture(scope="session")
def cat_mesh(mesh_once: Callable[..., TriangleMesh]) -> TriangleMesh:
    """RH01's cat (section 6.4) with edges of 2 mm."""
    return mesh_once(cat_field, REACH, 0.002)


@pytest.fixture
def lightfactor(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Run the command in this process: exit status, standard output in one line, standard error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["lightfactor", *map(str, arguments)])
        with pytest.raises(SystemExit) as done:
            main()
        out, err = capfd.readouterr()
        return int(done.value.code or 0), " ".join(out.split()), err

    return run

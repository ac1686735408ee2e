"""Error bars where photographs are faulty: they hold what the fault moves."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture.photoset import load_photoset
from invrender.process.pipeline import process

from .faultysets import Floats, change_pixels, write_set

# Of GLOSSY.
TRUTH = {"kd": [0.2, 0.16, 0.12], "ks": [0.04, 0.04, 0.04], "sigma": [0.12]}
FAULTS: dict[str, Callable[[int, Floats], Floats]] = {
    "offset": lambda _, pixels: pixels + 0.01,
    # Half of the photographs are right; which half, nobody can tell.
    "brightness": lambda k, pixels: pixels * (1.08 if k % 2 else 1.0),
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(tmp_path_factory.mktemp("sound") / "set")


@pytest.mark.parametrize("fault", FAULTS)
def test_the_truth_lies_within_what_a_named_fault_moves(
    sound: Path, tmp_path: Path, few_forms: None, fault: str
) -> None:
    folder = change_pixels(Path(shutil.copytree(sound, tmp_path / "set")), FAULTS[fault])
    result = process(load_photoset(folder), samples=1000)
    assert result.causes[0].name == fault
    for name, truth in TRUTH.items():
        quantity = result.solution.quantities[name]
        assert quantity.value is not None
        assert quantity.std is not None
        assert (np.abs(quantity.value - truth) < 3 * quantity.std).all(), (name, quantity)
        # Yet they say something: a tenth of the value at most, of Ks a quarter.
        assert (quantity.std < (0.25 if name == "ks" else 0.1) * np.array(truth)).all(), (name, quantity)

"""Damped Gauss-Newton steps on a state that is no vector."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from capture.gaussnewton import damped_step, gauss_newton

Floats = NDArray[np.float64]


@dataclass
class Turned:
    """A rotation that brings arrows (n, 3) onto others, known to a standard deviation."""

    arrows: Floats
    targets: Floats
    std: float
    tries: list[float]
    rotation: Rotation

    @property
    def residuals(self) -> Floats:
        return (self.targets - self.rotation.apply(self.arrows)) / self.std

    @property
    def normal(self) -> tuple[Floats, Floats]:
        slopes = np.cross(np.eye(3)[None], self.rotation.apply(self.arrows)[:, None]).transpose(0, 2, 1)
        rows = slopes.reshape(-1, 3) / self.std
        return rows.T @ rows, rows.T @ self.residuals.ravel()

    def step(self, damping: float) -> Floats:
        self.tries.append(damping)
        return damped_step(*self.normal, damping)

    def promise(self, step: Floats) -> float:
        return float(step @ self.normal[1])

    def moved(self, step: Floats) -> Rotation:
        return Rotation.from_rotvec(step) * self.rotation

    def gain(self, rotation: Rotation) -> float:
        there = Turned(self.arrows, self.targets, self.std, [], rotation)
        return float((self.residuals**2).sum() - (there.residuals**2).sum())


def problem(std: float, tries: list[float]) -> partial[Turned]:
    rng = np.random.default_rng(3)
    arrows = rng.normal(size=(30, 3))
    truth = Rotation.from_rotvec([0.5, -1.0, 1.4])
    return partial(Turned, arrows, truth.apply(arrows) + std * rng.normal(size=(30, 3)), std, tries)


@pytest.mark.parametrize("std", [1e-6, 0.05])
def test_search_ends_within_a_share_of_the_standard_deviation(std: float) -> None:
    about = problem(std, [])
    found = gauss_newton(Rotation.identity(), about, least=1e-4, most_steps=50)
    best = least_squares(lambda v: about(Rotation.from_rotvec(v)).residuals.ravel(), found.as_rotvec())
    off = (Rotation.from_rotvec(best.x) * found.inv()).as_rotvec()
    assert off @ about(found).normal[0] @ off < 1e-4


def test_damping_rises_until_a_step_gains_and_falls_again() -> None:
    """Rosenbrock's valley: from (-1.2, 1) an undamped step makes the cost a hundred times as large."""
    dampings: list[float] = []

    class Valley:
        def __init__(self, at: Floats) -> None:
            self.at, self.left = at, np.array([-10 * (at[1] - at[0] ** 2), at[0] - 1])
            rows = np.array([[-20 * at[0], 10], [-1, 0]])
            self.normal = rows.T @ rows, rows.T @ self.left

        def step(self, damping: float) -> Floats:
            dampings.append(damping)
            return damped_step(*self.normal, damping)

        def promise(self, step: Floats) -> float:
            return float(step @ self.normal[1])

        def moved(self, step: Floats) -> Floats:
            return self.at + step

        def gain(self, state: Floats) -> float:
            return float(self.left @ self.left - Valley(state).left @ Valley(state).left)

    found = gauss_newton(np.array([-1.2, 1.0]), Valley, least=1e-12, most_steps=100)
    np.testing.assert_allclose(found, [1, 1], atol=1e-5)
    assert max(dampings) > dampings[0]
    assert dampings[-1] < dampings[0]


def test_a_step_that_promises_nothing_is_not_tried() -> None:
    about = problem(0.05, [])
    found = gauss_newton(Rotation.identity(), about, least=1e-4, most_steps=50)
    assert gauss_newton(found, about, least=1e-4, most_steps=50) is found


def test_failed_steps_end_where_costs_cannot_be_compared() -> None:
    tries: list[float] = []
    about = problem(0.05, tries)
    here = gauss_newton(Rotation.identity(), about, least=1e-4, most_steps=50)
    near = Rotation.from_rotvec([1e-3, 0, 0]) * here
    tries.clear()

    class Blind(Turned):
        def gain(self, rotation: Rotation) -> float:
            return -1.0

    args = about.args
    assert gauss_newton(near, lambda at: Blind(*args, at), 1e-4, 50, told_apart=1e3) is near
    assert len(tries) == 1


def test_parameters_without_information_stay() -> None:
    matrix, right = np.diag([4.0, 0.0, 1.0]), np.array([2.0, 3.0, 1.0])
    np.testing.assert_allclose(damped_step(matrix, right, 1.0), [0.25, 0.0, 0.5])

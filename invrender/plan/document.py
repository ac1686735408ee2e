"""`plan.json`: everything that a plan says, as docs/planning.md has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import software
from invrender.plan.advice import Advice
from invrender.plan.candidates import AddedPhoto
from invrender.plan.experiment import Experiment, angles_deg
from invrender.plan.light_prospect import LightProspect
from invrender.plan.planning import Plan
from invrender.plan.prospect import Expected, worth_improving

FORMAT = 1


def plan_document(
    plan: Plan, advice: Advice, sentences: Sequence[str], inputs: Mapping[str, str]
) -> dict[str, Any]:
    """The plan as JSON-ready data; numbers are finite. sentences : all in words. inputs : file -> "sha256:..."."""
    experiment = plan.experiment
    prospects = {prospect.name: prospect for prospect in plan.lights}
    return {
        "format": FORMAT,
        "name": experiment.name,
        "gauge": gauge(experiment),
        "photos": [view.name for view in experiment.views],
        "samples": plan.fit_samples,
        "quantities": [
            {
                "name": one.name,
                "truth": _numbers(one.truth),
                "std": _numbers(one.std),
                "noise_std": _numbers(one.noise_std),
                "variance_shares": one.shares,
                "status": one.quantity.status,
                "reason": one.quantity.reason,
                "remedy": one.quantity.remedy,
            }
            for one in plan.expected
        ],
        "lighting": [
            {"name": light.lighting.name, "known": light.known}
            | ({} if light.known else _light(prospects[light.lighting.name]))
            for light in experiment.lights
        ],
        "repeated": _outcome(plan.repeated),
        "calibration": [
            {
                "cause": cause,
                "gain": gain,
                "quantities": [
                    {"name": one.name, "std": _numbers(one.improved(cause))}
                    for one in plan.expected
                    if one.causes
                ],
            }
            for cause, gain in worth_improving(plan.expected)
        ],
        "advice": _advice(experiment, advice),
        "sentences": list(sentences),
        "notes": list(experiment.notes),
        "inputs": dict(inputs),
        "software": software(),
    }


def gauge(experiment: Experiment) -> str:
    """Which scale the numbers are in, in words."""
    index = experiment.gauge_light
    if index is None:
        return "absolute: the given lighting fixes the scale of Kd and Ks in each channel"
    name = experiment.lights[index].lighting.name
    return f"relative: the total of lighting {name!r} is taken for known in each channel, as nothing determines it"


def _light(prospect: LightProspect) -> dict[str, Any]:
    return {
        "l_max": prospect.l_max,
        "sh": {"value": _numbers(prospect.coefficients), "std": _numbers(prospect.std)},
        "determined_shares": _numbers(prospect.shares),
        "determined_degree": prospect.highest,
        "effective_rank": prospect.effective_rank,
        "reached": prospect.reached,
    }


def _advice(experiment: Experiment, advice: Advice) -> dict[str, Any]:
    found: dict[str, Any] = {"target": advice.target.name, "label": advice.target.label}
    for kind, trial in (("view", advice.view), ("lamp", advice.lamp)):
        directions, gains = trial.gains(advice.target)
        found[kind] = {
            "best": _candidate(experiment, trial.best),
            "best_above_horizon": _candidate(experiment, trial.best_above),
            "tried": {"direction": _numbers(directions), "gain": _numbers(gains)},
        }
    return found


def _candidate(experiment: Experiment, candidate: AddedPhoto) -> dict[str, Any]:
    azimuth, elevation = angles_deg(candidate.place.direction)
    place: dict[str, Any] = {
        "azimuth_deg": azimuth,
        "elevation_deg": elevation,
        "direction": _numbers(candidate.place.direction),
        "lighting": experiment.lights[candidate.place.view.light].lighting.name,
    }
    if candidate.irradiance is None:
        place["distance"] = experiment.distance
    else:
        place["photo"] = candidate.place.view.name
        place["irradiance"] = _numbers(candidate.irradiance)
    return place | {"quantities": _outcome(candidate.expected)}


def _outcome(expected: Sequence[Expected]) -> list[dict[str, Any]]:
    return [{"name": one.name, "std": _numbers(one.std), "status": one.quantity.status} for one in expected]


def _numbers(values: NDArray[np.float64]) -> Any:
    return np.asarray(values, float).tolist()

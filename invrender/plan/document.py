"""`plan.json`: everything that a plan says, as docs/planning.md has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import software
from invrender.plan.advice import Advice, Candidate
from invrender.plan.experiment import Experiment, angles_deg
from invrender.plan.lightprospect import LightProspect
from invrender.plan.planning import Plan
from invrender.plan.prospect import Expected

FORMAT = 1


def plan_document(plan: Plan, advice: Advice | None, inputs: Mapping[str, str]) -> dict[str, Any]:
    """The plan as JSON-ready data; numbers are finite. inputs : file -> "sha256:..."."""
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
        "advice": None if advice is None else _advice(experiment, advice),
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
    return f"relative: the total of lighting {name!r} is taken for known in each channel, as nothing tells it"


def _light(prospect: LightProspect) -> dict[str, Any]:
    return {
        "l_max": prospect.l_max,
        "sh": {"value": _numbers(prospect.coefficients), "std": _numbers(prospect.std)},
        "determined_shares": _numbers(prospect.shares),
        "determined_degree": prospect.highest,
        "determined_coefficients": prospect.rank,
        "reached": prospect.reached,
    }


def _advice(experiment: Experiment, advice: Advice) -> dict[str, Any]:
    found: dict[str, Any] = {"target": advice.target.name}
    for kind, candidates in (("view", advice.views), ("light", advice.lights)):
        found[kind] = _candidate(experiment, advice.best(candidates))
        found[f"{kind}_above_horizon"] = _candidate(experiment, advice.best(candidates, above_horizon=True))
        directions, gains = advice.gains(candidates)
        found[f"{kind}s_tried"] = {"direction": _numbers(directions), "gain": _numbers(gains)}
    return found


def _candidate(experiment: Experiment, candidate: Candidate | None) -> dict[str, Any] | None:
    if candidate is None:
        return None
    azimuth, elevation = angles_deg(candidate.direction)
    place: dict[str, Any] = {
        "azimuth_deg": azimuth,
        "elevation_deg": elevation,
        "direction": _numbers(candidate.direction),
        "lighting": experiment.lights[candidate.light].lighting.name,
    }
    if candidate.viewpoint is None:
        place["distance"] = experiment.distance
    else:
        place["photo"] = experiment.views[candidate.viewpoint].name
        place["irradiance"] = _numbers(candidate.irradiance)
    return place | {"quantities": _outcome(candidate.expected)}


def _outcome(expected: Sequence[Expected]) -> list[dict[str, Any]]:
    return [{"name": one.name, "std": _numbers(one.std), "status": one.quantity.status} for one in expected]


def _numbers(values: NDArray[np.float64] | None) -> Any:
    return None if values is None else np.asarray(values, float).tolist()

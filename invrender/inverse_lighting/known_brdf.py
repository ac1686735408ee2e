"""The BRDF that inverse lighting is given: from an earlier result, or number by number."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from invrender.brdf.form import LobeForm
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import SIGMA_RANGE, Microfacet
from invrender.result.saved import RESULT_NAME, saved_form
from invrender.result.truth import TRUTH_NAME, is_truth, truth_side

_GIVE = "the result.json of `lightfactor process`, or the truth.json of `lightfactor synth`"


def known_brdf(
    kd: Sequence[float],
    ks: Sequence[float],
    mu: float | None,
    sigma: float | None,
    form: LobeForm = RH01_FORM,
) -> Microfacet:
    """A BRDF from one number or three of Kd (1/sr) and of Ks, mu (None: no Fresnel factor) and sigma (radians).

    Raises ValueError for numbers that no BRDF has, for a specular part without sigma, and for a BRDF that is black.
    """
    if form.axis is not None:
        raise ValueError(
            f"the BRDF is a {form.name} lobe, and light is recovered by isotropic lobes only; photograph an object that"
            " isn't brushed, or give numbers by --kd, --ks, --mu and --sigma"
        )
    brdf = Microfacet(_per_channel(kd, "Kd"), _per_channel(ks, "Ks"), mu, sigma, form)
    if not (brdf.kd + brdf.ks).all():
        raise ValueError(
            f"Kd is {brdf.kd.tolist()} and Ks {brdf.ks.tolist()}: a channel in which both are 0 reflects nothing and"
            " shows no light; give Kd, Ks or both"
        )
    if mu is not None and not MU_RANGE[0] <= mu <= MU_RANGE[1]:
        raise ValueError(
            f"mu is {mu}; refractive indices are {MU_RANGE[0]} to {MU_RANGE[1]}; leave it out for a highlight without"
            " a Fresnel factor"
        )
    if sigma is None:
        if brdf.ks.any():
            raise ValueError(f"Ks is {brdf.ks.tolist()}, but sigma isn't given: a highlight needs its width")
    elif not SIGMA_RANGE[0] <= sigma <= SIGMA_RANGE[1]:
        raise ValueError(f"sigma is {sigma}; roughnesses are {SIGMA_RANGE[0]} to {SIGMA_RANGE[1]} radians")
    return brdf


def read_brdf(path: Path) -> Microfacet:
    """The BRDF of a `result.json`, of a `truth.json`, or of the folder that holds one of them.

    ValueError where it is none, where it is undetermined, and where no form of ours is the true material's.
    """
    if path.is_dir():
        named = [path / name for name in (RESULT_NAME, TRUTH_NAME)]
        path = next((file for file in named if file.is_file()), named[0])
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file; give {_GIVE}")
    try:
        return _true_brdf(path) if is_truth(path) else _found_brdf(path)
    except ValueError as error:
        raise ValueError(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from error


def _found_brdf(path: Path) -> Microfacet:
    """The BRDF of a `result.json`."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))["brdf"]
        model = table["model"]
        found = {name: table[name] for name in ("kd", "ks", "mu", "sigma")}
        kd, ks, sigma = (_value(found[name], path, name) for name in ("kd", "ks", "sigma"))
        # Without a value the model has no Fresnel factor, or the photographs don't show which.
        mu = None if found["mu"] is None else found["mu"]["value"]
        own = {name: float(number["value"]) for name, number in table.get("form_numbers", {}).items()}
    except (KeyError, TypeError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(
            f"{path}: holds no BRDF (brdf with model, kd, ks, mu, sigma); give {_GIVE}"
        ) from error
    about = table.get("brushed_about")
    form = saved_form(model, own, None if about is None else tuple(about))
    return known_brdf(kd, ks or [0.0], mu, sigma if ks else None, form)


def _true_brdf(path: Path) -> Microfacet:
    """The BRDF of a `truth.json`, in the unit of the set's photographs."""
    side = truth_side(path)
    if side.textures is not None:
        raise ValueError("its object is textured: light is recovered from objects of one BRDF only")
    if side.brdf is None:
        raise ValueError(
            f"its material is {side.material!r}, which none of our forms describes; give a result of"
            " `lightfactor process`, or numbers by --kd, --ks, --mu and --sigma"
        )
    brdf = side.brdf
    ks = brdf.ks if brdf.sigma is not None else np.zeros(3)
    return known_brdf(brdf.kd.tolist(), ks.tolist(), brdf.mu, brdf.sigma, brdf.form)


def _value(quantity: dict[str, Any] | None, path: Path, name: str) -> Any:
    """A quantity's value; None where the model lacks it."""
    if quantity is None:
        return None
    if quantity["value"] is None:
        raise ValueError(
            f"{path}: {name} is {quantity['status']} there, so the BRDF isn't known; give the numbers by --kd, --ks,"
            " --mu and --sigma, or a result that determines them"
        )
    return quantity["value"]


def _per_channel(values: Sequence[float], name: str) -> np.ndarray:
    numbers = np.asarray(values, float)
    if numbers.shape not in ((1,), (3,)):
        raise ValueError(f"{name} is {list(values)}; give one number, or three for red, green and blue")
    if not (np.isfinite(numbers) & (numbers >= 0)).all():
        raise ValueError(f"{name} is {list(values)}; it must be finite and >= 0")
    return np.broadcast_to(numbers, 3)

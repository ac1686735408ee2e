"""The registry of lobes: the forms that fits try. A new lobe is a module beside this one, and a line here."""

from __future__ import annotations

import copyreg
from typing import Any

from invrender.brdf.beckmann import Beckmann
from invrender.brdf.form import LobeForm
from invrender.brdf.ggx import GGX
from invrender.brdf.phong import Phong
from invrender.brdf.rh01 import RH01Microfacet

RH01_FORM, BECKMANN, GGX_FORM, PHONG = RH01Microfacet(), Beckmann(), GGX(), Phong()
FORMS = {form.name: form for form in (RH01_FORM, BECKMANN, GGX_FORM, PHONG)}
# The same lobes above a base under an interface.
PLASTICS: dict[LobeForm, LobeForm] = {BECKMANN: Beckmann(over=BECKMANN), GGX_FORM: GGX(over=GGX_FORM)}
# The same with light and viewer hidden apart.
UNCORRELATED: dict[LobeForm, LobeForm] = {
    BECKMANN: Beckmann(correlated=False),
    GGX_FORM: GGX(correlated=False),
}
UNCORRELATED |= {
    PLASTICS[BECKMANN]: Beckmann(correlated=False, over=UNCORRELATED[BECKMANN]),
    PLASTICS[GGX_FORM]: GGX(correlated=False, over=UNCORRELATED[GGX_FORM]),
}

_REGISTERED = {form.name: form for form in (*FORMS.values(), *PLASTICS.values(), *UNCORRELATED.values())}


def registered(name: str) -> LobeForm:
    """The form of the registry that is called so."""
    return _REGISTERED[name]


def _reduced(form: LobeForm) -> tuple[Any, ...] | str:
    """A form as pickles have it: one of the registry by its name, since code compares these by identity."""
    is_registered = _REGISTERED.get(form.name) is form
    return (registered, (form.name,)) if is_registered else form.__reduce_ex__(2)


for _kind in {type(form) for form in _REGISTERED.values()}:
    copyreg.pickle(_kind, _reduced)

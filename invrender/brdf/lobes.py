"""The registry of lobes: the forms that fits try. A new lobe is a module beside this one, and a line here."""

from __future__ import annotations

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

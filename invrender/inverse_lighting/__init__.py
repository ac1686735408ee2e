"""Inverse lighting: the light on an object of known BRDF [RH01, section 6.2]."""

"""Prefiltered light: spherical harmonic reflection maps [R02, chapter 5]."""

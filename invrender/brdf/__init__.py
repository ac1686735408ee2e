"""Reflectance without a formula, under known light: harmonic coefficients, and tables of measured values."""

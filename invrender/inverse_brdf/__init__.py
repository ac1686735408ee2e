"""Inverse BRDF: reflectance without a formula, under known light."""

"""Inverse problems on the light field: search, evidence, uncertainty."""

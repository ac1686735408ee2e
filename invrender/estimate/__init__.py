"""Estimates from light-field samples: search, evidence, uncertainty."""

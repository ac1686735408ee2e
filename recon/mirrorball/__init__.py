"""Distant light from photographs of a mirror ball."""

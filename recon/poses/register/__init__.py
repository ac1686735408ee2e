"""Poses: where the photographs of a set were taken from."""

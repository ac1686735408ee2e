"""Cameras and lights that travel along an arc."""

"""Poses of cameras and objects."""

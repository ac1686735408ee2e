"""Reflected radiance by brute force, and photographs of it."""

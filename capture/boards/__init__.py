"""Calibration boards: what is printed on them, and finding it in photographs."""

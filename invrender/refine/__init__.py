"""Poses of photographs refined by what the fit predicts them to show."""

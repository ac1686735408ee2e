"""Light that falls on the scene."""

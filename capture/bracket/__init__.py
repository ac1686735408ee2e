"""Brackets of exposures: the response curve that they show, and their merge."""

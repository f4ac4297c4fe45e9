"""Scenes of a run as plain data, which the printed figures and the page draw alike."""

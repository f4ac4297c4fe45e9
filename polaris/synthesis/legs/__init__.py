"""Joints of the legs of a mission."""

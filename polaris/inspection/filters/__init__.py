"""Filters that keep the constraints."""

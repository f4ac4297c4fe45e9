"""Switched systems."""

"""Reachable tubes of linear systems."""

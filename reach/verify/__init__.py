"""Verification of specifications."""

"""Arithmetic: exponentials, rounding, programs."""

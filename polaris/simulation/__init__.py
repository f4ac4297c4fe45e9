"""Closed loops, disturbances, metrics of runs."""

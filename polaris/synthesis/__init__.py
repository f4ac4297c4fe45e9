"""Algorithms 1 and 2: safety controller, recoverable sets, switching schedule."""

"""Synthesis of reference trajectories (section III-C): the mixed-integer program and its re-check."""

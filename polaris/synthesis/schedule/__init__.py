"""Switching schedules: Algorithm 2, the search for better ones, and what is claimed of them."""

"""Switching schedules: Algorithm 2, the search for better ones, and the claims about them."""
